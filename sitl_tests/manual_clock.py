"""A clock that a test turns by hand."""

from __future__ import annotations


class ManualClock:
    """Stands still until it is slept on."""

    def __init__(self, now_host_ns: int = 0) -> None:
        self._now_ns = now_host_ns

    def now_ns(self) -> int:
        """Give the time last set."""
        return self._now_ns

    def sleep_until(self, target_host_ns: int) -> None:
        """Jump to the target; never back."""
        self._now_ns = max(self._now_ns, target_host_ns)
