"""Exchanges that count: the tightest of every second, for a minute; and the lines that they allow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.clock.sync_set import FeasibleLines
from companion.records import TimesyncReply

WINDOW_NS = 60_000_000_000  # the skew's drift widens older exchanges by more than 0.09 ms (derived)
MOST_SKEW = 500e-6  # far beyond any crystal (choice)
ANY_SKEW = (-MOST_SKEW, MOST_SKEW)
SKEW_DRIFT_PER_S = 5e-8
"""How fast a skew may change: a crystal of 1 ppm/K that warms by 0.05 K/s (derived)."""
_BUCKET_NS = 1_000_000_000  # one pair of bounds a second: sixty in all (choice)
_ENOUGH = 4  # fewest exchanges in a second of which the tightest may be left out (choice)
_CAREFUL_NS = 10_000_000_000
"""Time at the start in which the tightest upper bound of a second is left out, if there are enough (choice)."""
_TOLERANCES_NS = (2e3, 2e4, 1e5, 5e5, 1e6, 2e6)
"""Granularity granted to the remote clock. The coarser ones are for clocks that step (a simulated autopilot's advances
by whole physics frames). They are tried only if the exchanges contradict each other without, and widen the bound."""
FINE_NS = _TOLERANCES_NS[1]
"""Granularity of a clock that is no simulator's (choice)."""
LONGEST_LAG_NS = 1_000_000_000
"""Longest time for which a simulated autopilot lags before it catches up (choice)."""
_NEAR_NS = 300_000_000
"""Exchanges within this time of a contradicting one may be of a clock that lagged a little (choice)."""
_NO_UPPER, _NO_LOWER = (0.0, np.inf), (0.0, -np.inf)  # time and offset of a bound without effect (convention)


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Middle of the lines that fit: offset at the newest exchange, ns, relative to the window's base offset."""

    offset_ns: float
    skew: float
    bound_ns: float
    skew_bound: float


class _Bound(NamedTuple):
    at_ns: int
    offset_ns: int


class _Bucket(NamedTuple):
    """Tightest bounds of a second: two upper ones, the tighter first (equal if there is one), and one lower."""

    number: int
    careful: bool
    exchanges: int
    uppers: tuple[_Bound, _Bound]
    lower: _Bound
    lagged: bool = False

    def joined(self, upper: _Bound, lower: _Bound, skew: float) -> _Bucket:
        """Give the bucket with one exchange more."""

        def at_once(bound: _Bound) -> float:
            return bound.offset_ns - skew * (bound.at_ns - upper.at_ns)

        previous = self.uppers if self.exchanges > 1 else self.uppers[:1]
        first, second = sorted((*previous, upper), key=at_once)[:2]
        largest = max(self.lower, lower, key=at_once)
        return _Bucket(self.number, self.careful, self.exchanges + 1, (first, second), largest, self.lagged)

    def upper(self) -> _Bound | None:
        """Give the upper bound that counts once the second is over; None for a second in which the clock lagged."""
        if self.lagged:
            return None
        return self.uppers[self.careful and self.exchanges >= _ENOUGH]


_Relative = tuple[float, float, float]


