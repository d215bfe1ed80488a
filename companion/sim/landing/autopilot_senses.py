"""Motion as the autopilot's own sensors have it: barometer, position, airspeed and attitude with their errors."""

from __future__ import annotations

import math

import numpy as np

from companion.sim.landing.control_loops import NavigationState
from companion.sim.landing.flexible_aircraft import BodyState

BAROMETER_SIGMA_M = 2.5
"""Error of a flight's barometer against the ground it lands on: drift with weather and warmth (choice)."""

_POSITION_SIGMA_M = 1.0  # GPS over the minute of an approach (choice)
# chosen: what an estimator leaves of barometer and pitot noise
_HEIGHT_NOISE_M, _CLIMB_NOISE_MPS, _SPEED_NOISE_MPS = 0.1, 0.05, 0.2
_AIRSPEED_SCALE_SIGMA = 0.02  # a calibrated pitot tube (choice)
_ATTITUDE_SIGMA_RAD = 0.009  # half a degree of an estimator's level (ArduPilot's accelerometer calibration)


class AutopilotSenses:
    """Errors of one flight, drawn from a generator of their own: equal for every range source."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.barometer_m = BAROMETER_SIGMA_M * float(rng.standard_normal())
        self._place_m = (_POSITION_SIGMA_M * rng.standard_normal(2)).tolist()
        self._airspeed_ratio = 1.0 + _AIRSPEED_SCALE_SIGMA * float(rng.standard_normal())
        self._tilt_rad = (_ATTITUDE_SIGMA_RAD * rng.standard_normal(2)).tolist()
        self._rng = rng

    def measured(self, t_s: float, body: BodyState, airspeed_mps: float) -> NavigationState:
        """The motion as the autopilot has it."""
        noise = self._rng.standard_normal(3).tolist()
        north, east, down = body.position_ned_m
        vn, ve, vd = body.velocity_ned_mps
        roll, pitch, _ = body.euler_rad
        return NavigationState(
            t_s=t_s,
            north_m=north + self._place_m[0],
            east_m=east + self._place_m[1],
            height_m=-down + self.barometer_m + _HEIGHT_NOISE_M * noise[0],
            climb_mps=-vd + _CLIMB_NOISE_MPS * noise[1],
            ground_mps=math.hypot(vn, ve),
            course_rad=math.atan2(ve, vn),
            airspeed_mps=airspeed_mps * self._airspeed_ratio + _SPEED_NOISE_MPS * noise[2],
            roll_rad=roll + self._tilt_rad[0],
            pitch_rad=pitch + self._tilt_rad[1],
            rates_radps=body.rates_radps,
            side_force_mps2=body.specific_force_mps2[1],
        )
