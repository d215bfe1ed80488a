"""The rigid flight: a smooth prescribed path from which attitude, rates and specific force all follow exactly.

Altitude, roll and the wobbles are analytic with their derivatives; the heading follows from a coordinated turn
``chi' = g tan(roll) / V`` and the pitch from the flight-path angle, so gyro, accelerometer and attitude agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.records import Floats
from companion.sim.flight.truth import COLUMNS, EULER, POSITION, RATE, STEP_NS, VELOCITY
from companion.units import GRAVITY_MPS2

# smoothstep 35u^4 - 84u^5 + 70u^6 - 20u^7: three continuous derivatives at both ends
_STEP = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
_LIFT_OFF_S = 3.0  # after the wheels leave the ground, until turbulence has its full size (choice)
_TOUCH_S = 0.3  # in which the gear takes the weight, or gives it up (choice)
_BUMPS = 7  # chosen: sines of uneven ground: irregular enough, cheap to differentiate
_TABLE = (_STEP.integ(), _STEP, _STEP.deriv(), _STEP.deriv(2), _STEP.deriv(3))


@dataclass(frozen=True, slots=True)
class AltitudeStep:
    """Altitude above the ground that is reached at ``from_s`` and held until the next level's climb begins."""

    from_s: float
    altitude_m: float
    climb_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Roll:
    """Bank to ``angle_rad`` within ``rise_s``, hold, and back."""

    from_s: float
    angle_rad: float
    rise_s: float = 2.5
    hold_s: float = 2.0


@dataclass(frozen=True, slots=True)
class PullUp:
    """Gain ``climb_mps`` (negative: sink) within ``pull_s``, lose it within ``ease_s``, then go back as gently."""

    from_s: float
    climb_mps: float = 2.2
    pull_s: float = 1.2
    ease_s: float = 4.0

    @property
    def until_s(self) -> float:
        """When the flight is back on its height."""
        return self.from_s + self.pull_s + 2.5 * self.ease_s


@dataclass(frozen=True, slots=True)
class Jolt:
    """A blow to the fuselage from below: half a sine of upward acceleration; the vertical speed that it gains stays.

    It moves the root, not the attitude, and adds no lift: the wing's mass stays behind and bends the tips down.
    """

    from_s: float
    peak_mps2: float
    length_s: float = 0.02


@dataclass(frozen=True, slots=True)
class GroundRoll:
    """A roll on the wheels: standing at one end, at flying speed at the other, over ground that shakes the root.

    ``bump_mps2`` is the rms of the root's vertical acceleration, made of sines from 2 to 12 Hz; wheels carry what lift
    does not, and lift goes with the square of the speed.
    """

    from_s: float
    until_s: float
    landing: bool = False
    bump_mps2: float = 3.0


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """Manoeuvres of a flight. ``wobble`` values are rms of a turbulence made of sines from 0.2 to 1.5 Hz."""

    duration_s: float
    airspeed_mps: float = 22.0
    angle_of_attack_rad: float = 0.05
    levels: tuple[AltitudeStep, ...] = (AltitudeStep(0.0, 60.0),)
    rolls: tuple[Roll, ...] = ()
    pull_ups: tuple[PullUp, ...] = ()
    heave_wobble_mps2: float = 0.4
    roll_wobble_rad: float = 0.015
    pitch_wobble_rad: float = 0.008
    yaw_wobble_rad: float = 0.008
    jolts: tuple[Jolt, ...] = ()
    rolls_on_ground: tuple[GroundRoll, ...] = ()

    @property
    def airborne_s(self) -> tuple[float, float]:
        """From when until when it flies."""
        off_s = [roll.until_s for roll in self.rolls_on_ground if not roll.landing]
        on_s = [roll.from_s for roll in self.rolls_on_ground if roll.landing]
        return max(off_s, default=0.0), min(on_s, default=self.duration_s)


