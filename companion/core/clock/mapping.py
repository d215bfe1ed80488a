"""The stamps' way to host time: piecewise linear, continuous, monotone, and the same whenever it is asked.

A better estimate never makes stamps jump: each exchange adds a knot, and the line from there on steers towards the
estimate at no more than :data:`MOST_SLEW`, so sample spacing is torn by 0.1 % at worst. What is still to be steered is
part of the bound. Earlier knots are kept, so a stamp that is asked for again (smoother, cameras) gets the same answer.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from companion.records import Ints

MOST_SLEW = 1e-3
_STEER_NS = 2.5e9  # half of the time after which a silent clock is lost: an error can only swing to its opposite
_KNOTS = 128
_HANDFUL = 64


@dataclass(frozen=True, slots=True)
class Knot:
    """From ``remote_ns`` on, ``host = host_ns + (1 - shrink) (remote - remote_ns)``, wrong by at most the bound."""

    remote_ns: int
    host_ns: int
    shrink: float
    bound_ns: float
    bound_rate: float

    def to_host(self, remote_ns: int) -> int:
        """Map one stamp."""
        elapsed = remote_ns - self.remote_ns
        return self.host_ns + elapsed - int(self.shrink * elapsed)

    def map(self, remote_ns: Ints) -> Ints:
        """Map stamps, any shape, as :meth:`to_host` does one."""
        elapsed = remote_ns - self.remote_ns
        host: Ints = elapsed + self.host_ns
        host -= (self.shrink * elapsed).astype(np.int64)
        return host

    def bound_at_ns(self, host_ns: int) -> int:
        """Bound the error of a stamp of this segment."""
        return int(self.bound_ns + self.bound_rate * abs(host_ns - self.host_ns)) + 1


class Mapping:
    """Knots from an estimate's history."""

    def __init__(self) -> None:
        self._knots: list[Knot] = []
        self._remote: list[int] = []

    def __bool__(self) -> bool:
        return bool(self._knots)

    def steer(
        self, host_ns: int, offset_ns: float, base_ns: int, skew: float, bound_ns: float, skew_bound: float
    ) -> None:
        """From ``host_ns`` on, approach the line ``remote = host + base + offset + skew (t - host)``."""
        if self._knots and host_ns <= self._knots[-1].host_ns:
            return
        if not self._knots:
            remote_ns, error_ns = host_ns + base_ns + round(offset_ns), 0.0
        else:
            last = self._knots[-1]
            remote_ns = last.remote_ns + round((host_ns - last.host_ns) / (1 - last.shrink))
            host_ns = last.to_host(remote_ns)
            error_ns = offset_ns + base_ns - (remote_ns - host_ns)
        slope = skew + min(max(error_ns / _STEER_NS, -MOST_SLEW), MOST_SLEW)
        self._add(Knot(remote_ns, host_ns, slope / (1 + slope), bound_ns + abs(error_ns), skew_bound))

    def _add(self, knot: Knot) -> None:
        self._knots.append(knot)
        self._remote.append(knot.remote_ns)
        if len(self._knots) > _KNOTS:
            del self._knots[0], self._remote[0]

    def to_host(self, t_ns: Ints) -> tuple[Ints, int, int, int]:
        """Map stamps, (n,) int64 with n > 0, exactly in integers but for the skew's share.

        Also give the oldest and the newest host stamp, and the largest bound [ns].
        """
        oldest, newest = _extremes(t_ns)
        knot = self._knots[-1]
        if oldest >= knot.remote_ns:
            low, high = knot.to_host(oldest), knot.to_host(newest)
            return knot.map(t_ns), low, high, knot.bound_at_ns(high)
        first, last = self._segment(oldest), self._segment(newest)
        low, high = self._knots[first].to_host(oldest), self._knots[last].to_host(newest)
        bound = max(self._knots[first].bound_at_ns(low), self._knots[last].bound_at_ns(high))
        if first == last:
            return self._knots[first].map(t_ns), low, high, bound
        knots = self._knots[first : last + 1]
        at = np.searchsorted([knot.remote_ns for knot in knots[1:]], t_ns, side="right")
        elapsed = t_ns - np.array([knot.remote_ns for knot in knots])[at]
        host: Ints = np.array([knot.host_ns for knot in knots])[at] + elapsed
        host -= (np.array([knot.shrink for knot in knots])[at] * elapsed).astype(np.int64)
        for i in range(first, last + 1):
            bound = max(bound, self._knots[i].bound_at_ns(self._knots[min(i + 1, last)].host_ns))
        return host, low, high, bound

    def _segment(self, remote_ns: int) -> int:
        return max(bisect_right(self._remote, remote_ns) - 1, 0)

    def newest(self) -> Knot:
        """Give the segment in force."""
        return self._knots[-1]


def _extremes(t_ns: Ints) -> tuple[int, int]:
    """Least and largest; a batch is a handful of samples, for which Python's own are five times faster."""
    if t_ns.size > _HANDFUL:
        return int(t_ns.min()), int(t_ns.max())
    stamps = t_ns.tolist()
    return min(stamps), max(stamps)
