"""Links over which the served autopilot is heard, and the one that its commands go to."""

from __future__ import annotations

_SILENT_NS = 3_000_000_000  # chosen: three heartbeats must be missing before commands take another link


class AutopilotLinks:
    """Follows the served autopilot's heartbeats on each link.

    A command that goes out on two links to one autopilot is obeyed twice, and its two answers are taken for those of
    two commands. ``chosen`` is the number of the link that commands go to: the first on which it was heard, as long as
    it beats there; None before, when they go to all.
    """

    def __init__(self) -> None:
        self.chosen: int | None = None
        self._beats_ns: dict[int, int] = {}
        self._is_said = False

    def beat(self, link: int, now_host_ns: int) -> bool:
        """Take note of a heartbeat on a link; True, once, where the autopilot beats on two at a time."""
        self._beats_ns[link] = now_host_ns
        beating = [number for number, at_ns in self._beats_ns.items() if now_host_ns - at_ns <= _SILENT_NS]
        if self.chosen not in beating:
            self.chosen = link
        is_news = len(beating) > 1 and not self._is_said
        self._is_said |= is_news
        return is_news
