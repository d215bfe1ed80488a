"""The lines that a remote clock may follow: a convex set of (offset, skew), cut down by every exchange.

A remote stamp ``r`` was read somewhere between our sending at ``s`` and our receiving at ``e`` (host). A clock that
runs forward therefore fulfils ``r(s) <= r <= r(e)``: two half-planes in (offset, skew) that hold whatever the link did.
Their intersection gives an estimate, and a bound that does not assume delays to be alike in both directions
(the linear-programming view of Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", 2002).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Floats


@dataclass(frozen=True, slots=True)
class FeasibleLines:
    """Every line ``offset + skew * (t - reference)`` that no exchange contradicts.

    Attributes
    ----------
    offset_ns, skew : (k,) float64
        Corners of the convex set; offset at the reference time, skew dimensionless.
    """

    offset_ns: Floats
    skew: Floats

    def centre(self) -> tuple[float, float, float, float]:
        """Give offset [ns], skew, and the half-widths of both, at the reference time.

        The line is the mean of the two extreme ones, so that it lies in the set itself.
        """
        low, high = int(np.argmin(self.offset_ns)), int(np.argmax(self.offset_ns))
        offset = 0.5 * float(self.offset_ns[low] + self.offset_ns[high])
        skew = 0.5 * float(self.skew[low] + self.skew[high])
        half_width = 0.5 * float(self.offset_ns[high] - self.offset_ns[low])
        half_skew = float(np.max(np.abs(self.skew - skew)))
        return offset, skew, half_width, half_skew

    def moved(self, later_ns: float) -> FeasibleLines:
        """Give the same lines for a reference time that is later by so much."""
        return FeasibleLines(self.offset_ns + self.skew * later_ns, self.skew)

    def below(self, at_ns: float, limit_ns: float) -> FeasibleLines | None:
        """Keep the lines that are at most ``limit_ns`` at ``at_ns``."""
        return self._cut(self.offset_ns + self.skew * at_ns - limit_ns)

    def above(self, at_ns: float, limit_ns: float) -> FeasibleLines | None:
        """Keep the lines that are at least ``limit_ns`` at ``at_ns``."""
        return self._cut(limit_ns - self.offset_ns - self.skew * at_ns)

    def _cut(self, excess: Floats) -> FeasibleLines | None:
        if excess.max() <= 0:
            return self
        corners = _clip(np.stack([self.offset_ns, self.skew], 1), excess)
        return FeasibleLines(corners[:, 0], corners[:, 1]) if len(corners) else None


def feasible_lines(
    upper_at_ns: Floats, upper_ns: Floats, lower_at_ns: Floats, lower_ns: Floats, most_skew: float
) -> FeasibleLines | None:
    """Intersect the half-planes; None where they contradict each other.

    Parameters
    ----------
    upper_at_ns, upper_ns : (n,) float64
        The line at ``upper_at_ns`` (relative to the reference time) is at most ``upper_ns``.
    lower_at_ns, lower_ns : (n,) float64
        The line at ``lower_at_ns`` is at least ``lower_ns``.
    most_skew : float
        Largest skew that any clock has.
    """
    span = most_skew * float(max(np.max(np.abs(upper_at_ns)), np.max(np.abs(lower_at_ns))))
    top, bottom = float(np.min(upper_ns)) + 2 * span + 1.0, float(np.max(lower_ns)) - 2 * span - 1.0
    if bottom >= top:
        return None
    corners = np.array([[bottom, -most_skew], [top, -most_skew], [top, most_skew], [bottom, most_skew]])
    # each row: normal . (offset, skew) <= limit
    normals = np.concatenate(
        [np.stack([np.ones_like(upper_at_ns), upper_at_ns], 1), -np.stack([np.ones_like(lower_at_ns), lower_at_ns], 1)]
    )
    limits = np.concatenate([upper_ns, -lower_ns])
    for _ in range(4 * len(limits)):
        excess = normals @ corners.T - limits[:, None]
        worst = int(np.argmax(excess.max(axis=1)))
        if excess[worst].max() <= _ROUNDING_NS:
            return FeasibleLines(corners[:, 0].copy(), corners[:, 1].copy())
        corners = _clip(corners, excess[worst])
        if len(corners) == 0:
            return None
    return None


_ROUNDING_NS = 1e-3


def _clip(corners: Floats, excess: Floats) -> Floats:
    """Cut a convex polygon by one half-plane (Sutherland and Hodgman 1974); ``excess`` > 0 marks corners outside."""
    kept: list[Floats] = []
    for i in range(len(corners)):
        j = (i + 1) % len(corners)
        if excess[i] <= 0:
            kept.append(corners[i])
        if (excess[i] <= 0) != (excess[j] <= 0):
            share = excess[i] / (excess[i] - excess[j])
            kept.append(corners[i] + share * (corners[j] - corners[i]))
    return np.array(kept)