def demo_plan(duration_s: float = 60.0) -> FlightPlan:
    """Fly 100, 60 and 20 m above the ground with banks and pull-ups; times are a minute's and stretch with the flight.

    Below 40 s there is no room for the descents: the flight stays at 60 m.
    """
    k = duration_s / 60.0
    if duration_s < 40.0:
        return FlightPlan(
            duration_s,
            rolls=(Roll(0.2 * duration_s, 0.35), Roll(0.6 * duration_s, -0.35)),
            pull_ups=(PullUp(0.4 * duration_s),),
        )
    return FlightPlan(
        duration_s,
        levels=(
            AltitudeStep(0.0, 100.0),
            AltitudeStep(29.0 * k, 60.0, 13.0 * k),
            AltitudeStep(51.0 * k, 20.0, 13.0 * k),
        ),
        rolls=(
            Roll(4.0 * k, 0.5),
            Roll(20.0 * k, -0.35),
            Roll(30.0 * k, 0.5, hold_s=1.0),
            Roll(53.0 * k, -0.3, hold_s=1.0),
        ),
        pull_ups=(PullUp(3.0 * k), PullUp(27.5 * k, 1.5)),
    )


def circuit_plan(duration_s: float) -> FlightPlan:
    """Roll for a sixth of the flight, climb, fly level at 60 m, sink, roll out in the last tenth; wings level."""
    off_s, on_s, wheels_m = duration_s / 6.0, 0.9 * duration_s, 0.4
    climb_s, sink_s = 0.25 * duration_s, 0.3 * duration_s
    return FlightPlan(
        duration_s,
        levels=(
            AltitudeStep(0.0, wheels_m),
            AltitudeStep(off_s + climb_s, 60.0, climb_s),
            AltitudeStep(on_s, wheels_m, sink_s),
        ),
        rolls_on_ground=(GroundRoll(0.0, off_s), GroundRoll(on_s, duration_s, landing=True)),
    )


def fly(plan: FlightPlan, rng: np.random.Generator, knots: int) -> tuple[Floats, Floats]:
    """Compute the rigid columns of the truth's knots and their derivatives; the modal columns stay zero.

    Returns
    -------
    knots, derivatives : (n, 16) float64
        As :class:`companion.sim.flight.truth.FlightTruth` takes them.
    """
    t = np.arange(knots, dtype=np.float64) * (STEP_NS * 1e-9)
    speed = plan.airspeed_mps
    aloft = _aloft(plan, t)
    height = _altitude(plan, t) + _product(_wobble(rng, t, plan.heave_wobble_mps2, acceleration=True), aloft)
    roll = _roll(plan, t) + _product(_wobble(rng, t, plan.roll_wobble_rad), aloft)[:3]
    turn = _coordinated_turn_radps(roll, speed)
    yaw = turn + _product(_wobble(rng, t, plan.yaw_wobble_rad), aloft)[:3]
    pitch = _climb_angle(height, speed) + _product(_wobble(rng, t, plan.pitch_wobble_rad), aloft)[:3]
    pitch[0] += plan.angle_of_attack_rad
    height = height + jolted(plan, t)
    velocity, acceleration = _track(turn, height, airspeed(plan, t))
    value, rate = np.zeros((knots, COLUMNS)), np.zeros((knots, COLUMNS))
    value[:, VELOCITY], rate[:, VELOCITY] = velocity, acceleration
    rate[:, POSITION] = velocity
    for axis in (0, 1):
        value[:, axis] = _integral(velocity[:, axis], acceleration[:, axis])
    value[:, 2] = -height[0]
    value[:, EULER], rate[:, EULER] = np.stack([roll[0], pitch[0], yaw[0]], 1), np.stack([roll[1], pitch[1], yaw[1]], 1)
    value[:, RATE], rate[:, RATE] = _body_rates(roll, pitch, yaw)
    return value, rate


def _smooth_step(t: Floats, start_s: float, length_s: float) -> Floats:
    """Rise from 0 to 1: integral, value and three derivatives, (5, n)."""
    u = np.clip((t - start_s) / length_s, 0.0, 1.0)
    rows = np.array([poly(u) * length_s ** (1 - order) for order, poly in enumerate(_TABLE)])
    rows[0] += np.maximum(t - start_s - length_s, 0.0)
    return rows


def altitude_m(plan: FlightPlan, t_s: Floats) -> Floats:
    """Height above the ground that is flown, without turbulence, (n,)."""
    return np.asarray(_altitude(plan, t_s)[0])


