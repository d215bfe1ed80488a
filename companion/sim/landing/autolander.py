"""The small autopilot: level leg, slope, flare, touch-down and roll-out, or a go-around."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from companion.sim.landing.aerodynamics import Controls
from companion.sim.landing.airplane import Airplane
from companion.sim.landing.approach import Approach, LandingParameters
from companion.sim.landing.control_loops import (
    PERIOD_S,
    AttitudeLoops,
    EnergyLoops,
    NavigationState,
    limited_pitch_rad,
    track_bank_rad,
)
from companion.sim.landing.glide_slope import GlideSlope
from companion.sim.landing.height_correction import HeightCorrection
from companion.sim.landing.trim import trimmed

_GO_AROUND_CLIMB_MPS = 3.0  # chosen: a gentle climb, at which the energy loops keep the airspeed
_FLARE_RATE_GAIN, _FLARE_INTEGRAL = 0.06, 0.10  # rad of pitch per m/s of sink error, and per m (tuned)
_FLARE_BLEND_S = 1.5  # chosen: from the slope's sink to the touch-down's: no jump of pitch
_LEAST_FLARE_PITCH_RAD = 0.0  # LAND_PITCH_DEG: the nose wheel must not touch first (convention)


class LandingStage(enum.StrEnum):
    """Part of the landing."""

    LEVEL = "level"
    SLOPE = "slope"
    FLARE = "flare"
    ROLL_OUT = "roll-out"
    GO_AROUND = "go-around"


@dataclass(frozen=True, slots=True)
class FlareBegin:
    """The autopilot's belief as its flare began."""

    t_s: float
    sink_mps: float


class Autolander:
    """Flies the approach; one call of :meth:`commands` a period of 20 ms.

    ``why`` is the reason of a go-around.
    """

    def __init__(self, plane: Airplane, approach: Approach, limits: LandingParameters) -> None:
        trim = trimmed(plane, approach.airspeed_mps)
        self.stage = LandingStage.LEVEL
        self.flare: FlareBegin | None = None
        self.why = ""
        self.correction = HeightCorrection(limits.range_max_m)
        self.slope = GlideSlope(approach, limits)
        self._limits = limits
        self._approach = approach
        self._attitude = AttitudeLoops(trim)
        self._energy = EnergyLoops(trim, trim.controls.throttle)
        self._flare_sum_m = 0.0
        self._flare_pitch_rad = 0.0
        self._ranged_s = math.inf

    @property
    def dropped(self) -> int:
        """Ranges that it took for a glitch."""
        return self.correction.dropped

    def commands(self, state: NavigationState, range_m: float | None, *, on_wheels: bool) -> Controls:
        """Controls for what is measured, the range finder's good reading if it has one, and the wheels' switch."""
        tilt_cosine = math.cos(state.roll_rad) * math.cos(state.pitch_rad)
        self.correction.update(state.t_s, range_m, tilt_cosine, state.height_m)
        if range_m is not None or self._ranged_s == math.inf:
            self._ranged_s = state.t_s
        correction_m = self.correction.correction_m(state.t_s) if self.stage is not LandingStage.LEVEL else 0.0
        height_m = state.height_m - correction_m
        self._advance(state, height_m, correction_m, on_wheels=on_wheels)
        bank_rad = track_bank_rad(state) if self.stage is not LandingStage.ROLL_OUT else 0.0
        pitch_rad, throttle = self._vertical(state, height_m)
        return self._attitude.controls(state, bank_rad, pitch_rad, throttle)

    def _advance(self, state: NavigationState, height_m: float, correction_m: float, *, on_wheels: bool) -> None:
        """The next stage, if its time has come."""
        if self.stage is LandingStage.LEVEL and state.north_m >= self.slope.starts_north_m:
            self.stage = LandingStage.SLOPE
        elif self.stage is LandingStage.SLOPE:
            self._watch_slope(state, height_m, correction_m)
        elif self.stage is LandingStage.FLARE and on_wheels:
            self.stage = LandingStage.ROLL_OUT

    def _watch_slope(self, state: NavigationState, height_m: float, correction_m: float) -> None:
        """Flare, or go around, as ArduPlane's landing decides, and as the mission script does without a range."""
        limits, sink_mps = self._limits, -state.climb_mps
        if self.slope.adjusted(correction_m, state.north_m, height_m):
            self._go_around("slope too steep")
            return
        below_time = height_m <= sink_mps * limits.flare_sec and state.north_m > 0.5 * self.slope.starts_north_m
        past = state.north_m >= 0.0 and not self.correction.in_range
        if height_m <= limits.flare_alt_m or below_time or past:
            self.stage = LandingStage.FLARE
            self.flare = FlareBegin(state.t_s, sink_mps)
            self._flare_pitch_rad = state.pitch_rad
        elif limits.range_min_m + 1.0 < height_m < limits.gate_m and state.t_s - self._ranged_s > limits.silence_s:
            self._go_around("no range below the gate")

    def _go_around(self, why: str) -> None:
        self.stage, self.why = LandingStage.GO_AROUND, why

    def _vertical(self, state: NavigationState, height_m: float) -> tuple[float, float]:
        """Pitch and throttle of the stage."""
        if self.stage is LandingStage.LEVEL:
            return self._energy.demands(state, self._approach.height_m - height_m, 0.0)
        if self.stage is LandingStage.SLOPE:
            error_m = self.slope.height_m(state.north_m) - height_m
            return self._energy.demands(state, error_m, -self.slope.sink_mps(state.ground_mps))
        if self.stage is LandingStage.GO_AROUND:
            return self._energy.demands(state, 0.0, _GO_AROUND_CLIMB_MPS)
        if self.stage is LandingStage.ROLL_OUT:
            return 0.0, 0.0
        return self._flare_pitch(state), 0.0

    def _flare_pitch(self, state: NavigationState) -> float:
        """Pitch that lets the sink fade from the slope's to the touch-down's."""
        assert self.flare is not None
        blend = min((state.t_s - self.flare.t_s) / _FLARE_BLEND_S, 1.0)
        sink_mps = (1.0 - blend) * self.flare.sink_mps + blend * self._limits.sink_mps
        error_mps = -sink_mps - state.climb_mps
        self._flare_sum_m += error_mps * PERIOD_S
        pitch = self._flare_pitch_rad + _FLARE_RATE_GAIN * error_mps + _FLARE_INTEGRAL * self._flare_sum_m
        return limited_pitch_rad(max(pitch, _LEAST_FLARE_PITCH_RAD))
