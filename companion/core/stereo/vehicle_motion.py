"""How the aircraft flew at an exposure: attitude, and velocity in body axes with covariance, as the autopilot told.

Cameras that expose a few milliseconds apart are moved against each other by the flight: 22 m/s for 3 ms are 66 mm, on
a two-metre baseline. Along the path that is known; wind, sideslip and the autopilot's mounting are in the covariance,
and where the autopilot tells its velocity over ground, no more than that velocity's errors.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.stereo.rotation import exp_rotation
from companion.params.airframe import Sensor
from companion.records import Bools, Floats, Ints, VehicleState

_STATES = 64  # some seconds of attitudes at the usual rates (choice)
_ATTITUDE_NS = 500_000_000  # an attitude older than this is not that of the exposure (choice)
# the ground's velocity against the air, and climb and sideslip that are not told: along and across the path, and
# vertical, 1 sigma (choice: a light breeze; a pitch that is wrong by 1.5 degrees at 20 m/s)
_UNTOLD_MPS = (3.0, 3.0, 0.5)
# velocity over ground of a navigation filter whose receiver states no accuracy, 1 sigma, each axis (ArduPilot
# EK3_VELNE_M_NSE: 0.3 for u-blox M8)
_GROUND_MPS = 0.3
# the least that is believed of a stated accuracy: EK3 with its defaults adds 0.07 m/s of its own, the steady state of
# EK3_ACC_P_NSE 0.35 at 100 Hz and EK3_VELNE_M_NSE 0.3 at 5 Hz (derived), and the best receivers have as much
# (u-blox M9, 0.05)
_LEAST_GROUND_MPS = 0.1
# sigmas of a gyro whose airframe file states none, by default 0: of its scale as a ratio, and of its axes (choice: the
# 1 % of scale that every gyro was believed before files were asked; axes that are aligned by eye)
_UNSTATED_SCALE, _UNSTATED_AXES_RAD = 0.01, 0.01
# heading of the autopilot, and pitch and roll of its axes against the cameras' body axes, 1 sigma (choice: a compass
# that is calibrated, a mounting by hand)
_HEADING_RAD, _LEVEL_RAD = 0.05, 0.02
_RATES_S = 4.0  # rates are kept for as long: the smoother's lag, the queue and the time between two pairs (choice)
_RATE_GAP_NS = 50_000_000  # rates further apart do not tell the turn between them (choice)


@dataclass(frozen=True, slots=True, eq=False)
class VehicleMotion:
    """Velocity (3,) over ground, m/s, body axes, and its covariance (3, 3); ``over_ground``: not from airspeed."""

    velocity_mps: Floats
    covariance: Floats
    over_ground: bool = False


STILL = VehicleMotion(np.zeros(3), np.zeros((3, 3)))
"""Cameras that do not move."""
_UNTOLD = VehicleMotion(np.zeros(3), np.diag(np.square(_UNTOLD_MPS)))  # where nobody tells how the aircraft flies


@dataclass(slots=True)
class VehicleTrack:
    """The autopilot's last states.

    ``_lost_mps`` is the sigma of a velocity whose stated accuracy was lost or is old; None before the first statement.
    """

    _states: deque[VehicleState] = field(default_factory=lambda: deque(maxlen=_STATES))
    _lost_mps: float | None = None

    def add(self, state: VehicleState) -> None:
        """Take the newest state; losing the stated accuracy never makes its velocity better than stated last."""
        if state.velocity_sigma_mps is not None:
            self._lost_mps = max(state.velocity_sigma_mps, _GROUND_MPS)
        elif self._lost_mps is not None:
            state = replace(state, velocity_sigma_mps=self._lost_mps)
        self._states.append(state)

    @property
    def newest(self) -> VehicleState | None:
        """The state told last; None before the first."""
        return self._states[-1] if self._states else None

    def attitude(self, t_host_ns: int) -> tuple[float, float] | None:
        """Roll and pitch at an instant, between the states that the autopilot sent; None without one nearby."""
        if not self._near(t_host_ns):
            return None
        return self._at(t_host_ns, _roll), self._at(t_host_ns, _pitch)

    def on_ground(self, t_host_ns: int) -> bool | None:
        """Whether the autopilot had said so by an instant, or says so first; None where it does not tell."""
        until = [state.on_ground for state in self._states if state.received_host_ns <= t_host_ns]
        return until[-1] if until else next((state.on_ground for state in self._states), None)

    def motion(self, t_host_ns: int) -> VehicleMotion:
        """Velocity at an instant, by airspeed, climb rate and attitude; along the body's x where none is nearby."""
        if not self._near(t_host_ns):
            return _UNTOLD if self.newest is None else _motion(self.newest.airspeed_mps, 0.0, 0.0, 0.0)
        around = self._around(t_host_ns)
        if all(state.velocity_ned_mps is not None for state in around):
            return self._over_ground(t_host_ns, around)
        roll_rad, pitch_rad, airspeed_mps, climb_mps = (
            self._at(t_host_ns, quantity)
            for quantity in (_roll, _pitch, lambda state: state.airspeed_mps, lambda state: state.climb_mps)
        )
        return _motion(airspeed_mps, climb_mps, roll_rad, pitch_rad)

    def _over_ground(self, t_host_ns: int, around: list[VehicleState]) -> VehicleMotion:
        """Velocity as the navigation filter has it, turned into body axes by its attitude."""
        roll_rad, pitch_rad, yaw_rad = (self._at(t_host_ns, quantity) for quantity in (_roll, _pitch, _yaw))
        since_s = [1e-9 * (state.received_host_ns - t_host_ns) for state in around]
        ned_mps = np.array([state.velocity_ned_mps for state in around], dtype=np.float64)
        velocity_mps = np.array([np.interp(0.0, since_s, axis) for axis in ned_mps.T])
        velocity = _in_body_axes(velocity_mps, roll_rad, pitch_rad, yaw_rad)
        speed_mps = float(np.linalg.norm(velocity))
        sigma_mps = np.hypot(_stated_mps(around), speed_mps * np.array([0.0, _HEADING_RAD, _LEVEL_RAD]))
        return VehicleMotion(velocity, np.diag(sigma_mps**2), over_ground=True)

    def _around(self, t_host_ns: int) -> list[VehicleState]:
        """The last state before an instant and the first after it, as far as there are both."""
        before = [state for state in self._states if state.received_host_ns <= t_host_ns][-1:]
        return before + [state for state in self._states if state.received_host_ns > t_host_ns][:1]

    def _near(self, t_host_ns: int) -> bool:
        return any(abs(state.received_host_ns - t_host_ns) <= _ATTITUDE_NS for state in self._states)

    def _at(self, t_host_ns: int, quantity: Callable[[VehicleState], float]) -> float:
        values = [quantity(state) for state in self._states]
        values = np.unwrap(values).tolist() if quantity in (_roll, _yaw) else values
        return float(np.interp(0.0, self._since_s(t_host_ns), values))

    def _since_s(self, t_host_ns: int) -> list[float]:
        return [1e-9 * (state.received_host_ns - t_host_ns) for state in self._states]


