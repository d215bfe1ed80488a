"""The approach that is flown, and the parameters of the landing, named after ArduPlane's."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LandingParameters:
    """Limits and rates of the landing; the names in capitals are ArduPlane's, whose rules they stand for.

    The flare begins at ``flare_alt_m`` (LAND_FLARE_ALT), or ``flare_sec`` (LAND_FLARE_SEC) before the ground, and ends
    at ``sink_mps`` (TECS_LAND_SINK). A correction that changes by more than ``slope_recalc_m`` (LAND_SLOPE_RCALC) lays
    the slope anew from the aeroplane's place; if that is steeper than the first by more than ``abort_rad``
    (LAND_ABORT_DEG), the aeroplane goes around, once. ``range_max_m`` and ``range_min_m`` are RNGFND1_MAX and
    RNGFND1_MIN. Below ``gate_m`` and above the shortest range the landing goes around after ``silence_s`` without a
    range, as the landing mission script does; ArduPlane does not.
    """

    flare_alt_m: float = 3.0
    flare_sec: float = 2.0
    sink_mps: float = 0.25
    slope_recalc_m: float = 2.0
    abort_rad: float = math.radians(3.0)
    range_max_m: float = 200.0
    range_min_m: float = 4.0
    gate_m: float = 25.0
    silence_s: float = 2.0


@dataclass(frozen=True, slots=True)
class Approach:
    """A level leg along north and a slope to the landing point at the origin.

    ``airspeed_mps`` is held on both; ``level_s`` is the length of the level leg: the time a tracker needs to settle,
    and more.
    """

    height_m: float = 60.0
    airspeed_mps: float = 17.0
    slope_rad: float = math.radians(6.0)
    level_s: float = 13.0

    @property
    def slope_m(self) -> float:
        """Length over ground of the slope."""
        return self.height_m / math.tan(self.slope_rad)

    @property
    def start_north_m(self) -> float:
        """Place at which the flight begins."""
        return -self.slope_m - self.level_s * self.airspeed_mps

    @property
    def longest_s(self) -> float:
        """Time after which a flight is over in any case: twice the slope and the level leg."""
        return self.level_s + 2.0 * self.slope_m / self.airspeed_mps
