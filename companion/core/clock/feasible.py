"""The lines that a remote clock may follow: a convex set of (offset, skew), cut down by every exchange.

A remote stamp ``r`` was read somewhere between our sending at ``s`` and our receiving at ``e`` (host). A clock that
runs forward therefore fulfils ``r(s) <= r <= r(e)``: two half-planes in (offset, skew) that hold whatever the link did.
Their intersection gives an estimate, and a bound that does not assume delays to be alike in both directions
(the linear-programming view of Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", 2002).

The set has a handful of corners, for which plain Python is faster than arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

Corner = tuple[float, float]


@dataclass(frozen=True, slots=True)
class FeasibleLines:
    """Every line ``offset + skew * (t - reference)`` that no exchange contradicts.

    Attributes
    ----------
    corners : tuple of (offset_ns, skew)
        Corners of the convex set, in order around it; offset at the reference time, skew dimensionless.
    """

    corners: tuple[Corner, ...]

    @classmethod
    def box(cls, least_ns: float, most_ns: float, skews: tuple[float, float]) -> FeasibleLines:
        """Give all lines between two offsets and two skews."""
        slow, fast = skews
        return cls(((least_ns, slow), (most_ns, slow), (most_ns, fast), (least_ns, fast)))

    def centre(self) -> tuple[float, float, float, float]:
        """Give offset [ns], skew, and the half-widths of both, at the reference time.

        The line is the mean of the two extreme ones, so that it lies in the set itself.
        """
        low, high = min(self.corners), max(self.corners)
        skew = 0.5 * (low[1] + high[1])
        half_skew = max(abs(corner[1] - skew) for corner in self.corners)
        return 0.5 * (low[0] + high[0]), skew, 0.5 * (high[0] - low[0]), half_skew

    def moved(self, later_ns: float) -> FeasibleLines:
        """Give the same lines for a reference time that is later by so much."""
        return FeasibleLines(tuple((offset + skew * later_ns, skew) for offset, skew in self.corners))

    def below(self, at_ns: float, limit_ns: float) -> FeasibleLines | None:
        """Keep the lines that are at most ``limit_ns`` at ``at_ns``; None when no line is left."""
        return self._cut([offset + skew * at_ns - limit_ns for offset, skew in self.corners])

    def above(self, at_ns: float, limit_ns: float) -> FeasibleLines | None:
        """Keep the lines that are at least ``limit_ns`` at ``at_ns``; None when no line is left."""
        return self._cut([limit_ns - offset - skew * at_ns for offset, skew in self.corners])

    def _cut(self, excess: list[float]) -> FeasibleLines | None:
        """Cut the polygon (Sutherland and Hodgman 1974); ``excess`` > 0 marks corners outside."""
        if max(excess) <= 0:
            return self
        kept: list[Corner] = []
        for i, corner in enumerate(self.corners):
            before = excess[i - 1]
            if (excess[i] <= 0) != (before <= 0):
                share = before / (before - excess[i])
                last = self.corners[i - 1]
                kept.append((last[0] + share * (corner[0] - last[0]), last[1] + share * (corner[1] - last[1])))
            if excess[i] <= 0:
                kept.append(corner)
        return FeasibleLines(tuple(kept)) if kept else None
