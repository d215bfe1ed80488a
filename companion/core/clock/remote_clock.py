"""One remote clock: from exchanges to host stamps with a bound of their error, or a refusal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.clock.clock_map import ClockMap, Knot
from companion.core.clock.sync_window import (
    ANY_SKEW,
    FINE_NS,
    LONGEST_LAG_NS,
    SKEW_DRIFT_PER_S,
    ClockFit,
    ExchangeWindow,
    agree,
)
from companion.records import ClockName, ClockState, Ints, Reject, TimesyncReply

STALE_NS = 5_000_000_000
"""Silence after which the clock counts as lost, unless its bound is at most 2 ms (choice)."""
MOST_BOUND_NS = 10_000_000
"""Largest bound of a synced clock (choice)."""
MOST_ROUND_TRIP_NS = 1_000_000_000  # a longer one bounds nothing useful (choice)
MOST_DELAY_NS = 500_000_000
"""A live sample older than this on arrival was stamped before a restart of its clock (choice)."""
_FEWEST_EXCHANGES = 3  # two set a line, the third contradicts a false one (choice)
_SETTLED_EXCHANGES = 8  # enough for a clock that was not known well before: 0.8 s at 10 Hz (choice)
_SETTLED_SPAN_NS = 1_500_000_000  # a restarted clock waits no longer than this (choice)
_GOOD_BOUND_NS = 2_000_000  # at 5 Hz this is 3.6 degrees of the mode's phase (choice)
_BEFORE_FIRST_NS = 2_000_000_000  # samples may be older than the first exchange by what a link buffers (choice)
_MOST_LAG_NS = 50_000_000  # a restart goes back by seconds, a busy simulator's clock lags by milliseconds (choice)
_UNDECIDED_NS = 5_000_000_000  # a suspicion that nothing decides ends with a restart: a minute is lost else (choice)
_WARMING_SKEW = 20e-6
"""Change of a crystal's skew over a restart: half a minute of cooling of a cheap one (choice)."""
_AS_GOOD = 3.0  # ratio of the bounds after and before a restart at which the clock is used again (choice)
_LEAST_GOAL_NS = 50e3  # a smaller bound is not required after a restart (choice)


@dataclass(frozen=True, slots=True)
class _Before:
    """State of the clock before its restart: limits of its skew, and the bound to wait for, ns."""

    skews: tuple[float, float] = ANY_SKEW
    goal_ns: float = _GOOD_BOUND_NS