def _altitude(plan: FlightPlan, t: Floats) -> Floats:
    """Height above the ground and three derivatives, (4, n)."""
    rows = np.zeros((4, len(t)))
    rows[0] = plan.levels[0].altitude_m
    for before, level in zip(plan.levels, plan.levels[1:], strict=False):
        step = _smooth_step(t, level.from_s - level.climb_s, level.climb_s)
        rows += (level.altitude_m - before.altitude_m) * step[1:]
    for pull in plan.pull_ups:
        eased = pull.from_s + pull.pull_s
        up, down = _smooth_step(t, pull.from_s, pull.pull_s), _smooth_step(t, eased, pull.ease_s)
        rows += pull.climb_mps * (up - down)[:4]
        gained = pull.climb_mps * (pull.pull_s + pull.ease_s) / 2
        rows -= gained * _smooth_step(t, eased + pull.ease_s, 1.5 * pull.ease_s)[1:]
    return rows


def _roll(plan: FlightPlan, t: Floats) -> Floats:
    """Bank angle and two derivatives, (3, n)."""
    rows = np.zeros((3, len(t)))
    for roll in plan.rolls:
        back = _smooth_step(t, roll.from_s + roll.rise_s + roll.hold_s, roll.rise_s)
        rows += roll.angle_rad * (_smooth_step(t, roll.from_s, roll.rise_s) - back)[1:4]
    return rows


def jolted(plan: FlightPlan, t: Floats) -> Floats:
    """Height that jolts and uneven ground give and its three derivatives, (4, n)."""
    rows = _bumps(plan, t)
    for jolt in plan.jolts:
        omega = math.pi / jolt.length_s
        phase = omega * np.clip(t - jolt.from_s, 0.0, jolt.length_s)
        after_s = np.maximum(t - jolt.from_s - jolt.length_s, 0.0)
        speed = jolt.peak_mps2 / omega
        rows[0] += speed * ((phase - np.sin(phase)) / omega + 2.0 * after_s)
        rows[1] += speed * (1.0 - np.cos(phase))
        rows[2] += jolt.peak_mps2 * np.sin(phase)
        rows[3] += np.where((phase > 0.0) & (phase < math.pi), jolt.peak_mps2 * omega * np.cos(phase), 0.0)
    return rows


def airspeed(plan: FlightPlan, t: Floats) -> Floats:
    """Airspeed and its derivative, (2, n): constant in the air, a smooth step from or to rest on the ground."""
    rows = np.zeros((2, len(t)))
    rows[0] = plan.airspeed_mps
    for roll in plan.rolls_on_ground:
        step = plan.airspeed_mps * _smooth_step(t, roll.from_s, roll.until_s - roll.from_s)[1:3]
        rows += -step if roll.landing else step - np.array([[plan.airspeed_mps], [0.0]])
    return rows


def lift_share(plan: FlightPlan, t: Floats) -> Floats:
    """Share of the weight that lift carries, (n,): the square of the speed's share of flying speed."""
    return np.asarray((airspeed(plan, t)[0] / plan.airspeed_mps) ** 2)


def _aloft(plan: FlightPlan, t: Floats) -> Floats | None:
    """One in the air and zero on the wheels with three derivatives, (4, n); None for a flight that stays up."""
    if not plan.rolls_on_ground:
        return None
    rows = np.zeros((4, len(t)))
    rows[0] = 1.0
    for roll in plan.rolls_on_ground:
        start_s = roll.from_s - _LIFT_OFF_S if roll.landing else roll.until_s
        step = _smooth_step(t, start_s, _LIFT_OFF_S)[1:]
        rows += -step if roll.landing else step - np.array([[1.0], [0.0], [0.0], [0.0]])
    return rows


def _product(rows: Floats, factor: Floats | None) -> Floats:
    """Value and three derivatives of a product, (4, n), by Leibniz; the rows themselves without a factor."""
    if factor is None:
        return rows
    (a, da, dda, ddda), (b, db, ddb, dddb) = rows, factor
    return np.stack(
        [a * b, da * b + a * db, dda * b + 2 * da * db + a * ddb, ddda * b + 3 * dda * db + 3 * da * ddb + a * dddb]
    )


def _bumps(plan: FlightPlan, t: Floats) -> Floats:
    """Height that the ground's unevenness gives the root and three derivatives, (4, n): fixed sines over each roll."""
    rows = np.zeros((4, len(t)))
    for roll in plan.rolls_on_ground:
        length_s = roll.until_s - roll.from_s
        start_s, end_s = roll.from_s - _TOUCH_S, roll.until_s - _TOUCH_S
        ground = _smooth_step(t, start_s, _TOUCH_S)[1:] - _smooth_step(t, end_s, _TOUCH_S)[1:]
        rows += _product(_bump_sines(t - roll.from_s, roll.bump_mps2), ground) if length_s > 0.0 else 0.0
    return rows