class ExchangeWindow:
    """Bounds from the exchanges of the last minute; leaving out the looser ones of a second only widens the set.

    A simulated autopilot's clock stands still while its machine is busy, as no crystal does. A stamp read then is too
    early, and gives an upper bound that is tight and false. An exchange that the others contradict is set aside, and so
    are those that follow within a second while they lag. Of a second with several of these no upper bound counts. In
    the first ten seconds, when nothing can contradict, and for a minute around a contradicting exchange, the tightest
    upper bound of every second is left out.

    ``skews`` limits the skew if it is known from before, until the exchanges contradict that or fill the window.
    """

    def __init__(self, first: TimesyncReply, skews: tuple[float, float] = ANY_SKEW) -> None:
        self.count = 0
        self.first_host_ns = first.sent_host_ns
        self.base_ns = first.remote_ns - first.received_host_ns
        self._closed: list[_Bucket] = []
        self._open: _Bucket | None = None
        self._lines: FeasibleLines | None = None
        self._at_ns = first.received_host_ns
        self._tolerance_ns = _TOLERANCES_NS[0]
        self._skew = 0.0
        self._skews = skews
        self._aside = 0  # exchanges in a row, and since when
        self._aside_ns = 0
        self._lagged_until = first.received_host_ns // _BUCKET_NS - 1
        self._careful_until_ns = first.received_host_ns + _CAREFUL_NS
        self.add(first)

    def add(self, reply: TimesyncReply) -> ClockFit | None:
        """Add one exchange and give the fit; None, without adding it, if it contradicts the others."""
        upper, lower = _bounds(reply, self.base_ns)
        now = max(reply.received_host_ns, self._at_ns)
        lines_before, later = self._lines, now - self._at_ns
        if lines_before is not None and _cut(lines_before, later, upper, lower, now, _TOLERANCES_NS[-1]) is None:
            self._aside_from(now)
            return None
        self._forget_before(now - WINDOW_NS)
        number = now // _BUCKET_NS
        last, same = self._open, self._open is not None and self._open.number == number
        if last is not None and same:
            bucket = last.joined(upper, lower, self._skew)
        else:
            lagged = number <= self._lagged_until
            bucket = _Bucket(number, now < self._careful_until_ns, 1, (upper, upper), lower, lagged)
        lines = None
        if lines_before is not None and same and self._closed:  # within a second the skew changes by little
            lines = _cut(lines_before, later, self._running(bucket), bucket.lower, now, self._tolerance_ns)
        closed = self._closed if same or last is None else [*self._closed, last]
        lines = lines or self._rebuilt(closed, bucket, now, FINE_NS)
        if lines is None and lines_before is not None:
            moved = lines_before.moved(later)
            if self._may_wait(moved, upper, now):
                self._lines, self._at_ns = moved, now
                return self._fit(moved)
        if lines is not None and self._aside:
            closed, bucket = self._grown_careful(closed, bucket, now)
            lines = self._rebuilt(closed, bucket, now, FINE_NS) or lines
        self._aside = 0
        lines = lines or self._rebuilt(closed, bucket, now, _TOLERANCES_NS[-1])
        if lines is None:
            return None
        self._closed, self._open, self._lines, self._at_ns = closed, bucket, lines, now
        self.count += 1
        return self._fit(lines)

    def _aside_from(self, now_ns: int) -> None:
        if not self._aside:
            self._aside_ns = now_ns
        self._aside += 1

    def _may_wait(self, lines: FeasibleLines, upper: _Bound, now_ns: int) -> bool:
        """Whether to set a contradicting exchange aside: the first one, and those of a clock that lags."""
        self._aside_from(now_ns)
        behind = lines.between((float(upper.at_ns - now_ns), upper.offset_ns + FINE_NS), _NO_LOWER) is None
        return self._aside == 1 or (behind and now_ns - self._aside_ns < LONGEST_LAG_NS)

    def _fit(self, lines: FeasibleLines) -> ClockFit:
        offset, self._skew, half_width, half_skew = lines.centre()
        coarse = self._tolerance_ns if self._tolerance_ns > _TOLERANCES_NS[0] else 0.0
        return ClockFit(offset, self._skew, half_width + coarse, half_skew)

    def _grown_careful(self, closed: list[_Bucket], bucket: _Bucket, now_ns: int) -> tuple[list[_Bucket], _Bucket]:
        """Leave out tight upper bounds around contradicting exchanges: near them others may lag unnoticed."""
        self._careful_until_ns = now_ns + WINDOW_NS
        marked = [each._replace(careful=True) for each in closed]
        first, last = (at // _BUCKET_NS for at in (self._aside_ns - _NEAR_NS, now_ns + _NEAR_NS))
        others = sum(not each.lagged and not first <= each.number <= last for each in marked)
        if self._aside < 2 or others < _ENOUGH:
            return marked, bucket
        self._lagged_until = last
        marked = [each._replace(lagged=each.lagged or first <= each.number <= last) for each in marked]
        return marked, bucket._replace(lagged=True)

    def _forget_before(self, oldest_ns: int) -> None:
        while self._closed and self._closed[0].lower.at_ns < oldest_ns:
            self._closed = self._closed[1:]
            self._skews = ANY_SKEW

    def _running(self, bucket: _Bucket) -> _Bound | None:
        """The upper bound that counts of the present second; if exchanges are rare, the only one."""
        if bucket.lagged:
            return None
        if not bucket.careful or (self._closed and self._closed[-1].exchanges < _ENOUGH):
            return bucket.uppers[0]
        return bucket.uppers[1] if bucket.exchanges > 1 or not self._closed else None

    def _rebuilt(self, closed: list[_Bucket], bucket: _Bucket, now_ns: int, most_ns: float) -> FeasibleLines | None:
        """Intersect all bounds with the least tolerance that leaves a line, up to ``most_ns`` or the present one."""
        running = self._running(bucket)
        highs = [*(each.upper() for each in closed), running]
        uppers = [_relative(high, now_ns) for high in highs if high is not None]
        lowers = [_relative(each.lower, now_ns) for each in (*closed, bucket)]
        if not uppers:
            return None
        for tolerance in [each for each in _TOLERANCES_NS if each <= max(most_ns, self._tolerance_ns)]:
            for skews in dict.fromkeys((self._skews, ANY_SKEW)):
                lines = _intersected(uppers, lowers, tolerance, skews)
                if lines is not None:
                    self._tolerance_ns, self._skews = tolerance, skews
                    return lines
        return None


def agree(first: TimesyncReply, second: TimesyncReply, tolerance_ns: float = _TOLERANCES_NS[-1]) -> bool:
    """Whether two exchanges can be of one clock."""
    base_ns = first.remote_ns - first.received_host_ns
    pairs = [_bounds(reply, base_ns) for reply in (first, second)]
    uppers, lowers = ([_relative(pair[i], second.received_host_ns) for pair in pairs] for i in (0, 1))
    return _intersected(uppers, lowers, tolerance_ns, ANY_SKEW) is not None


def _bounds(reply: TimesyncReply, base_ns: int) -> tuple[_Bound, _Bound]:
    """Upper bound of the offset at an exchange's sending, and lower bound at its receiving, ns."""
    upper = _Bound(reply.sent_host_ns, reply.remote_ns - reply.sent_host_ns - base_ns)
    return upper, _Bound(reply.received_host_ns, reply.remote_ns - reply.received_host_ns - base_ns)


def _cut(
    lines: FeasibleLines, later_ns: int, upper: _Bound | None, lower: _Bound, now_ns: int, tolerance_ns: float
) -> FeasibleLines | None:
    high = _NO_UPPER if upper is None else (float(upper.at_ns - now_ns), upper.offset_ns + tolerance_ns)
    return lines.between(high, (float(lower.at_ns - now_ns), lower.offset_ns - tolerance_ns), float(later_ns))


def _relative(bound: _Bound, now_ns: int) -> _Relative:
    """Give a bound's time relative to now (ns, not positive), its offset, and its widening by the skew's drift, ns."""
    at = float(bound.at_ns - now_ns)
    return at, float(bound.offset_ns), 0.5 * SKEW_DRIFT_PER_S * 1e-9 * at * at


def _intersected(
    uppers: list[_Relative], lowers: list[_Relative], tolerance_ns: float, skews: tuple[float, float]
) -> FeasibleLines | None:
    far = MOST_SKEW * max(-at for at, _, _ in uppers + lowers)
    least, most = max(low for _, low, _ in lowers) - 2 * far, min(high for _, high, _ in uppers) + 2 * far
    margin = tolerance_ns + WINDOW_NS * WINDOW_NS * SKEW_DRIFT_PER_S * 1e-9
    if most + margin <= least - margin:
        return None
    lines = FeasibleLines.box(least - margin, most + margin, skews)
    high = [(at, offset + drift + tolerance_ns) for at, offset, drift in reversed(uppers)]
    low = [(at, offset - drift - tolerance_ns) for at, offset, drift in reversed(lowers)]
    return lines.within(np.array(high).reshape(-1, 2), np.array(low))