class RemoteClockEstimator:
    """Estimator of one clock.

    An exchange that contradicts all others suspends the clock at once. The next one that tells decides. If it
    contradicts that exchange, it alone was wrong. If it agrees with it and contradicts the old ones, the clock has
    restarted, and all older exchanges are void. One that agrees with both, as of a slow link, decides nothing. A
    restart goes back by seconds. A clock that is off by some milliseconds may be a simulated autopilot whose machine is
    busy, and which catches up. This must last a second to count as a restart, and nothing is converted meanwhile.

    The crystal stays the same, so a restarted clock keeps about its skew. It is used again when its bound is about what
    it was, or after 1.5 s. A hasty first estimate would be steered away slowly, and users that have learned the error
    of its stamps would see a drift.
    """

    def __init__(self, clock: ClockName) -> None:
        self.clock = clock
        self.discarded = 0
        self.restarts = 0
        self._window: ExchangeWindow | None = None
        self._mapping = ClockMap()
        self._suspect: TimesyncReply | None = None
        self._suspected_ns = 0
        self._skew = 0.0
        self._last_host_ns = 0
        self._before = _Before()

    def restart(self, at_host_ns: int) -> ClockState:
        """Forget everything: the clock's owner has restarted."""
        self._last_host_ns = self._latest_ns(at_host_ns)
        self._forget()
        self.restarts += 1
        return self.state()

    def exchange(self, reply: TimesyncReply) -> ClockState:
        """Take one exchange."""
        if not 0 <= reply.received_host_ns - reply.sent_host_ns <= MOST_ROUND_TRIP_NS:
            self.discarded += 1
            return self.state(reply.received_host_ns if self._window is None else None)
        self._last_host_ns = self._latest_ns(reply.received_host_ns)
        if self._window is None:
            self._window = ExchangeWindow(reply, self._before.skews)
            return self.state()
        fit = self._window.add(reply)
        if fit is None:
            self._contradicted(reply)
        elif self._suspect is None or not agree(self._suspect, reply, FINE_NS):
            self.discarded += self._suspect is not None
            self._suspect = None
            self._steer(self._window, fit, reply.received_host_ns)
        elif reply.received_host_ns - self._suspected_ns >= _UNDECIDED_NS:
            self._begin_anew(reply)
        return self.state()

    def to_host(self, t_ns: Ints, received_host_ns: int | None) -> tuple[Ints, int] | Reject:
        """Host time (n,) of stamps; see :meth:`companion.core.clock.bank.ClockBank.to_host`."""
        if self._window is None or not self._mapping or self._suspect is not None:
            return Reject.CLOCK_UNSYNCED
        if t_ns.size == 0:
            return t_ns.astype(np.int64), self._bound_at_ns(self._last_host_ns)
        self._mapping.coast(self._mapping.newest().to_host(int(t_ns.max())))
        host, oldest, newest, bound = self._mapping.to_host(t_ns)
        bound += self._drifted_ns(newest)
        if not self._in_time(newest, bound) or bound > MOST_BOUND_NS:
            return Reject.CLOCK_UNSYNCED
        if oldest < self._window.first_host_ns - _BEFORE_FIRST_NS:
            return Reject.TIME_BACKWARDS
        if received_host_ns is not None and newest > received_host_ns + bound:
            return Reject.CLOCK_UNSYNCED
        if received_host_ns is not None and newest < received_host_ns - MOST_DELAY_NS:
            return Reject.TIME_BACKWARDS
        return host, bound

    def state(self, now_host_ns: int | None = None) -> ClockState:
        """Give the clock's state, at ``now_host_ns`` or at the last exchange."""
        now = self._last_host_ns if now_host_ns is None else now_host_ns
        if not self._mapping:
            base_ns = 0 if self._window is None else self._window.base_ns
            return ClockState(self.clock, now, base_ns, 0.0, MOST_ROUND_TRIP_NS, False)
        self._mapping.coast(now)
        knot = self._mapping.newest()
        skew = knot.shrink / (1 - knot.shrink)
        offset = knot.remote_ns - knot.host_ns + round(skew * (now - knot.host_ns))
        bound = self._bound_at_ns(now)
        synced = self._in_time(now, bound) and self._is_synced(bound)
        return ClockState(self.clock, now, offset, self._skew * 1e6, bound, synced)

    def synced(self) -> bool:
        """Whether the clock was synced at the last exchange."""
        return bool(self._mapping) and self._is_synced(self._bound_at_ns(self._last_host_ns))

    def _is_synced(self, bound_ns: int) -> bool:
        return self._suspect is None and bound_ns <= MOST_BOUND_NS

    def _bound_at_ns(self, host_ns: int) -> int:
        return self._mapping.newest().bound_at_ns(host_ns) + self._drifted_ns(host_ns)

    def _drifted_ns(self, host_ns: int) -> int:
        """Bound of the offset by the skew's drift since the last exchange, ns; 0 within :data:`STALE_NS` of it."""
        silent_ns = host_ns - self._last_host_ns
        return int(0.5e-9 * SKEW_DRIFT_PER_S * silent_ns * silent_ns) if silent_ns > STALE_NS else 0

    def _in_time(self, host_ns: int, bound_ns: int) -> bool:
        """Whether the last exchange is recent, or the bound, which grows with time, is still small."""
        return host_ns <= self._last_host_ns + STALE_NS or bound_ns <= _GOOD_BOUND_NS

    def _latest_ns(self, host_ns: int) -> int:
        return host_ns if self._window is None else max(self._last_host_ns, host_ns)

    def _forget(self) -> None:
        if self._mapping:
            self._before = _remembered(self._skew, self._mapping.newest())
        self._window = None
        self._mapping = ClockMap()
        self._suspect = None
        self._skew = 0.0

    def _contradicted(self, reply: TimesyncReply) -> None:
        suspect = self._suspect
        self._suspect = reply
        if suspect is None or not agree(suspect, reply):
            self.discarded += suspect is not None
            self._suspected_ns = reply.received_host_ns
            return
        if self._lags(reply) and reply.received_host_ns - self._suspected_ns < LONGEST_LAG_NS:
            self.discarded += 1
            return
        self._begin_anew(suspect, reply)

    def _begin_anew(self, *replies: TimesyncReply) -> None:
        self._forget()
        self.restarts += 1
        for reply in replies:
            self.exchange(reply)

    def _lags(self, reply: TimesyncReply) -> bool:
        """Whether an exchange is off by so little that the clock may only lag."""
        if not self._mapping:
            return False
        middle_ns = (reply.sent_host_ns + reply.received_host_ns) // 2
        return abs(reply.remote_ns - middle_ns - self.state(middle_ns).offset_ns) < _MOST_LAG_NS

    def _steer(self, window: ExchangeWindow, fit: ClockFit, now_host_ns: int) -> None:
        self._skew = fit.skew
        if self._mapping or _good_enough(window, fit, now_host_ns, self._before.goal_ns):
            self._mapping.steer(now_host_ns, fit.offset_ns, window.base_ns, fit.skew, fit.bound_ns, fit.skew_bound)


def _remembered(skew: float, knot: Knot) -> _Before:
    margin = knot.bound_rate + _WARMING_SKEW
    goal_ns = min(max(_AS_GOOD * knot.bound_ns, _LEAST_GOAL_NS), _GOOD_BOUND_NS)
    return _Before((skew - margin, skew + margin), goal_ns)


def _good_enough(window: ExchangeWindow, fit: ClockFit, now_host_ns: int, goal_ns: float) -> bool:
    if window.count < _FEWEST_EXCHANGES or fit.bound_ns > MOST_BOUND_NS:
        return False
    settled = now_host_ns - window.first_host_ns >= _SETTLED_SPAN_NS
    was_good = goal_ns < _GOOD_BOUND_NS
    return settled or fit.bound_ns <= goal_ns or (window.count >= _SETTLED_EXCHANGES and not was_good)
