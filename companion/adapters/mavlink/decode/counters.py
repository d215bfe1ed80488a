"""Counts refusals and reports each kind at once the first time, then at most once a second with the count since."""

from __future__ import annotations

from dataclasses import dataclass

from companion.rate_limiter import RateLimiter
from companion.records import Reject, Rejected

_PERIOD_NS = 1_000_000_000
_MOST_KINDS = 64  # bound of memory against invented subjects


@dataclass(slots=True)
class _Count:
    total: int = 0
    unreported: int = 0


class RefusalCounters:
    """Refusals by reason and subject; a flood of invented subjects shares one line."""

    def __init__(self) -> None:
        self._counts: dict[tuple[Reject, str], _Count] = {}
        self._reports = RateLimiter(_PERIOD_NS)

    def add(self, reason: Reject, what: str, count: int = 1) -> None:
        """Count ``count`` refusals."""
        key = (reason, what)
        if key not in self._counts and len(self._counts) >= _MOST_KINDS:
            key = (reason, "others")
        entry = self._counts.setdefault(key, _Count())
        entry.total += count
        entry.unreported += count

    def due(self, now_host_ns: int) -> list[Rejected]:
        """Give the reports that are due."""
        reports = []
        for (reason, what), entry in self._counts.items():
            if entry.unreported and self._reports.take(now_host_ns, (reason, what)):
                reports.append(Rejected(reason, what, now_host_ns, entry.unreported))
                entry.unreported = 0
        return reports

    def totals(self) -> dict[Reject, int]:
        """Sum per reason since the start."""
        sums: dict[Reject, int] = {}
        for (reason, _), entry in self._counts.items():
            sums[reason] = sums.get(reason, 0) + entry.total
        return sums
