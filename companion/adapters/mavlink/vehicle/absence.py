"""Says that no autopilot is heard, and what is heard in its place: nothing, no frames, refused ones, or others."""

from __future__ import annotations

from collections.abc import Iterable

from companion.rate_limiter import RateLimiter
from companion.records import Notice
from companion.units import Severity

_PATIENCE_NS = 3_000_000_000  # chosen: three heartbeats of the autopilot must be missing
_REPEAT_NS = 30_000_000_000  # chosen: often enough for a reader, rare enough for a slow link
_MOST_NAMED = 8  # a flood of invented senders must take no memory, and a sentence names no more (choice)


def absence_text(others: Iterable[tuple[int, int]], *, junk: bool, refused: Iterable[str] = ()) -> str:
    """The sentence; ``others`` are the (system, component) that beat, ``junk`` says that bytes come.

    ``refused`` is why frames of a signed link did not get in, where some did not.
    """
    heard = ", ".join(f"{system}/{component}" for system, component in sorted(others))
    reasons = ", ".join(sorted(refused))
    if heard:
        ending = f", others are refused: {reasons} (--sign-key)" if reasons else ""
        return f"no autopilot heartbeat: only {heard} beat{ending}"
    if reasons:
        return f"no autopilot heartbeat: frames arrive, all are refused: {reasons} (--sign-key)"
    if junk:
        return "no autopilot heartbeat: bytes, but no heartbeat: baud rate?"
    return "no autopilot heartbeat: nothing arrives; check port, cable, baud rate and SERIALn_PROTOCOL 2"


class Absence:
    """Waits for the autopilot's first heartbeat, and complains after 3 s and then every 30 s."""

    def __init__(self) -> None:
        self._others: dict[tuple[int, int], None] = {}
        self._began_host_ns: int | None = None
        self._limiter = RateLimiter(_REPEAT_NS)
        self._text = ""

    def beat(self, system: int, component: int) -> None:
        """Take note of a heartbeat that is not the autopilot's."""
        if len(self._others) < _MOST_NAMED:
            self._others[system, component] = None

    def due(self, now_host_ns: int, *, junk: bool, refused: Iterable[str] = ()) -> Notice | None:
        """The complaint, if it is time for one; words as in :func:`absence_text`."""
        if self._began_host_ns is None:
            self._began_host_ns = now_host_ns
        if now_host_ns - self._began_host_ns < _PATIENCE_NS:
            return None
        text = absence_text(self._others, junk=junk, refused=refused)
        if text != self._text:
            self._limiter.reset()
        if not self._limiter.take(now_host_ns):
            return None
        self._text = text
        return Notice(Severity.WARNING, text, now_host_ns)

    def is_absence_notice(self, notice: Notice) -> bool:
        """Whether this is such a complaint: of no use to who hears it once the autopilot is there."""
        return notice.text == self._text
