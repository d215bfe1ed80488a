"""The lines that a remote clock may follow: a convex set of (offset, skew), cut down by every exchange.

A remote stamp ``r`` was read somewhere between our sending at ``s`` and our receiving at ``e`` (host). A clock that
runs forward therefore fulfils ``r(s) <= r <= r(e)``: two half-planes in (offset, skew) that hold whatever the link did.
Their intersection gives an estimate, and a bound that does not assume delays to be alike in both directions
(the linear-programming view of Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", 2002).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.records import Floats


@dataclass(frozen=True, slots=True, eq=False)
class FeasibleLines:
    """Every line ``offset + skew * (t - reference)`` that no exchange contradicts.

    Attributes
    ----------
    corners : (k, 2) float64
        Corners (offset_ns, skew) of the convex set, in order around it; offset at the reference time, skew
        dimensionless.
    """

    corners: Floats

    @classmethod
    def box(cls, least_ns: float, most_ns: float, skews: tuple[float, float]) -> FeasibleLines:
        """Give all lines between two offsets and two skews."""
        slow, fast = skews
        return cls(np.array([[least_ns, slow], [most_ns, slow], [most_ns, fast], [least_ns, fast]]))

    def centre(self) -> tuple[float, float, float, float]:
        """Give offset [ns], skew, and the half-widths of both, at the reference time.

        The line is the mean of the two extreme ones, so that it lies in the set itself.
        """
        return _centre(self.corners)

    def moved(self, later_ns: float) -> FeasibleLines:
        """Give the same lines for a reference time that is later by so much."""
        return FeasibleLines(_moved(self.corners, float(later_ns)))

    def within(self, uppers: Floats, lowers: Floats) -> FeasibleLines | None:
        """Keep the lines that are at most some values and at least others at some times; None when no line is left.

        Parameters
        ----------
        uppers, lowers : (n, 2) float64
            Time [ns], relative to the reference, and value [ns] of each bound.
        """
        polygon = _cut(_cut(self.corners, uppers, 1.0), lowers, -1.0)
        return FeasibleLines(polygon) if len(polygon) else None

    def between(self, upper: tuple[float, float], lower: tuple[float, float]) -> FeasibleLines | None:
        """As :meth:`within`, with one bound of each kind, time and value; an infinite value bounds nothing."""
        polygon = _between(self.corners, *upper, *lower)
        return FeasibleLines(polygon) if len(polygon) else None


@compiled
def _centre(corners: Floats) -> tuple[float, float, float, float]:
    low, high = corners[0], corners[0]
    for k in range(1, len(corners)):
        offset, skew = corners[k]
        if offset < low[0] or (offset == low[0] and skew < low[1]):
            low = corners[k]
        if offset > high[0] or (offset == high[0] and skew > high[1]):
            high = corners[k]
    skew = 0.5 * (low[1] + high[1])
    half_skew = float(np.max(np.abs(corners[:, 1] - skew)))
    return 0.5 * (low[0] + high[0]), skew, 0.5 * (high[0] - low[0]), half_skew


@compiled
def _moved(corners: Floats, later_ns: float) -> Floats:
    moved = corners.copy()
    moved[:, 0] += corners[:, 1] * later_ns
    return moved


@compiled
def _between(corners: Floats, upper_at: float, upper: float, lower_at: float, lower: float) -> Floats:
    return _cut_once(_cut_once(corners, upper_at, upper, 1.0), lower_at, lower, -1.0)


@compiled
def _cut(corners: Floats, bounds: Floats, sign: float) -> Floats:
    """Cut the polygon by every bound, an upper one with ``sign`` 1, a lower with -1."""
    for k in range(len(bounds)):
        corners = _cut_once(corners, bounds[k, 0], bounds[k, 1], sign)
    return corners


@compiled
def _cut_once(corners: Floats, at: float, value: float, sign: float) -> Floats:
    """Cut the polygon by one bound (Sutherland and Hodgman 1974)."""
    excess = sign * (corners[:, 0] + corners[:, 1] * at - value)
    inside = excess <= 0.0
    if inside.all():
        return corners
    polygon, count = np.empty((2 * len(corners), 2)), 0
    for i in range(len(corners)):
        if inside[i] != inside[i - 1]:
            fraction = excess[i - 1] / (excess[i - 1] - excess[i])
            polygon[count] = corners[i - 1] + fraction * (corners[i] - corners[i - 1])
            count += 1
        if inside[i]:
            polygon[count] = corners[i]
            count += 1
    return polygon[:count].copy()