def velocity_of(state: VehicleState) -> Floats:
    """Velocity (3,), m/s, body axes, of one state: over ground where it tells that, else by airspeed and climb."""
    if state.velocity_ned_mps is None:
        return _motion(state.airspeed_mps, state.climb_mps, state.roll_rad, state.pitch_rad).velocity_mps
    return _in_body_axes(np.array(state.velocity_ned_mps), state.roll_rad, state.pitch_rad, state.yaw_rad)


def _in_body_axes(ned_mps: Floats, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Floats:
    """Vector (3,), north east down, in the axes of a body with this attitude."""
    turns = ((roll_rad, 0), (pitch_rad, 1), (yaw_rad, 2))
    x, y, z = (exp_rotation(-angle * np.eye(3)[axis]) for angle, axis in turns)
    in_body: Floats = x @ y @ z @ ned_mps
    return in_body


def _stated_mps(around: list[VehicleState]) -> float:
    """Sigma of each axis of the velocity over ground by what the receiver states around an instant; the larger one."""
    return max(
        _GROUND_MPS if state.velocity_sigma_mps is None else max(state.velocity_sigma_mps, _LEAST_GROUND_MPS)
        for state in around
    )


def _roll(state: VehicleState) -> float:
    return state.roll_rad


def _pitch(state: VehicleState) -> float:
    return state.pitch_rad


def _yaw(state: VehicleState) -> float:
    return state.yaw_rad


@dataclass(slots=True)
class TurnTrack:
    """The body's rates of the last seconds, as the root's gyro told them, and the turn between two instants."""

    _batches: deque[tuple[Ints, Floats]] = field(default_factory=deque)

    def add(self, t_host_ns: Ints, rate_radps: Floats) -> None:
        """Take samples (n,) of the rates (n, 3), body axes; those that are not later than all before are left out."""
        if not np.isfinite(rate_radps).all() or not (t_host_ns[1:] > t_host_ns[:-1]).all():
            good: Bools = np.asarray(np.isfinite(rate_radps).all(axis=1), dtype=np.bool_)
            good[1:] &= t_host_ns[1:] > np.maximum.accumulate(t_host_ns)[:-1]
            t_host_ns, rate_radps = t_host_ns[good], rate_radps[good]
        if self._batches and len(t_host_ns):
            newest_ns = int(self._batches[-1][0][-1])
            if abs(int(t_host_ns[-1]) - newest_ns) > _RATES_S * 1e9:
                self._batches.clear()  # another clock, or a long silence
            elif t_host_ns[0] <= newest_ns:
                later = t_host_ns > newest_ns
                t_host_ns, rate_radps = t_host_ns[later], rate_radps[later]
        if not len(t_host_ns):
            return
        self._batches.append((t_host_ns, rate_radps))
        oldest_ns = int(self._batches[-1][0][-1]) - round(_RATES_S * 1e9)
        while int(self._batches[0][0][-1]) < oldest_ns:
            self._batches.popleft()

    def between(self, from_ns: int, until_ns: int) -> Floats | None:
        """Rotation vector (3,) of the body from one instant to a later one; None where rates are missing.

        The rates are integrated to second order: ``sum w dt + 1/2 sum (sum before) x w dt`` (Bortz 1971).
        """
        first_ns, last_ns = from_ns - _RATE_GAP_NS, until_ns + _RATE_GAP_NS
        near = [each for each in self._batches if each[0][-1] > first_ns and each[0][0] < last_ns]
        if not near:
            return None
        t_ns = np.concatenate([each[0] for each in near])
        rates = np.concatenate([each[1] for each in near])
        first, last = np.searchsorted(t_ns, from_ns, side="right"), np.searchsorted(t_ns, until_ns)
        if first == 0 or last == len(t_ns) or int(np.diff(t_ns[first - 1 : last + 1]).max()) > _RATE_GAP_NS:
            return None
        nodes_ns = np.concatenate([[from_ns], t_ns[first:last], [until_ns]])
        s = 1e-9 * (t_ns - from_ns)
        at_s = 1e-9 * (nodes_ns - from_ns)
        at = np.column_stack([np.interp(at_s, s, axis) for axis in rates.T])
        steps = 0.5 * (at[1:] + at[:-1]) * np.diff(at_s)[:, np.newaxis]
        before = np.cumsum(steps, axis=0) - steps
        turn: Floats = steps.sum(axis=0) + 0.5 * np.cross(before, steps).sum(axis=0)
        return turn


def turn_covariance(turn_rad: Floats, passed_s: float, gyro: Sensor) -> Floats:
    """Covariance (3, 3) of a turn (3,) integrated from a gyro's rates, rad^2: its scale, its axes and its noise.

    Scale errs along each axis by its part of the turn, a misalignment ``m`` by ``m x turn``; white noise of one-sided
    density ``d`` integrates to ``d^2 t / 2``. The bias is left out: it is the same from turn to turn. A scale or
    misalignment that is not stated counts as :data:`_UNSTATED_SCALE` and :data:`_UNSTATED_AXES_RAD`.
    """
    scale = gyro.gyro_scale_sigma or _UNSTATED_SCALE
    axes_rad = gyro.misalignment_sigma_rad or _UNSTATED_AXES_RAD
    across = float(turn_rad @ turn_rad) * np.eye(3) - np.outer(turn_rad, turn_rad)
    noise = 0.5 * gyro.gyro_noise_radps_rthz**2 * passed_s
    covariance: Floats = scale**2 * np.diag(turn_rad**2) + axes_rad**2 * across
    return covariance + noise * np.eye(3)


def _motion(airspeed_mps: float, climb_mps: float, roll_rad: float, pitch_rad: float) -> VehicleMotion:
    """Level along the heading and up, turned into body axes."""
    level_mps = np.sqrt(max(airspeed_mps**2 - climb_mps**2, 0.0))
    body_from_path = exp_rotation(np.array([-roll_rad, 0.0, 0.0])) @ exp_rotation(np.array([0.0, -pitch_rad, 0.0]))
    velocity: Floats = body_from_path @ np.array([level_mps, 0.0, -climb_mps])
    covariance: Floats = (body_from_path * np.array(_UNTOLD_MPS) ** 2) @ body_from_path.T
    return VehicleMotion(velocity, covariance)
