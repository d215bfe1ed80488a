"""How the aircraft flew at an exposure: attitude, and velocity in body axes with covariance, as the autopilot told.

Cameras that expose a few milliseconds apart are moved against each other by the flight: 22 m/s for 3 ms are 66 mm, on
a two-metre baseline. Along the path that is known; wind, sideslip and the autopilot's mounting are in the covariance.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from companion.core.stereo.rotation import exp_rotation
from companion.records import Floats, VehicleState

_STATES = 64  # some seconds of attitudes at the usual rates
_ATTITUDE_NS = 500_000_000  # an attitude older than this is not that of the exposure (choice)
# the ground's velocity against the air, and climb and sideslip that are not told: along and across the path, and
# vertical, 1 sigma (choice: a light breeze; a pitch that is wrong by 1.5 degrees at 20 m/s)
_UNTOLD_MPS = (3.0, 3.0, 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class VehicleMotion:
    """Velocity (3,) over ground, m/s, body axes, and its covariance (3, 3)."""

    velocity_mps: Floats
    covariance: Floats


STILL = VehicleMotion(np.zeros(3), np.zeros((3, 3)))
"""Where nobody tells how the aircraft flies."""


@dataclass(slots=True)
class VehicleTrack:
    """The autopilot's last states."""

    _states: deque[VehicleState] = field(default_factory=lambda: deque(maxlen=_STATES))

    def add(self, state: VehicleState) -> None:
        """Take the newest state."""
        self._states.append(state)

    @property
    def newest(self) -> VehicleState | None:
        """The state told last; None before the first."""
        return self._states[-1] if self._states else None

    def attitude(self, t_host_ns: int) -> tuple[float, float] | None:
        """Roll and pitch at an instant, between the states that the autopilot sent; None without one nearby."""
        if not self._near(t_host_ns):
            return None
        return self._at(t_host_ns, lambda state: state.roll_rad), self._at(t_host_ns, lambda state: state.pitch_rad)

    def on_ground(self, t_host_ns: int) -> bool | None:
        """Whether the autopilot had said so by an instant, or says so first; None where it does not tell."""
        until = [state.on_ground for state in self._states if state.received_host_ns <= t_host_ns]
        return until[-1] if until else next((state.on_ground for state in self._states), None)

    def motion(self, t_host_ns: int) -> VehicleMotion:
        """Velocity at an instant, by airspeed, climb rate and attitude; along the body's x where none is nearby."""
        if not self._near(t_host_ns):
            return STILL if self.newest is None else _motion(self.newest.airspeed_mps, 0.0, 0.0, 0.0)
        roll_rad, pitch_rad, airspeed_mps, climb_mps = (
            self._at(t_host_ns, quantity)
            for quantity in (
                lambda state: state.roll_rad,
                lambda state: state.pitch_rad,
                lambda state: state.airspeed_mps,
                lambda state: state.climb_mps,
            )
        )
        return _motion(airspeed_mps, climb_mps, roll_rad, pitch_rad)

    def _near(self, t_host_ns: int) -> bool:
        return any(abs(state.received_host_ns - t_host_ns) <= _ATTITUDE_NS for state in self._states)

    def _at(self, t_host_ns: int, quantity: Callable[[VehicleState], float]) -> float:
        since_s = [1e-9 * (state.received_host_ns - t_host_ns) for state in self._states]
        return float(np.interp(0.0, since_s, [quantity(state) for state in self._states]))


def _motion(airspeed_mps: float, climb_mps: float, roll_rad: float, pitch_rad: float) -> VehicleMotion:
    """Level along the heading and up, turned into body axes."""
    level_mps = np.sqrt(max(airspeed_mps**2 - climb_mps**2, 0.0))
    body_from_path = exp_rotation(np.array([-roll_rad, 0.0, 0.0])) @ exp_rotation(np.array([0.0, -pitch_rad, 0.0]))
    velocity: Floats = body_from_path @ np.array([level_mps, 0.0, -climb_mps])
    covariance: Floats = (body_from_path * np.array(_UNTOLD_MPS) ** 2) @ body_from_path.T
    return VehicleMotion(velocity, covariance)
