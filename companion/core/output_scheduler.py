"""Outputs on the timer: the mode state for graphs, and "alive, no range" in place of an old number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from companion.params.settings import Settings
from companion.records import CorrectedRange, ModeState, NoRange, OutputRecord, Reject, Validity

_RANGE_STALE_NS = 400_000_000  # under ArduPilot's 500 ms, so that an old number never lingers
_NEWS_NS = 2_000_000_000  # an older refusal no longer says why there is no range (choice)


@dataclass(slots=True)
class OutputScheduler:
    """Keeps the rates. A trusted range is published by the event that made it; silence is filled here."""

    orientation: int
    next_mode_ns: int = 0
    next_fill_ns: int = 0
    last_trusted_ns: int = 0
    last_reject: Reject | None = None  # of the newest range, None where that was trusted or is too long ago
    last_measured_ns: int = 0

    def tick(
        self,
        now_ns: int,
        fresh: Sequence[OutputRecord],
        describe: Callable[[], ModeState | None],
        validity: Validity | None,
        settings: Settings,
        *,
        synced: bool = True,
    ) -> list[OutputRecord]:
        """The records that are due, given those just made; ``describe`` is asked for the mode when that is due.

        ``synced`` is whether all clocks are: without a validity either they or samples are waited for.
        """
        for record in fresh:
            if isinstance(record, CorrectedRange):
                self._note(record, now_ns)
        outputs: list[OutputRecord] = []
        debug = validity is not None and settings.debug_rate_hz > 0 and now_ns >= self.next_mode_ns
        if debug and (mode := describe()) is not None:
            self.next_mode_ns = now_ns + int(1e9 / settings.debug_rate_hz)
            outputs.append(mode)
        if now_ns - self.last_trusted_ns > _RANGE_STALE_NS and now_ns >= self.next_fill_ns:
            self.next_fill_ns = now_ns + int(1e9 / settings.publish_rate_hz)
            outputs.append(NoRange(now_ns, self.orientation, self._reason(validity, synced, now_ns)))
        return outputs

    def _note(self, measured: CorrectedRange, now_ns: int) -> None:
        self.last_measured_ns, self.last_reject = now_ns, measured.reject
        if measured.trusted:
            self.last_trusted_ns = now_ns

    def _reason(self, validity: Validity | None, synced: bool, now_ns: int) -> Reject:
        """Why there is no range now: what was said of an older one is no news."""
        if validity is None:
            return Reject.NOT_SETTLED if synced else Reject.CLOCK_UNSYNCED
        if validity is Validity.STALE:
            return Reject.STALE
        if self.last_reject is not None and now_ns - self.last_measured_ns <= _NEWS_NS:
            return self.last_reject
        return Reject.NOT_SETTLED if validity is Validity.SETTLING else Reject.NO_PAIRS
