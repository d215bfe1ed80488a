"""Tells a restarted clock from a late datagram, so that no stamp of one epoch is read in another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Bools, ClockName, Ints

BACK_NS = 1_000_000_000
CONFIRMATIONS = 3
_ADOPT_NS = 1_000_000_000


@dataclass(slots=True)
class _Source:
    newest_ns: int | None = None
    epoch: int = 0
    backward: int = 0


@dataclass(slots=True)
class _Epoch:
    number: int = 0
    since_host_ns: int = 0


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to do with the stamps of one batch.

    ``keep`` is None for all, else (n,); ``restart_at`` is the index of the first stamp after a restart, or -1.
    """

    keep: Bools | None = None
    restart_at: int = -1

    @property
    def dropped(self) -> int:
        """Number of stamps that must not be used."""
        return 0 if self.keep is None else int((~self.keep).sum())


_ALL_GOOD = Verdict()


class ClockWatch:
    """Follows the stamps of every source of every remote clock.

    A stamp more than 1 s behind its source's newest is dropped; the third in a row (the first, for a matched TIMESYNC
    answer, which cannot be an old one) means that the clock restarted. Then stamps of the other sources of that clock
    are dropped until they step back too, for 1 s at most.
    """

    def __init__(self) -> None:
        self._sources: dict[tuple[ClockName, str], _Source] = {}
        self._epochs: dict[ClockName, _Epoch] = {}

    def check(
        self, clock: ClockName, source: str, t_ns: Ints, received_host_ns: int, confirmations: int = CONFIRMATIONS
    ) -> Verdict:
        """Judge the stamps of one batch, in arrival order."""
        state = self._sources.setdefault((clock, source), _Source())
        epoch = self._epochs.setdefault(clock, _Epoch())
        stamps = t_ns.tolist()
        least, most = min(stamps), max(stamps)
        newest = most if state.newest_ns is None else max(most, state.newest_ns)
        if state.epoch == epoch.number and least >= newest - BACK_NS:
            state.newest_ns, state.backward = newest, 0
            return _ALL_GOOD
        return self._one_by_one(state, epoch, t_ns, received_host_ns, confirmations)

    def _one_by_one(
        self, state: _Source, epoch: _Epoch, t_ns: Ints, received_host_ns: int, confirmations: int
    ) -> Verdict:
        keep = np.ones(len(t_ns), dtype=np.bool_)
        restart_at = -1
        for index, stamp in enumerate(t_ns.tolist()):
            newest = stamp if state.newest_ns is None else state.newest_ns
            back = stamp < newest - BACK_NS
            if state.epoch != epoch.number:
                fresh = state.newest_ns is None or back or received_host_ns - epoch.since_host_ns > _ADOPT_NS
                keep[index] = fresh
                if fresh:
                    state.epoch, state.newest_ns, state.backward = epoch.number, stamp, 0
            elif not back:
                state.newest_ns, state.backward = max(newest, stamp), 0
            else:
                state.backward += 1
                keep[index] = confirmed = state.backward >= confirmations
                if confirmed:
                    epoch.number, epoch.since_host_ns = epoch.number + 1, received_host_ns
                    state.epoch, state.newest_ns, state.backward = epoch.number, stamp, 0
                    restart_at = index
        return Verdict(keep, restart_at)
