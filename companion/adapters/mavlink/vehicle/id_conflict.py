"""Detects another sender with our system and component id.

Routers send our own frames back to us, so hearing our id proves nothing. What proves it is content that we did not send
lately: another Spanwise differs in its TIMESYNC requests, if in nothing else, for they carry its own clock.
"""

from __future__ import annotations

from collections import deque

from companion.adapters.mavlink.decode.message_records import Echo
from companion.adapters.mavlink.link.dialect import NAME_OF
from companion.rate_limiter import RateLimiter
from companion.records import Notice
from companion.units import Severity

_REMEMBERED = 512  # frames that we sent: some seconds of them (choice)
_CONFIRMATIONS = 3  # a frame from before our own restart is one (choice)
_WINDOW_NS = 10_000_000_000  # chosen: as long as the confirmations may take; strays are further apart
_REPEAT_NS = 30_000_000_000  # chosen: often enough for a reader, rare enough for a slow link


class IdConflictDetector:
    """Remembers what we sent, and judges what came back under our name."""

    def __init__(self) -> None:
        self.foreign = 0
        self._sent: dict[tuple[int, bytes], None] = {}  # in order of sending; looked up at once, in a flood too
        self._foreign_host_ns: deque[int] = deque(maxlen=_CONFIRMATIONS)
        self._warnings = RateLimiter(_REPEAT_NS)

    def sent(self, message: int, payload: bytes) -> None:
        """Take note of a frame of ours."""
        key = (message, payload.rstrip(b"\0"))
        self._sent.pop(key, None)
        self._sent[key] = None
        if len(self._sent) > _REMEMBERED:
            del self._sent[next(iter(self._sent))]

    def heard(self, echo: Echo) -> Notice | None:
        """Judge a frame with our ids; give a sentence for the operator when it is sure that another one sent it."""
        if (echo.message, echo.payload.rstrip(b"\0")) in self._sent:
            return None
        self.foreign += 1
        now = echo.received_host_ns
        self._foreign_host_ns.append(now)
        # one strange frame may be our own from before a restart, still on its way through a router
        if len(self._foreign_host_ns) < _CONFIRMATIONS or now - self._foreign_host_ns[0] > _WINDOW_NS:
            return None
        if not self._warnings.take(now):
            return None
        text = f"id {echo.system}/{echo.component} is used twice ({NAME_OF[echo.message]}): set SW_COMPID"
        return Notice(Severity.ERROR, text, now)
