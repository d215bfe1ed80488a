"""The exchanges that still tell something: the tightest of every second, for a minute, and the lines they leave."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from companion.core.clock.feasible import FeasibleLines
from companion.records import TimesyncReply

WINDOW_NS = 60_000_000_000
MOST_SKEW = 500e-6
ANY_SKEW = (-MOST_SKEW, MOST_SKEW)
SKEW_DRIFT_PER_S = 5e-8
"""How fast a skew may change: a crystal of 1 ppm/K that warms by 0.05 K/s."""
_BUCKET_NS = 1_000_000_000
_TOLERANCES_NS = (2e3, 2e4, 1e5, 5e5, 1e6, 2e6)
"""Granularity allowed to the remote clock. The coarser ones are for clocks that step (a simulated autopilot's advances
by whole physics frames), are tried only when the exchanges contradict each other without them, and widen the bound."""


@dataclass(frozen=True, slots=True)
class ClockFit:
    """The line in the middle of those that fit: at the newest exchange, relative to the window's base offset."""

    offset_ns: float
    skew: float
    bound_ns: float
    skew_bound: float


@dataclass(frozen=True, slots=True)
class _Bound:
    at_ns: int
    offset_ns: int


@dataclass(slots=True)
class _Bucket:
    number: int
    upper: _Bound
    lower: _Bound


class ExchangeWindow:
    """Bounds from the exchanges of the last minute; dropping the looser ones of a second only widens the answer.

    ``skews`` limits the skew where something is known of it: until the exchanges contradict that, or fill the window.
    """

    def __init__(self, first: TimesyncReply, skews: tuple[float, float] = ANY_SKEW) -> None:
        self.count = 0
        self.first_host_ns = first.sent_host_ns
        self.base_ns = first.remote_ns - first.received_host_ns
        self._buckets: deque[_Bucket] = deque()
        self._lines: FeasibleLines | None = None
        self._at_ns = first.received_host_ns
        self._tolerance_ns = _TOLERANCES_NS[0]
        self._skew = 0.0
        self._skews = skews
        self.add(first)

    def add(self, reply: TimesyncReply) -> ClockFit | None:
        """Take one exchange and give the fit; None, and nothing is kept, where it contradicts the others."""
        upper = _Bound(reply.sent_host_ns, reply.remote_ns - reply.sent_host_ns - self.base_ns)
        lower = _Bound(reply.received_host_ns, reply.remote_ns - reply.received_host_ns - self.base_ns)
        now = max(reply.received_host_ns, self._at_ns)
        number = now // _BUCKET_NS
        new_second = not self._buckets or number > self._buckets[-1].number
        lines = None if new_second else self._narrowed(upper, lower, now)
        if lines is None:
            lines = self._rebuilt(upper, lower, now)
        if lines is None:
            return None
        self._keep(upper, lower, number)
        self._lines, self._at_ns = lines, now
        self.count += 1
        return self._fit(lines)

    def _fit(self, lines: FeasibleLines) -> ClockFit:
        offset, self._skew, half_width, half_skew = lines.centre()
        coarse = self._tolerance_ns if self._tolerance_ns > _TOLERANCES_NS[0] else 0.0
        return ClockFit(offset, self._skew, half_width + coarse, half_skew)

    def _narrowed(self, upper: _Bound, lower: _Bound, now_ns: int) -> FeasibleLines | None:
        """Cut the last answer: within a second the skew cannot change by anything that matters."""
        if self._lines is None:
            return None
        moved = self._lines.moved(now_ns - self._at_ns)
        below = moved.below(upper.at_ns - now_ns, upper.offset_ns + self._tolerance_ns)
        return below and below.above(lower.at_ns - now_ns, lower.offset_ns - self._tolerance_ns)

    def _rebuilt(self, upper: _Bound, lower: _Bound, now_ns: int) -> FeasibleLines | None:
        """Intersect all bounds, with as little tolerance as they allow."""
        while self._buckets and self._buckets[0].upper.at_ns < now_ns - WINDOW_NS:
            self._buckets.popleft()
            self._skews = ANY_SKEW
        uppers = [_relative(bucket.upper, now_ns) for bucket in self._buckets] + [_relative(upper, now_ns)]
        lowers = [_relative(bucket.lower, now_ns) for bucket in self._buckets] + [_relative(lower, now_ns)]
        for tolerance in _TOLERANCES_NS:
            for skews in dict.fromkeys((self._skews, ANY_SKEW)):
                found = _intersected(uppers, lowers, tolerance, skews)
                if found is not None:
                    self._tolerance_ns, self._skews = tolerance, skews
                    return found
        return None

    def _keep(self, upper: _Bound, lower: _Bound, number: int) -> None:
        if not self._buckets or number > self._buckets[-1].number:
            self._buckets.append(_Bucket(number, upper, lower))
            return
        bucket, skew = self._buckets[-1], self._skew
        bucket.upper = min(bucket.upper, upper, key=lambda b: b.offset_ns - skew * (b.at_ns - upper.at_ns))
        bucket.lower = max(bucket.lower, lower, key=lambda b: b.offset_ns - skew * (b.at_ns - lower.at_ns))


def _relative(bound: _Bound, now_ns: int) -> tuple[float, float, float]:
    """Give a bound's time before now, its offset, and what the skew's drift may have added since."""
    at = float(bound.at_ns - now_ns)
    return at, float(bound.offset_ns), 0.5 * SKEW_DRIFT_PER_S * 1e-9 * at * at


def _intersected(
    uppers: list[tuple[float, float, float]],
    lowers: list[tuple[float, float, float]],
    tolerance_ns: float,
    skews: tuple[float, float],
) -> FeasibleLines | None:
    far = MOST_SKEW * max(-at for at, _, _ in uppers + lowers)
    least, most = max(low for _, low, _ in lowers) - 2 * far, min(high for _, high, _ in uppers) + 2 * far
    margin = tolerance_ns + WINDOW_NS * WINDOW_NS * SKEW_DRIFT_PER_S * 1e-9
    lines: FeasibleLines | None = FeasibleLines.box(least - margin, most + margin, skews)
    if most + margin <= least - margin:
        return None
    for at, high, drift in reversed(uppers):
        lines = lines and lines.below(at, high + drift + tolerance_ns)
    for at, low, drift in reversed(lowers):
        lines = lines and lines.above(at, low - drift - tolerance_ns)
    return lines
