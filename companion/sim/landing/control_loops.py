"""Attitude, speed and track loops of a small autopilot, at 50 Hz; gains are for the aeroplane of this room.

Surfaces are scaled with the inverse square of the airspeed, as ArduPlane does, so that one set of gains flies all
speeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from companion.sim.landing.aerodynamics import Controls
from companion.sim.landing.trim import Trim
from companion.units import GRAVITY_MPS2

PERIOD_S = 0.02  # ArduPlane's main loop at its default 50 Hz (SCHED_LOOP_RATE)
_SURFACE_LIMIT_RAD = 0.40  # chosen: 23 degrees, before a surface stalls
_BANK_LIMIT_RAD = 0.5  # choice
_PITCH_LIMITS_RAD = (-0.30, 0.35)  # chosen: -17 and 20 degrees, near ArduPlane's defaults of -25 and 20
# chosen: a little quicker than ArduPlane's default of 0.5 s (RLL2SRV_TCONST)
_ROLL_TIME_S, _PITCH_TIME_S = 0.35, 0.4
_ROLL_GAIN, _ROLL_INTEGRAL = 0.12, 0.05  # aileron per rad/s of rate error, and per rad (tuned)
_PITCH_GAIN, _PITCH_INTEGRAL = 0.18, 0.25  # elevator, likewise (tuned)
_YAW_GAIN, _SLIP_GAIN = 0.15, 0.02  # rudder per rad/s of yaw beyond the turn, and per m/s^2 of side force (tuned)
_COURSE_GAIN_RADPS, _TRACK_GAIN_PER_S = 0.8, 0.25  # chosen: the track swings in without overshoot at approach speed
_CROSS_LIMIT_RAD = 0.4  # chosen: 23 degrees: the runway's line is met within the leg, and no turn is hard


class NavigationState(NamedTuple):
    """Output of the autopilot's own sensors and estimator; body axes and NED, metres from the landing point."""

    t_s: float
    north_m: float
    east_m: float
    height_m: float
    climb_mps: float
    ground_mps: float
    course_rad: float
    airspeed_mps: float
    roll_rad: float
    pitch_rad: float
    rates_radps: tuple[float, float, float]
    side_force_mps2: float


@dataclass(slots=True)
class AttitudeLoops:
    """Roll and pitch to surfaces, a yaw damper; one call a period."""

    trim: Trim
    _roll_sum_rad: float = 0.0
    _pitch_sum_rad: float = 0.0

    def controls(self, state: NavigationState, bank_rad: float, pitch_rad: float, throttle: float) -> Controls:
        """Surfaces for a wanted bank and pitch."""
        p, q, r = state.rates_radps
        speed = max(state.airspeed_mps, 0.5 * self.trim.airspeed_mps)
        scale = (self.trim.airspeed_mps / speed) ** 2
        turn_radps = GRAVITY_MPS2 / speed * math.tan(state.roll_rad)
        roll_error = (bank_rad - state.roll_rad) / _ROLL_TIME_S - p
        pitch_error = (pitch_rad - state.pitch_rad) / _PITCH_TIME_S + turn_radps * math.sin(state.roll_rad) - q
        self._roll_sum_rad = _limited(self._roll_sum_rad + roll_error * PERIOD_S, 1.0)
        self._pitch_sum_rad = _limited(self._pitch_sum_rad + pitch_error * PERIOD_S, 1.0)
        aileron = scale * (_ROLL_GAIN * roll_error + _ROLL_INTEGRAL * self._roll_sum_rad)
        nose_up = scale * (_PITCH_GAIN * pitch_error + _PITCH_INTEGRAL * self._pitch_sum_rad)
        rudder = scale * (_YAW_GAIN * (r - turn_radps * math.cos(state.roll_rad)) - _SLIP_GAIN * state.side_force_mps2)
        surfaces = (self.trim.controls.elevator_rad - nose_up, aileron, rudder)
        limited = [_limited(angle, _SURFACE_LIMIT_RAD) for angle in surfaces]
        return Controls(limited[0], limited[1], limited[2], min(max(throttle, 0.0), 1.0))


def track_bank_rad(state: NavigationState) -> float:
    """Bank that leads back to the runway's line (east 0, course north) and holds it."""
    wanted_rad = _limited(-_TRACK_GAIN_PER_S * state.east_m / max(state.ground_mps, 1.0), _CROSS_LIMIT_RAD)
    turn_radps = _COURSE_GAIN_RADPS * (wanted_rad - state.course_rad)
    return _limited(math.atan(turn_radps * state.ground_mps / GRAVITY_MPS2), _BANK_LIMIT_RAD)


@dataclass(slots=True)
class EnergyLoops:
    """Throttle holds the total energy, pitch its balance between height and speed (total energy control).

    Height goes by its error and rate, speed by its error; both are taken as specific energies over the weight, m.
    """

    trim: Trim
    level_throttle: float
    most_climb_mps: float = 4.0
    most_sink_mps: float = 4.0
    _throttle_sum: float = 0.0
    _pitch_sum_rad: float = 0.0

    def demands(self, state: NavigationState, height_error_m: float, feed_mps: float) -> tuple[float, float]:
        """Pitch and throttle for a height error and the climb rate of the wanted path."""
        climb_mps = min(max(feed_mps + 0.5 * height_error_m, -self.most_sink_mps), self.most_climb_mps)
        speed = max(state.airspeed_mps, 1.0)
        climb_error = climb_mps - state.climb_mps
        speed_error = self.trim.airspeed_mps - state.airspeed_mps
        energy = climb_error + 0.6 * speed_error * speed / GRAVITY_MPS2
        balance = climb_error - 0.25 * speed_error * speed / GRAVITY_MPS2
        per_climb = (1.0 - self.level_throttle) / self.most_climb_mps
        feed = self.level_throttle + per_climb * climb_mps
        throttle = feed + 0.08 * energy + self._throttle_sum
        if 0.0 < throttle < 1.0:
            self._throttle_sum += 0.02 * energy * PERIOD_S
        self._pitch_sum_rad = _limited(self._pitch_sum_rad + 0.4 * balance / speed * PERIOD_S, 0.2)
        pitch = self.trim.alpha_rad + (climb_mps + 0.7 * balance) / speed + self._pitch_sum_rad
        return limited_pitch_rad(pitch), min(max(throttle, 0.0), 1.0)


def limited_pitch_rad(pitch_rad: float) -> float:
    """Pitch within what the autopilot demands."""
    return min(max(pitch_rad, _PITCH_LIMITS_RAD[0]), _PITCH_LIMITS_RAD[1])


def _limited(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
