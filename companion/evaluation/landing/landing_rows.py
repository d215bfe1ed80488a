"""One landing as a row of plain values, and many of them as figures."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from companion.records import Floats
from companion.sim.landing.autolander import LandingStage
from companion.sim.landing.landing_flight import LandingFlight, RangeSource

Row = dict[str, Any]
FLARE_RATIO = 1.5
"""A flare above this multiple of the intended height counts as too high (choice)."""


class RangeKind(enum.StrEnum):
    """Range finder of a landing."""

    RIGID = "rigid"
    IN_TRIM = "rigid-in-trim"
    SPANWISE = "spanwise"
    TRUTH = "truth"
    FALSE_LONG = "truth-one-false-long"
    FALSE_SHORT = "truth-one-false-short"


RANGE_FINDERS = (RangeKind.RIGID, RangeKind.IN_TRIM, RangeKind.SPANWISE, RangeKind.TRUTH)
"""Those without a false reading among the true ones."""


@dataclass(frozen=True, slots=True)
class PathPoint:
    """Path of a landing at one instant; ``range_m`` is None where the range finder had none."""

    t_s: float
    north_m: float
    height_m: float
    range_m: float | None


class WatchedRange:
    """A range finder whose readings and the aeroplane's path are noted, five times a second."""

    def __init__(self, landing: LandingFlight, source: RangeSource) -> None:
        self._landing, self._source = landing, source
        self.path: list[PathPoint] = []
        self._next_ns = 0

    def reading_m(self, now_ns: int) -> float | None:
        """The source's reading."""
        range_m = self._source.reading_m(now_ns)
        if now_ns >= self._next_ns:
            self._next_ns += 200_000_000
            north, _, down = self._landing.present.position_ned_m
            self.path.append(PathPoint(now_ns * 1e-9, north, -down, range_m))
        return range_m


def landing_row(kind: RangeKind, landing: LandingFlight, path: Sequence[PathPoint], *, gusts: bool) -> Row:
    """Everything that the table and the picture need of one landing."""
    pilot, touch, flare = landing.pilot, landing.touch, landing.flare
    return {
        "range": str(kind),
        "gusts": gusts,
        "seed": landing.seed,
        "outcome": _outcome(landing),
        "why": pilot.why,
        "barometer_m": landing.senses.barometer_m,
        "flare": None if flare is None else asdict(flare),
        "touch": None if touch is None else asdict(touch),
        "dropped": pilot.dropped,
        "path": [(round(p.t_s, 2), round(p.north_m, 2), round(p.height_m, 3), p.range_m) for p in path],
    }


def _outcome(landing: LandingFlight) -> str:
    if landing.pilot.stage is LandingStage.GO_AROUND:
        return "went around"
    if landing.touch is None:
        return "flew on"
    return "landed" if landing.flare is not None else "landed without flare"


@dataclass(frozen=True, slots=True)
class LandingFigures:
    """Figures of the landings of one range finder in one air; arrays have an entry for each that touched down.

    ``no_flare`` counts those that met the ground, or flew on, without one. ``flare_error_m`` (k,) is the true height
    less the intended one as the flare began; ``sink_mps`` and ``north_m`` (n,) are at touch-down.
    """

    flights: int
    landed: int
    went_around: int
    no_flare: int
    high_flares: int
    flare_error_m: Floats
    sink_mps: Floats
    north_m: Floats


def figures(rows: Sequence[Row]) -> LandingFigures:
    """Figures of some rows."""
    flares = [row["flare"] for row in rows if row["flare"] is not None]
    touches = [row["touch"] for row in rows if row["touch"] is not None]
    high = sum(flare["height_m"] > FLARE_RATIO * flare["intended_m"] for flare in flares)
    return LandingFigures(
        flights=len(rows),
        landed=len(touches),
        went_around=sum(row["outcome"] == "went around" for row in rows),
        no_flare=sum(row["outcome"] in ("landed without flare", "flew on") for row in rows),
        high_flares=high,
        flare_error_m=np.array([flare["height_m"] - flare["intended_m"] for flare in flares], dtype=np.float64),
        sink_mps=np.array([touch["sink_mps"] for touch in touches], dtype=np.float64),
        north_m=np.array([touch["north_m"] for touch in touches], dtype=np.float64),
    )


def spread(values: Floats, digits: int = 1) -> str:
    """Median of some values (n,) and, of more than one, their extremes, in words of the table."""
    if not len(values):
        return "none"
    low, middle, high = (float(value) for value in np.percentile(values, [0, 50, 100]))
    if not math.isfinite(middle):
        return "none"
    extremes = f" ({low:.{digits}f} to {high:.{digits}f})" if len(values) > 1 else ""
    return f"{middle:.{digits}f}{extremes}"
