"""The stamps' way to host time: piecewise linear, continuous, monotone, and the same whenever it is asked.

A better estimate never makes stamps jump: each exchange adds a knot, and the line from there on steers towards the
estimate at no more than :data:`MOST_SLEW`, so sample spacing is torn by 0.1 % at worst. What is still to be steered is
part of the bound. Earlier knots are kept, so a stamp that is asked for again (smoother, cameras) gets the same answer.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from companion.records import Bools, Ints

MOST_SLEW = 1e-3
_STEER_NS = 2e9
_KNOTS = 128


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
        return self.host_ns + elapsed - round(self.shrink * elapsed)

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

    def to_host(self, t_ns: Ints) -> tuple[Ints, int]:
        """Map stamps, (n,) int64, exactly in integers but for the skew's share; also give the largest bound [ns]."""
        first = self._segment(int(t_ns.min()))
        last = self._segment(int(t_ns.max()))
        host = np.empty_like(t_ns)
        bound = 0
        for i in range(first, last + 1):
            knot = self._knots[i]
            chosen = slice(None) if first == last else self._inside(t_ns, i, first, last)
            elapsed = t_ns[chosen] - knot.remote_ns
            part = knot.host_ns + elapsed - np.rint(knot.shrink * elapsed).astype(np.int64)
            host[chosen] = part
            if part.size:
                bound = max(bound, knot.bound_at_ns(int(part.min())), knot.bound_at_ns(int(part.max())))
        return host, bound

    def _segment(self, remote_ns: int) -> int:
        return max(bisect_right(self._remote, remote_ns) - 1, 0)

    def _inside(self, t_ns: Ints, i: int, first: int, last: int) -> Bools:
        inside: Bools = np.ones(t_ns.shape, dtype=np.bool_)
        if i > first:
            inside &= t_ns >= self._remote[i]
        if i < last:
            inside &= t_ns < self._remote[i + 1]
        return inside

    def newest(self) -> Knot:
        """Give the segment in force."""
        return self._knots[-1]
