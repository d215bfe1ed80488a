"""The slope to the landing point: which height is wanted where, laid anew when the range finder moves the ground."""

from __future__ import annotations

import math

from companion.sim.landing.approach import Approach, LandingParameters


class GlideSlope:
    """A straight line that aims at the flare's height before the landing point.

    ArduPlane's rules: it ends where the flare begins, at ``flare_sec`` times the sink (at most twice ``flare_alt``),
    as far before the point as the flare carries; a correction that changes by more than ``slope_recalc_m`` lays it
    anew from the aeroplane's corrected height, and one that is too steep then goes around.
    """

    def __init__(self, approach: Approach, limits: LandingParameters) -> None:
        self._limits = limits
        self._speed_mps = approach.airspeed_mps
        self.starts_north_m = -approach.slope_m
        self._from_north_m, self._from_height_m = -approach.slope_m, approach.height_m
        self._stable_m = 0.0
        self._first_rad = self._lay()

    def height_m(self, north_m: float) -> float:
        """Height wanted above the ground, never above where the slope begins."""
        before_m = max(north_m - self._from_north_m, 0.0)
        return self._from_height_m - math.tan(self._slope_rad) * before_m

    def sink_mps(self, ground_mps: float) -> float:
        """Rate at which it sinks below an aeroplane of that ground speed."""
        return math.tan(self._slope_rad) * ground_mps

    def adjusted(self, correction_m: float, north_m: float, corrected_m: float) -> bool:
        """Lay the slope anew where the correction asks for it; whether it has become too steep to be flown.

        ``correction_m`` is by how much the barometer reads too high, ``corrected_m`` the height above the ground with
        the correction used.
        """
        if abs(abs(self._stable_m) - abs(correction_m)) < self._limits.slope_recalc_m or north_m > -1.0:
            return False
        self._stable_m = correction_m
        self._from_north_m, self._from_height_m = north_m, corrected_m
        return self._lay() - self._first_rad > self._limits.abort_rad and correction_m < 0.0

    def _lay(self) -> float:
        """Slope to the aim point from where it begins, rad."""
        run_m = max(-self._from_north_m, 1.0)
        sink_mps = self._from_height_m * self._speed_mps / run_m
        limits = self._limits
        aim_m = min(max(limits.flare_sec * sink_mps, limits.flare_alt_m), 2.0 * limits.flare_alt_m)
        flare_s = aim_m / max(0.5 * (limits.sink_mps + sink_mps), 0.1)
        flare_m = min(flare_s * self._speed_mps, 0.5 * run_m)
        self._slope_rad = math.atan2(self._from_height_m - aim_m, run_m - flare_m)
        return self._slope_rad
