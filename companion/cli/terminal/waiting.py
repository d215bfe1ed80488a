"""Words for the time before anything is estimated: what is waited for, and up to when."""

from __future__ import annotations

from dataclasses import dataclass

from companion.records import Health, ServiceStatus

START_S = 3.0
"""Usual time from the first process to the open links: ``python -m tools.bench start`` (measured)."""
FIRST_REPEAT_S = 5.0
"""Pause before an unchanged line is said again (choice); each further pause is twice as long."""
LONGEST_REPEAT_S = 60.0
"""Longest such pause (choice)."""
_NAMES = {"boot": "the autopilot's", "node_left": "the left node's", "node_right": "the right node's"}
_WAITING = "waiting for "


def waiting_text(status: ServiceStatus | None, elapsed_s: float, limit_s: float | None) -> str | None:
    """Sentence of what is waited for; None once there is something to estimate.

    ``status`` is the newest one, None while no process has spoken; ``limit_s`` is the end of the run, None where
    nothing but the user ends it.
    """
    if status is None:
        usual = f"some {START_S:g} s" if elapsed_s <= START_S else f"usually {START_S:g} s, this machine is busy"
        return f"starting the processes of the service ({usual})"
    if status.health is not Health.BOOT:
        return None
    until = "Ctrl-C ends it" if limit_s is None else f"at most {limit_s:g} s"
    return f"{_WAITING}{_sources(status.reason)} ({until})"


def _sources(reason: str) -> str:
    """Names of clocks as a person calls their owners."""
    said = reason.removeprefix(_WAITING)
    if not said.endswith(" clock"):
        return said
    names = [_NAMES.get(name, name) for name in said.removesuffix(" clock").split(", ")]
    joined = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    return f"{joined} clock{'s' if len(names) > 1 else ''}"


@dataclass(slots=True)
class RepeatPause:
    """Says when a line is printed: at once where its words have changed, else in growing pauses while waiting."""

    every_s: float
    _next_s: float = 0.0
    _pause_s: float = FIRST_REPEAT_S
    _last: str = ""

    def due(self, elapsed_s: float, wording: str | None) -> bool:
        """Whether a line is due; ``wording`` is what does not change while the same is waited for, None in work."""
        changed = wording is not None and wording != self._last
        if elapsed_s < self._next_s and not changed:
            return False
        again = wording is not None and not changed
        self._pause_s = min(2.0 * self._pause_s, LONGEST_REPEAT_S) if again else FIRST_REPEAT_S
        self._next_s = elapsed_s + (self.every_s if wording is None else self._pause_s)
        self._last = wording or ""
        return True
