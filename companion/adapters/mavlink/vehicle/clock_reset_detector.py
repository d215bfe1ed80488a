"""Tells a restarted clock from a late datagram, so that no stamp of one epoch is read in another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Bools, ClockName, Ints

BACK_NS = 1_000_000_000
CONFIRMATIONS = 3
_ADOPT_NS = 1_000_000_000


@dataclass(slots=True)
class _Epoch:
    number: int = 0
    since_host_ns: int = 0


@dataclass(slots=True)
class StampHistory:
    """What is known of one source's stamps."""

    epoch: _Epoch
    newest_ns: int | None = None
    number: int = 0
    backward: int = 0


@dataclass(frozen=True, slots=True)
class StampVerdict:
    """What to do with the stamps of one batch.

    ``keep`` is None for all, else (n,); ``restart_at`` is the index of the first stamp after a restart, or -1.
    """

    keep: Bools | None = None
    restart_at: int = -1

    @property
    def dropped(self) -> int:
        """Number of stamps that must not be used."""
        return 0 if self.keep is None else int((~self.keep).sum())


_ALL_GOOD = StampVerdict()


class ClockResetDetector:
    """Follows the stamps of every source of every remote clock.

    A stamp more than 1 s behind its source's newest is dropped; the third in a row (the first, for a matched TIMESYNC
    answer, which cannot be an old one) means that the clock restarted. Then stamps of the other sources of that clock
    are dropped until they step back too, for 1 s at most.
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
        """Judge the stamps of one batch, in arrival order."""
        stamps = t_ns.tolist()
        if self.onward(source, min(stamps), max(stamps)):
            return _ALL_GOOD
        return self._check_each(source, stamps, received_host_ns, confirmations)

    def onward(self, source: StampHistory, oldest_ns: int, newest_ns: int) -> bool:
        """Take a batch whose stamps lie between these, if nothing is wrong with any of them."""
        if source.newest_ns is not None and source.newest_ns > newest_ns:
            newest_ns = source.newest_ns
        if source.number != source.epoch.number or oldest_ns < newest_ns - BACK_NS:
            return False
        source.newest_ns, source.backward = newest_ns, 0
        return True

    def _check_each(
        self, source: StampHistory, stamps: list[int], received_host_ns: int, confirmations: int
    ) -> StampVerdict:
        epoch = source.epoch
        keep = np.ones(len(stamps), dtype=np.bool_)
        restart_at = -1
        for index, stamp in enumerate(stamps):
            newest = stamp if source.newest_ns is None else source.newest_ns
            back = stamp < newest - BACK_NS
            if source.number != epoch.number:
                fresh = source.newest_ns is None or back or received_host_ns - epoch.since_host_ns > _ADOPT_NS
                keep[index] = fresh
                if fresh:
                    source.number, source.newest_ns, source.backward = epoch.number, stamp, 0
            elif not back:
                source.newest_ns, source.backward = max(newest, stamp), 0
            else:
                source.backward += 1
                keep[index] = confirmed = source.backward >= confirmations
                if confirmed:
                    epoch.number, epoch.since_host_ns = epoch.number + 1, received_host_ns
                    source.number, source.newest_ns, source.backward = epoch.number, stamp, 0
                    restart_at = index
        return StampVerdict(keep, restart_at)
