"""The approach that is flown, and the parameters of the landing, named after ArduPlane's."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LandingParameters:
    """Limits and rates of the landing; the names in capitals are ArduPlane's, whose rules they stand for.

    Attributes
    ----------
    flare_alt_m, flare_sec : float
        LAND_FLARE_ALT, LAND_FLARE_SEC: the flare begins below that height, or that time above the ground.
    sink_mps : float
        TECS_LAND_SINK, at which the flare ends.
    slope_recalc_m : float
        LAND_SLOPE_RCALC: a correction that changes by more lays the slope anew from where the aeroplane is.
    abort_rad : float
        LAND_ABORT_DEG: a slope that is laid anew steeper than the first by more goes around, once.
    range_max_m, range_min_m : float
        RNGFND1_MAX, RNGFND1_MIN.
    gate_m, silence_s : float
        Below this height, and as long as ranges can come, the landing needs one within this time, or goes around
        (what the landing mission script asks; ArduPlane does not).
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
