"""Clocks behind the port: the companion's monotonic one, and one that a test turns by hand."""

from __future__ import annotations

import time


class MonotonicClock:
    """``CLOCK_MONOTONIC``: the host clock of every record."""

    def now_ns(self) -> int:
        """Nanoseconds since boot."""
        return time.monotonic_ns()

    def sleep_until(self, target_host_ns: int) -> None:
        """Sleep to the target or shortly after it; at once where it has passed."""
        while (remaining := target_host_ns - time.monotonic_ns()) > 0:
            time.sleep(remaining * 1e-9)


class ManualClock:
    """Stands still until it is slept on or set; for tests and for replays that need a clock."""

    def __init__(self, now_host_ns: int = 0) -> None:
        self._now_ns = now_host_ns

    def now_ns(self) -> int:
        """Give the time last set."""
        return self._now_ns

    def sleep_until(self, target_host_ns: int) -> None:
        """Jump to the target; never back."""
        self._now_ns = max(self._now_ns, target_host_ns)
