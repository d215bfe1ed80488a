"""The flexible aeroplane as ArduPilot's JSON physics: its servo outputs steer it, and it stands, rolls and flies.

One step of physics a frame, 1,200 a second. Channels are ArduPlane's defaults: 1 aileron, 2 elevator, 3 throttle,
4 rudder, 1000 to 2000 us; a larger aileron rolls right, a larger elevator pitches up, a larger rudder yaws right.
"""

from __future__ import annotations

import math

from companion.core.wing.model import WingModel
from companion.params.airframe import Airframe
from companion.sim.landing.aerodynamics import Controls
from companion.sim.landing.airplane import Airplane
from companion.sim.landing.flexible_aircraft import BodyState, FlexibleAircraft
from sitl_tests.ardupilot.rail import RATE_HZ, line_of, stamp_of

_FULL_RAD = 0.4  # deflection at the end of a servo's way
_MIDDLE_US, _HALF_US = 1500.0, 500.0
_REST_HEIGHT_M, _REST_PITCH_RAD = 0.2134, 0.044  # of the aeroplane on its springs
REST = (0.0, 0.0, -_REST_HEIGHT_M, 0.0, 0.0, 0.0, 0.0, _REST_PITCH_RAD, *[0.0] * 8)


def controls_of(servos: tuple[int, ...]) -> Controls:
    """Deflections that servo outputs in us command; an output of 0 is off and leaves its surface in the middle."""
    aileron, elevator, rudder = (
        max(min((servos[channel - 1] - _MIDDLE_US) / _HALF_US, 1.0), -1.0) if servos[channel - 1] else 0.0
        for channel in (1, 2, 4)
    )
    throttle = max(min((servos[2] - 1000.0) / 1000.0, 1.0), 0.0)
    return Controls(-_FULL_RAD * elevator, _FULL_RAD * aileron, -_FULL_RAD * rudder, throttle)


def line_of_body(body: BodyState) -> str:
    """Sensors of a frame in still air."""
    return line_of(
        list(body.rates_radps), list(body.specific_force_mps2), list(body.position_ned_m), list(body.euler_rad),
        list(body.velocity_ned_mps), math.hypot(*body.velocity_ned_mps),
    )  # fmt: skip


class SteeredFrames:
    """The JSON line of every frame; each call of :meth:`line` flies one.

    Parameters
    ----------
    airframe : Airframe
        Its wing, as believed.
    start : sequence of 16 floats
        State of :class:`companion.sim.landing.flexible_aircraft.FlexibleAircraft`; standing on the wheels by default.
    """

    def __init__(self, airframe: Airframe, start: tuple[float, ...] = REST) -> None:
        model = WingModel.from_airframe(airframe)
        self.aircraft = FlexibleAircraft(Airplane.of_airframe(airframe), model, list(start), 1_000_000_000 // RATE_HZ)
        self._controls = Controls(*start[12:16])

    def steer(self, servos: tuple[int, ...]) -> None:
        """Take the newest servo outputs."""
        self._controls = controls_of(servos)

    def line(self, frame: int) -> bytes:
        """Sensors of a frame, after one step under the controls."""
        self.aircraft.step(self._controls)
        return stamp_of(frame) + line_of_body(self.aircraft.body(self._controls)).encode()
