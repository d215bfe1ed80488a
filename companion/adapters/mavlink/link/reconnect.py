"""Exponential back-off of reconnection."""

from __future__ import annotations

_FIRST_NS = 250_000_000  # convention: then twice as long each time
_LONGEST_NS = 8_000_000_000  # chosen: a link that comes back is found again within some seconds


class Backoff:
    """Pauses that double from 0.25 s to 8 s until :meth:`succeeded`."""

    def __init__(self) -> None:
        self._pause_ns = _FIRST_NS
        self._next_host_ns = 0

    def due(self, now_host_ns: int) -> bool:
        """Whether a try may be made now; the next one then waits twice as long."""
        if now_host_ns < self._next_host_ns:
            return False
        self._next_host_ns = now_host_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, _LONGEST_NS)
        return True

    def succeeded(self) -> None:
        """Start over with the shortest pause."""
        self._pause_ns = _FIRST_NS
