"""The convergence offset that known distances reveal: pure arithmetic.

The axes of a pair that diverge by theta more than is believed make a distance Z read ``1/Z' = 1/Z + theta/B``; a focal
length or baseline that is believed too large by a factor makes it read that factor too long at every
distance. At one distance the two look alike; at several they come apart.
"""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

_APART = 1.4  # ratio of distances from which toe and scale separate


@dataclass(frozen=True, slots=True)
class Group:
    """Ranges to one known distance: ``sigma_m`` is of the known distance, ``scatter_m`` of one published range."""

    known_m: float
    known_sigma_m: float
    read_m: float
    scatter_m: float
    count: int


@dataclass(frozen=True, slots=True)
class Offset:
    """Convergence offset and scale, with their sigmas.

    Attributes
    ----------
    toe_rad, sigma_rad
        Divergence that is not believed yet, and its sigma; with the scale estimated too if the distances allow that.
    scale, scale_sigma
        Published over true distance after the toe is taken out; ``(1, inf)`` where the distances are too alike.
    """

    toe_rad: float
    sigma_rad: float
    scale: float
    scale_sigma: float
    chi2_per_freedom: float

    @property
    def scale_matters(self) -> bool:
        """Whether focal length or baseline look wrong, too."""
        return abs(self.scale - 1.0) > 3.0 * self.scale_sigma


def group(reference: Sequence[tuple[float, float]], read_m: Sequence[float]) -> Group:
    """Put the ranges of one leg or one place together; medians, so that a stray range counts for little."""
    centre = statistics.median(distance for distance, _ in reference)
    ratio = [read / distance for read, (distance, _) in zip(read_m, reference, strict=True)]
    middle = statistics.median(ratio)
    spread = 1.4826 * statistics.median(abs(entry - middle) for entry in ratio)
    return Group(
        centre, statistics.fmean(sigma for _, sigma in reference), middle * centre, spread * centre, len(ratio)
    )


def estimate(
    groups: Sequence[Group], baseline_m: float, slow_sigma_rad: float = 0.0, *, one_run: bool = False
) -> Offset:
    """Weighted least squares of ``1/Z' = s/Z + theta/B`` over the groups.

    Parameters
    ----------
    groups : sequence of Group
        One for each known distance or leg.
    baseline_m : float
        B.
    slow_sigma_rad : float
        An error of the toe that is common to all ranges of a group however many they are (trim bend changing from leg
        to leg); known distances may have such an error too, so neither shrinks with the number of ranges.
    one_run : bool
        The groups are of one run: both errors are common to all of them, and shrink with their number neither.

    Raises
    ------
    ValueError
        No group.
    """
    if not groups:
        raise ValueError("no group of ranges")
    rows = []
    for entry in groups:
        variance = (entry.scatter_m / math.sqrt(max(entry.count, 1)) / entry.read_m**2) ** 2
        if not one_run:
            variance += (entry.known_sigma_m / entry.known_m**2) ** 2 + (slow_sigma_rad / baseline_m) ** 2
        rows.append((1.0 / entry.known_m, 1.0 / entry.read_m, 1.0 / max(variance, 1e-18)))
    distances = [entry.known_m for entry in groups]
    solve = _toe_alone if max(distances) < _APART * min(distances) else _toe_and_scale
    offset = solve(rows, baseline_m)
    if not one_run:
        return offset
    slow = [(x, y + slow_sigma_rad / baseline_m, w) for x, y, w in rows]
    longer = [(x, y + entry.known_sigma_m * x**2, w) for (x, y, w), entry in zip(rows, groups, strict=True)]
    changed = [solve(shifted, baseline_m) for shifted in (slow, longer)]  # linear: by one sigma of either
    return dataclasses.replace(
        offset,
        sigma_rad=math.hypot(offset.sigma_rad, *(each.toe_rad - offset.toe_rad for each in changed)),
        scale_sigma=math.hypot(offset.scale_sigma, *(each.scale - offset.scale for each in changed)),
    )


def _toe_alone(rows: Sequence[tuple[float, float, float]], baseline_m: float) -> Offset:
    weight = sum(w for _, _, w in rows)
    level = sum(w * (y - x) for x, y, w in rows) / weight
    chi2 = sum(w * (y - x - level) ** 2 for x, y, w in rows)
    freedom = max(len(rows) - 1, 1)
    return Offset(level * baseline_m, baseline_m / math.sqrt(weight), 1.0, math.inf, chi2 / freedom)


def _toe_and_scale(rows: Sequence[tuple[float, float, float]], baseline_m: float) -> Offset:
    weight = sum(w for _, _, w in rows)
    mean_x = sum(w * x for x, _, w in rows) / weight
    mean_y = sum(w * y for _, y, w in rows) / weight
    spread = sum(w * (x - mean_x) ** 2 for x, _, w in rows)
    slope = sum(w * (x - mean_x) * (y - mean_y) for x, y, w in rows) / spread
    level = mean_y - slope * mean_x
    chi2 = sum(w * (y - slope * x - level) ** 2 for x, y, w in rows)
    free = Offset(
        level * baseline_m, baseline_m * math.sqrt(1.0 / weight + mean_x**2 / spread), 1.0 / slope,
        1.0 / math.sqrt(spread) / slope**2, chi2 / max(len(rows) - 2, 1),
    )  # fmt: skip
    if free.scale_matters:
        return free
    alone = _toe_alone(rows, baseline_m)
    return Offset(alone.toe_rad, alone.sigma_rad, free.scale, free.scale_sigma, alone.chi2_per_freedom)
