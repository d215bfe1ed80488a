"""Map from remote stamps to host time: piecewise linear, continuous, monotone, and the same for every request.

A better estimate never makes stamps jump. Each exchange adds a knot. From there the line steers towards the estimate at
no more than :data:`MOST_SLEW`, so sample spacing changes by at most 0.1 %. The offset that is still to be steered is
part of the bound. Earlier knots are kept, so a stamp that is converted again (smoother, cameras) has the same result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.kernels.arrays import plain
from companion.native.library import ARRAY, INTEGER, kernel
from companion.records import Ints

MOST_SLEW = 1e-3  # sample spacing changes by 0.1 % at most, which does not disturb the filter (choice)
# time over which an error of offset is steered away (choice)
_STEER_NS = 2.5e9
_KNOTS = 128  # exchanges: twelve seconds at 10 Hz, more than the smoother needs (choice)


_to_host = kernel("clock_to_host", ARRAY, ARRAY, ARRAY, INTEGER, ARRAY, ARRAY)


@dataclass(frozen=True, slots=True)
class Knot:
    """Segment from ``remote_ns`` on: ``host = host_ns + (1 - shrink) (remote - remote_ns)``, and its error's bound."""

    remote_ns: int
    host_ns: int
    shrink: float
    bound_ns: float
    bound_rate: float

    def to_host(self, remote_ns: int) -> int:
        """Map one stamp."""
        elapsed = remote_ns - self.remote_ns
        return self.host_ns + elapsed - int(self.shrink * elapsed)

    def bound_at_ns(self, host_ns: int) -> int:
        """Bound of the error of a stamp of this segment, ns."""
        return int(self.bound_ns + self.bound_rate * abs(host_ns - self.host_ns)) + 1


class ClockMap:
    """The last knots of one clock, and their conversion of stamps."""

    def __init__(self) -> None:
        self._newest: Knot | None = None
        self._straight: tuple[float, float] | None = None  # skew, and bound once steering ends; None after that
        self._count = 0
        self._stamps = np.zeros((_KNOTS, 2), np.int64)  # of each knot: remote, host
        self._slopes = np.zeros((_KNOTS, 3))  # shrink, bound, rate of the bound

    def __bool__(self) -> bool:
        return self._newest is not None

    def steer(
        self, host_ns: int, offset_ns: float, base_ns: int, skew: float, bound_ns: float, skew_bound: float
    ) -> None:
        """Add a knot at ``host_ns``: from there approach ``remote = t + base + offset + skew (t - host)``."""
        last = self._newest
        if last is not None and host_ns <= last.host_ns:
            return
        if last is None:
            remote_ns, error_ns = host_ns + base_ns + round(offset_ns), 0.0
        else:
            remote_ns = last.remote_ns + round((host_ns - last.host_ns) / (1 - last.shrink))
            host_ns = last.to_host(remote_ns)
            error_ns = offset_ns + base_ns - (remote_ns - host_ns)
        slope = skew + min(max(error_ns / _STEER_NS, -MOST_SLEW), MOST_SLEW)
        unsteered_ns = max(abs(error_ns) - MOST_SLEW * _STEER_NS, 0.0)
        self._straight = skew, bound_ns + unsteered_ns + skew_bound * _STEER_NS
        self._add(Knot(remote_ns, host_ns, slope / (1 + slope), bound_ns + abs(error_ns), skew_bound))

    def coast(self, host_ns: int) -> None:
        """Add a knot where the last error is steered away, if no exchange came: by the skew alone from there."""
        last = self._newest
        if last is None or self._straight is None or host_ns <= last.host_ns + _STEER_NS:
            return
        skew, bound_ns = self._straight
        remote_ns = last.remote_ns + round(_STEER_NS / (1 - last.shrink))
        self._add(Knot(remote_ns, last.to_host(remote_ns), skew / (1 + skew), bound_ns, last.bound_rate))
        self._straight = None

    def _add(self, knot: Knot) -> None:
        self._newest = knot
        if self._count == _KNOTS:
            self._stamps[:-1], self._slopes[:-1] = self._stamps[1:], self._slopes[1:]
            self._count -= 1
        self._stamps[self._count] = knot.remote_ns, knot.host_ns
        self._slopes[self._count] = knot.shrink, knot.bound_ns, knot.bound_rate
        self._count += 1

    def to_host(self, t_ns: Ints) -> tuple[Ints, int, int, int]:
        """Convert stamps, (n,) int64 with n > 0, exactly in integers but for the product with the skew.

        Gives the host stamps, the oldest and the newest of them, and the largest bound [ns].
        """
        t_ns = plain(t_ns)
        host_ns, ends_ns = np.empty(len(t_ns), np.int64), np.empty(3, np.int64)
        _to_host(t_ns, self._stamps, self._slopes, self._count, host_ns, ends_ns)
        oldest_ns, newest_ns, bound_ns = ends_ns.tolist()
        return host_ns, oldest_ns, newest_ns, bound_ns

    def newest(self) -> Knot:
        """Give the segment in force."""
        assert self._newest is not None
        return self._newest
