"""Tells a restarted clock from a late datagram, so that no stamp of one epoch is read in another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Bools, ClockName, Ints

BACK_NS = 1_000_000_000  # chosen: no datagram is so late; a restart goes back by more
AHEAD_NS = 1_000_000_000  # chosen: no link holds samples back so long
CONFIRMATIONS = 3  # in a row: a late datagram is a sample or two (choice)
_ADOPT_NS = 1_000_000_000  # chosen: samples of the old epoch are no longer on their way by then
_ALIVE_NS = 1_000_000_000  # chosen: a source that is silent for longer may itself have been restarted
WRAP_NS = (1 << 32) * 1_000_000  # by definition: milliseconds in 32 bits begin anew after 49.7 days
LEAPS = ": time leaps"
"""Ends the name of a source whose stamps were refused because they were ahead."""


@dataclass(slots=True)
class _Epoch:
    number: int = 0
    since_host_ns: int = 0


@dataclass(slots=True)
class StampHistory:
    """Epoch and newest stamp of one source."""

    epoch: _Epoch
    newest_ns: int | None = None
    number: int = 0
    backward: int = 0
    heard_host_ns: int = 0

    def limit_ns(self, received_host_ns: int) -> int:
        """Give the stamp beyond which a clock cannot be by now that goes on from the newest one."""
        return (self.newest_ns or 0) + max(received_host_ns - self.heard_host_ns, 0) + AHEAD_NS

    def unwrapped(self, t_ns: Ints, received_host_ns: int) -> Ints:
        """Stamps (n,) of 32-bit milliseconds, where the clock that goes on from the newest one has wrapped."""
        newest_ns = self.newest_ns
        if newest_ns is None or int(t_ns.min()) > newest_ns - WRAP_NS // 2:
            return t_ns
        laps_ns = t_ns + (newest_ns - t_ns + WRAP_NS // 2) // WRAP_NS * WRAP_NS
        goes_on = (laps_ns >= newest_ns - BACK_NS) & (laps_ns <= self.limit_ns(received_host_ns))
        return np.where(goes_on, laps_ns, t_ns)


@dataclass(frozen=True, slots=True)
class StampVerdict:
    """Stamps of one batch that may be used, and where its clock restarted.

    ``keep`` is None for all, else (n,); ``restart_at`` is the index of the first stamp after a restart, or -1;
    ``ahead`` of those that are not kept are of a clock that is ahead.
    """

    keep: Bools | None = None
    restart_at: int = -1
    ahead: int = 0

    @property
    def backward(self) -> int:
        """Number of stamps that must not be used because time went back."""
        return 0 if self.keep is None else int((~self.keep).sum()) - self.ahead


_ALL_GOOD = StampVerdict()


class ClockResetDetector:
    """Follows the stamps of every source of every remote clock.

    A stamp more than 1 s behind its source's newest is dropped; the third in a row (the first, for a matched TIMESYNC
    answer, which cannot be an old one) means that the clock restarted. Then stamps of the other sources of that clock
    are dropped until they step back too, for 1 s at most.

    A stamp that has got more than 1 s ahead of the time since the newest is another's, or damaged: it is dropped as
    long as the source goes on, and believed when that has been silent for 1 s.
    """

    def __init__(self) -> None:
        self._epochs: dict[ClockName, _Epoch] = {}

    def follow(self, clock: ClockName) -> StampHistory:
        """Begin to follow one more source of a clock."""
        return StampHistory(self._epochs.setdefault(clock, _Epoch()))

    def restart(self, clock: ClockName, received_host_ns: int) -> None:
        """Know from elsewhere that a clock begins anew."""
        epoch = self._epochs.setdefault(clock, _Epoch())
        epoch.number, epoch.since_host_ns = epoch.number + 1, received_host_ns

    def check(
        self, source: StampHistory, t_ns: Ints, received_host_ns: int, confirmations: int = CONFIRMATIONS
    ) -> StampVerdict:
        """Judge the stamps (n,) of one batch, in arrival order."""
        stamps = t_ns.tolist()
        if self.onward(source, min(stamps), max(stamps), received_host_ns):
            return _ALL_GOOD
        return self._check_each(source, stamps, received_host_ns, confirmations)

    def onward(self, source: StampHistory, oldest_ns: int, newest_ns: int, received_host_ns: int) -> bool:
        """Take a batch whose stamps lie between these, if nothing is wrong with any of them."""
        before_ns = source.newest_ns
        if before_ns is not None:
            if newest_ns > before_ns + AHEAD_NS and newest_ns > source.limit_ns(received_host_ns):
                return False
            if newest_ns < before_ns:
                newest_ns = before_ns
        if source.number != source.epoch.number or oldest_ns < newest_ns - BACK_NS:
            return False
        source.newest_ns, source.backward, source.heard_host_ns = newest_ns, 0, received_host_ns
        return True

    def _check_each(
        self, source: StampHistory, stamps: list[int], received_host_ns: int, confirmations: int
    ) -> StampVerdict:
        epoch = source.epoch
        keep = np.ones(len(stamps), dtype=np.bool_)
        restart_at, ahead = -1, 0
        for index, stamp in enumerate(stamps):
            newest = stamp if source.newest_ns is None else source.newest_ns
            back = stamp < newest - BACK_NS
            if source.number != epoch.number:
                fresh = source.newest_ns is None or back or received_host_ns - epoch.since_host_ns > _ADOPT_NS
                keep[index] = fresh
                if fresh:
                    source.number, source.newest_ns, source.backward = epoch.number, stamp, 0
                    source.heard_host_ns = received_host_ns
            elif self._leaps(source, stamp, received_host_ns):
                keep[index] = False
                ahead += 1
            elif not back:
                source.newest_ns, source.backward = max(newest, stamp), 0
                source.heard_host_ns = received_host_ns
            else:
                source.backward += 1
                keep[index] = confirmed = source.backward >= confirmations
                if confirmed:
                    epoch.number, epoch.since_host_ns = epoch.number + 1, received_host_ns
                    source.number, source.newest_ns, source.backward = epoch.number, stamp, 0
                    source.heard_host_ns = received_host_ns
                    restart_at = index
        return StampVerdict(keep, restart_at, ahead)

    def _leaps(self, source: StampHistory, stamp: int, received_host_ns: int) -> bool:
        """Whether a stamp is of a clock that is ahead of a source that lives."""
        if source.newest_ns is None or received_host_ns - source.heard_host_ns > _ALIVE_NS:
            return False
        return stamp > source.limit_ns(received_host_ns)
