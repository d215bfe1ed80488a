"""Lines that a remote clock may follow: a convex set of (offset, skew), cut by every exchange.

A remote stamp ``r`` was read somewhere between our sending at ``s`` and our receiving at ``e`` (host). A clock that
runs forward therefore fulfils ``r(s) <= r <= r(e)``: two half-planes in (offset, skew) that hold whatever the link did.
Their intersection gives an estimate and its bound, without assuming equal delays in both directions
(the linear-programming view of Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", 2002).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.native.library import ARRAY, REAL, kernel
from companion.records import Floats

_cut = kernel("clock_cut", ARRAY, REAL, ARRAY, ARRAY, ARRAY)
_centre = kernel("clock_centre", ARRAY, ARRAY)


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
        centre = np.empty(4)
        _centre(self.corners, centre)
        offset_ns, skew, half_offset_ns, half_skew = centre.tolist()
        return offset_ns, skew, half_offset_ns, half_skew

    def moved(self, later_ns: float) -> FeasibleLines:
        """Give the same lines for a reference time that is later by ``later_ns``."""
        moved = self.corners.copy()
        moved[:, 0] += moved[:, 1] * later_ns
        return FeasibleLines(moved)

    def within(self, uppers: Floats, lowers: Floats, later_ns: float = 0.0) -> FeasibleLines | None:
        """Keep the lines that are at most some values and at least others at some times; None when no line is left.

        Parameters
        ----------
        uppers, lowers : (n, 2) float64
            Time [ns], relative to the new reference, and value [ns] of each bound.
        later_ns : float
            Time from the reference of these lines to the new one: see :meth:`moved`.
        """
        polygon = np.empty((len(self.corners) + len(uppers) + len(lowers), 2))
        while (count := _cut(self.corners, later_ns, uppers, lowers, polygon)) > len(polygon):
            # by rounding, a cut may add more than one corner
            polygon = np.empty((count, 2))
        return FeasibleLines(polygon[:count]) if count else None

    def between(
        self, upper: tuple[float, float], lower: tuple[float, float], later_ns: float = 0.0
    ) -> FeasibleLines | None:
        """As :meth:`within`, with one bound of each kind, time and value; an infinite value bounds nothing."""
        return self.within(np.array([upper]), np.array([lower]), later_ns)
