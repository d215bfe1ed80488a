"""Attitude of the aircraft at an exposure, and its velocity in body axes with covariance, from the autopilot.

Cameras that expose a few milliseconds apart are moved against each other by the flight: 22 m/s for 3 ms are 66 mm, on
a two-metre baseline. The velocity is that over ground, where the autopilot sends it, else airspeed and climb rate.
Wind, sideslip and the autopilot's mounting are in the covariance.
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
# a vehicle that is silent for longer may have taken off (choice, as for the landed state itself: the MAVLink decoder)
_GROUND_NS = 5_000_000_000
_ATTITUDE_NS = 500_000_000  # an attitude further away in time is not that of the exposure (choice)
# sigma of wind, sideslip and climb that no message states: along and across the path, and vertical (choice: a light
# breeze; a pitch that is wrong by 1.5 degrees at 20 m/s)
_UNTOLD_MPS = (3.0, 3.0, 0.5)
# sigma per axis of the velocity over ground, if the receiver states none (ArduPilot EK3_VELNE_M_NSE: 0.3 for u-blox M8)
_GROUND_MPS = 0.3
# least sigma per axis, whatever the receiver states: EK3 with its defaults adds 0.07 m/s of its own, the steady state
# of EK3_ACC_P_NSE 0.35 at 100 Hz and EK3_VELNE_M_NSE 0.3 at 5 Hz (derived), and the best receivers have as much
# (u-blox M9, 0.05 m/s)
_LEAST_GROUND_MPS = 0.1
# sigmas of a gyro whose airframe file states 0, the default: relative scale, and misalignment of its axes (choice: 1 %
# of scale; axes that are aligned by eye)
_UNSTATED_SCALE, _UNSTATED_AXES_RAD = 0.01, 0.01
_HEADING_RAD = 0.05  # heading of the autopilot, 1 sigma (choice: a compass that is calibrated)
LEVEL_RAD = 0.02
"""Pitch and roll of the autopilot's axes against the cameras' body axes, 1 sigma (choice: a mounting by hand)."""
_RATES_S = 4.0  # rates are kept so long: smoother's lag, queue and time between two pairs (choice)
_RATE_GAP_NS = 50_000_000  # over a longer gap of the rates the turn is unknown (choice)


@dataclass(frozen=True, slots=True, eq=False)
class VehicleMotion:
    """Velocity (3,), m/s, body axes, and its covariance (3, 3), (m/s)^2; ``over_ground``: not from airspeed."""

    velocity_mps: Floats
    covariance: Floats
    over_ground: bool = False


STILL = VehicleMotion(np.zeros(3), np.zeros((3, 3)))
"""Cameras that do not move."""
_UNTOLD = VehicleMotion(np.zeros(3), np.diag(np.square(_UNTOLD_MPS)))  # without any state of the aircraft


@dataclass(slots=True)
class VehicleTrack:
    """The last states of the autopilot.

    ``_lost_mps`` is the sigma of a velocity whose stated accuracy was lost or is old, m/s; None before the first one.
    """

    _states: deque[VehicleState] = field(default_factory=lambda: deque(maxlen=_STATES))
    _lost_mps: float | None = None

    def add(self, state: VehicleState) -> None:
        """Add the newest state. If its accuracy is lost, the sigma is not below the one stated last."""
        if state.velocity_sigma_mps is not None:
            self._lost_mps = max(state.velocity_sigma_mps, _GROUND_MPS)
        elif self._lost_mps is not None:
            state = replace(state, velocity_sigma_mps=self._lost_mps)
        self._states.append(state)

    @property
    def newest(self) -> VehicleState | None:
        """The newest state; None before the first."""
        return self._states[-1] if self._states else None

    def attitude(self, t_host_ns: int) -> tuple[float, float] | None:
        """Roll and pitch at an instant, rad, interpolated; None without a state nearby."""
        if not self._near(t_host_ns):
            return None
        return self._at(t_host_ns, _roll), self._at(t_host_ns, _pitch)

    def on_ground(self, t_host_ns: int) -> bool | None:
        """Whether the last state before an instant, or else the first, is on the ground; None if unknown or too old."""
        around = self._around(t_host_ns)
        if not around or t_host_ns - around[0].received_host_ns > _GROUND_NS:
            return None
        return around[0].on_ground

    def motion(self, t_host_ns: int) -> VehicleMotion:
        """Velocity at an instant: over ground, else by airspeed, climb and attitude; along x without a state nearby."""
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
        """Velocity by the navigation filter, turned into body axes by its attitude."""
        roll_rad, pitch_rad, yaw_rad = (self._at(t_host_ns, quantity) for quantity in (_roll, _pitch, _yaw))
        since_s = [1e-9 * (state.received_host_ns - t_host_ns) for state in around]
        ned_mps = np.array([state.velocity_ned_mps for state in around], dtype=np.float64)
        velocity_mps = np.array([np.interp(0.0, since_s, axis) for axis in ned_mps.T])
        velocity = _in_body_axes(velocity_mps, roll_rad, pitch_rad, yaw_rad)
        speed_mps = float(np.linalg.norm(velocity))
        sigma_mps = np.hypot(_stated_mps(around), speed_mps * np.array([0.0, _HEADING_RAD, LEVEL_RAD]))
        return VehicleMotion(velocity, np.diag(sigma_mps**2), over_ground=True)

    def _around(self, t_host_ns: int) -> list[VehicleState]:
        """The last state before an instant and the first after it, those that exist."""
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
    """Velocity (3,), m/s, body axes, of one state: over ground where it has that, else by airspeed and climb."""
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
    """Sigma per axis of the velocity over ground, m/s, by the accuracies stated around an instant; the larger one."""
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
    """Body rates of the last seconds by the root's gyro, and the turn between two instants."""

    _batches: deque[tuple[Ints, Floats]] = field(default_factory=deque)

    def add(self, t_host_ns: Ints, rate_radps: Floats) -> None:
        """Add rates (n, 3), rad/s, body axes, at times (n,). Samples not later than all before are left out."""
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
        """Rotation vector (3,), rad, of the body from one instant to a later one; None if rates are missing.

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

    An error of scale adds a share of the turn about each axis, a misalignment ``m`` adds ``m x turn``. White noise of
    one-sided density ``d`` (rad/s per root hertz) adds the variance ``d^2 t / 2``. The bias is left out: it is the same
    from turn to turn. A scale or misalignment that is not stated is :data:`_UNSTATED_SCALE` or
    :data:`_UNSTATED_AXES_RAD`.
    """
    scale = gyro.gyro_scale_sigma or _UNSTATED_SCALE
    axes_rad = gyro.misalignment_sigma_rad or _UNSTATED_AXES_RAD
    across = float(turn_rad @ turn_rad) * np.eye(3) - np.outer(turn_rad, turn_rad)
    noise = 0.5 * gyro.gyro_noise_radps_rthz**2 * passed_s
    covariance: Floats = scale**2 * np.diag(turn_rad**2) + axes_rad**2 * across
    return covariance + noise * np.eye(3)


def _motion(airspeed_mps: float, climb_mps: float, roll_rad: float, pitch_rad: float) -> VehicleMotion:
    """Velocity of airspeed and climb rate without sideslip, turned into body axes by pitch and roll."""
    level_mps = np.sqrt(max(airspeed_mps**2 - climb_mps**2, 0.0))
    body_from_path = exp_rotation(np.array([-roll_rad, 0.0, 0.0])) @ exp_rotation(np.array([0.0, -pitch_rad, 0.0]))
    velocity: Floats = body_from_path @ np.array([level_mps, 0.0, -climb_mps])
    covariance: Floats = (body_from_path * np.array(_UNTOLD_MPS) ** 2) @ body_from_path.T
    return VehicleMotion(velocity, covariance)
