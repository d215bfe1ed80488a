"""STATUSTEXT without flooding: a text is not repeated at once, and many texts become few."""

from __future__ import annotations

from dataclasses import dataclass

from companion.records import Notice
from companion.units import Severity

_SECOND_NS = 1_000_000_000  # by definition
_REPEAT_NS = 10 * _SECOND_NS  # chosen: often enough for a reader, rare enough for a slow link
_REFILL_NS = _SECOND_NS
_BURST = 8  # texts at once, a convention
_RESERVED_FOR_ERRORS = 3  # chosen: places of the burst that chatter cannot take from errors
_MOST_TEXTS = 64  # bound of memory


@dataclass(slots=True)
class _Said:
    host_ns: int
    held: int = 0


class TextLimiter:
    """At most a burst of 8 texts, then one a second; the same text once in 10 s, then with a count.

    The last three places of the burst are for errors (severity 3 and worse), so that chatter cannot silence them.
    """

    def __init__(self) -> None:
        self.held = 0
        self._said: dict[tuple[int, str], _Said] = {}
        self._tokens = float(_BURST)
        self._refilled_host_ns: int | None = None

    def admit(self, notice: Notice) -> str | None:
        """The text to send now, or nothing."""
        now = notice.at_host_ns
        self._refill(now)
        key = (notice.severity, notice.text)
        said = self._said.get(key)
        if said is not None and 0 <= now - said.host_ns < _REPEAT_NS:
            self._hold(said)
            return None
        if self._tokens < (1 if notice.severity <= Severity.ERROR else 1 + _RESERVED_FOR_ERRORS):
            self._hold(said)
            return None
        self._tokens -= 1
        self._forget()
        held = said.held if said is not None else 0
        self._said[key] = _Said(now)
        return f"{notice.text} (x{held + 1})" if held else notice.text

    def _hold(self, said: _Said | None) -> None:
        self.held += 1
        if said is not None:
            said.held += 1

    def _refill(self, now: int) -> None:
        if self._refilled_host_ns is not None and now > self._refilled_host_ns:
            self._tokens = min(_BURST, self._tokens + (now - self._refilled_host_ns) / _REFILL_NS)
        self._refilled_host_ns = now

    def _forget(self) -> None:
        while len(self._said) >= _MOST_TEXTS:
            del self._said[min(self._said, key=lambda key: self._said[key].host_ns)]