def _bump_sines(t: Floats, rms_mps2: float) -> Floats:
    omegas_radps = (2 * math.pi * np.geomspace(2.0, 12.0, _BUMPS)).tolist()
    return _sines(t, omegas_radps, [number**2 for number in range(_BUMPS)], rms_mps2, acceleration=True)


def _wobble(rng: np.random.Generator, t: Floats, rms: float, *, acceleration: bool = False) -> Floats:
    """Seven sines of random phase, (4, n), as :func:`_sines`."""
    base = np.geomspace(0.2, 1.5, 7) * rng.uniform(0.95, 1.05, 7)
    phases = rng.uniform(0.0, 2 * math.pi, 7)
    return _sines(t, (2 * math.pi * base).tolist(), phases.tolist(), rms, acceleration=acceleration)


def _sines(
    t: Floats, omegas_radps: list[float], phases_rad: Sequence[float], rms: float, *, acceleration: bool
) -> Floats:
    """Sines of equal amplitude: value and three derivatives, (4, n).

    ``rms`` is that of the value, or of its second derivative.
    """
    rows = np.zeros((4, len(t)))
    for omega, phase in zip(omegas_radps, phases_rad, strict=True):
        amplitude = rms * math.sqrt(2 / len(omegas_radps)) / (omega**2 if acceleration else 1.0)
        for order in range(4):
            rows[order] += amplitude * omega**order * np.sin(omega * t + phase + order * math.pi / 2)
    return rows


def _coordinated_turn_radps(roll: Floats, speed: float) -> Floats:
    """Course of a coordinated turn and its two derivatives, (3, n)."""
    rate = GRAVITY_MPS2 / speed * np.tan(roll[0])
    change = GRAVITY_MPS2 / speed * roll[1] / np.cos(roll[0]) ** 2
    return np.stack([_integral(rate, change), rate, change])


def _climb_angle(height: Floats, speed: float) -> Floats:
    """Flight-path angle atan(h'/V) and its two derivatives, (3, n)."""
    x, dx, ddx = height[1:] / speed
    square = 1 + x**2
    return np.stack([np.arctan(x), dx / square, ddx / square - 2 * x * dx**2 / square**2])


def _track(turn: Floats, height: Floats, along: Floats) -> tuple[Floats, Floats]:
    """Velocity and acceleration in NED, (n, 3) each; ``along`` is the speed and its derivative."""
    (speed, change), cos, sin = along, np.cos(turn[0]), np.sin(turn[0])
    velocity = np.stack([speed * cos, speed * sin, -height[1]], 1)
    acceleration = np.stack([change * cos - speed * turn[1] * sin, change * sin + speed * turn[1] * cos, -height[2]], 1)
    return velocity, acceleration


def _body_rates(roll: Floats, pitch: Floats, yaw: Floats) -> tuple[Floats, Floats]:
    """Body rates of the 3-2-1 sequence and their derivatives, (n, 3) each."""
    (_, dr, ddr), (_, dp, ddp), (_, dy, ddy) = roll, pitch, yaw
    cr, sr, cp, sp = np.cos(roll[0]), np.sin(roll[0]), np.cos(pitch[0]), np.sin(pitch[0])
    rate = np.stack([dr - dy * sp, dp * cr + dy * cp * sr, -dp * sr + dy * cp * cr], 1)
    # the derivative of yaw rate seen along the tilted axes, less what roll turns
    level, slant = ddy * cp - dy * dp * sp, ddy * sp + dy * dp * cp
    change = np.stack(
        [ddr - slant, ddp * cr + level * sr + dr * rate[:, 2], -ddp * sr + level * cr - dr * rate[:, 1]], 1
    )
    return rate, change


def _integral(value: Floats, change: Floats) -> Floats:
    """Integral from 0 over the knots, by the Hermite rule that uses the derivatives at both ends (fifth order)."""
    step = STEP_NS * 1e-9
    pieces = step / 2 * (value[:-1] + value[1:]) + step**2 / 12 * (change[:-1] - change[1:])
    return np.concatenate([[0.0], np.cumsum(pieces)])
