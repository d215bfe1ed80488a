"""The clock behind the port: the companion's monotonic one."""

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
