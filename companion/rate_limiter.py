"""Rate limiting: an event happens at most once a period and key. No clock inside; imports nothing."""

from __future__ import annotations

from collections.abc import Hashable


class RateLimiter:
    """Lets the first event of a key pass, then one a period.

    ``period_ns`` is the shortest time between two events of one key, ns of whatever clock :meth:`take` is given.
    """

    def __init__(self, period_ns: float) -> None:
        self._period_ns = period_ns
        self._last_ns: dict[Hashable, int] = {}

    def ready(self, now_ns: int, key: Hashable = None, period_ns: float | None = None) -> bool:
        """Whether an event may happen now; ``period_ns`` in the place of the usual one."""
        last_ns = self._last_ns.get(key)
        return last_ns is None or now_ns - last_ns >= (self._period_ns if period_ns is None else period_ns)

    def take(self, now_ns: int, key: Hashable = None, period_ns: float | None = None) -> bool:
        """As :meth:`ready`; where it is True the event is taken to happen now."""
        ready = self.ready(now_ns, key, period_ns)
        if ready:
            self._last_ns[key] = now_ns
        return ready

    def reset(self) -> None:
        """Forget all events: the next one of every key passes."""
        self._last_ns.clear()
