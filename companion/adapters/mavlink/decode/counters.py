"""Counts refusals and reports each kind at once the first time, then at most once a second with the count since."""

from __future__ import annotations

from companion.rate_limiter import RateLimiter
from companion.records import Reject, Rejected

_PERIOD_NS = 1_000_000_000  # chosen: a flood of refusals becomes one sentence a second
_MOST_KINDS = 64  # bound of memory against invented subjects


class RefusalCounters:
    """Refusals by reason and subject; a flood of invented subjects shares one line."""

    def __init__(self) -> None:
        self._unreported: dict[tuple[Reject, str], int] = {}
        self._reports = RateLimiter(_PERIOD_NS)

    def add(self, reason: Reject, what: str, count: int = 1) -> None:
        """Count ``count`` refusals."""
        key = (reason, what)
        if key not in self._unreported and len(self._unreported) >= _MOST_KINDS:
            key = (reason, "others")
        self._unreported[key] = self._unreported.get(key, 0) + count

    def due(self, now_host_ns: int) -> list[Rejected]:
        """Give the reports that are due."""
        reports = []
        for (reason, what), count in self._unreported.items():
            if count and self._reports.take(now_host_ns, (reason, what)):
                reports.append(Rejected(reason, what, now_host_ns, count))
                self._unreported[reason, what] = 0
        return reports
