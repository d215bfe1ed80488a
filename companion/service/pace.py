"""Whether this machine keeps up: how far apart the inertial loop's ticks come, and how much of its time vision needs.

Both are judged over windows of two seconds, longer than any pause for collection or a neighbour's burst. What was said
to be behind has to be well clear of the limit before it is said to keep up again, so that nothing flickers. Until then
each window repeats it: a process that has just taken over hears of it, and what is repeated no more is over.
"""

from __future__ import annotations

from dataclasses import dataclass

from companion.records import OVERLOADED

WINDOW_NS = 2_000_000_000  # chosen: longer than any pause for collection or a neighbour's burst
_LATE_NS = 20_000_000
"""Ticks are asked every 10 ms. Plans are made 40 ms apart and expire 10 ms after their instant: with ticks more than
20 ms apart their refinements come too late to be fired, and stamps of what was read are as uncertain (derived)."""
_IN_TIME_NS = 14_000_000  # chosen: well clear of the limit before, so that nothing flickers
_FULL, _SPARE = 0.95, 0.85
"""Share of its time that vision works: from 0.95 on each pair delays the next, until images are lost (choice)."""
_WINDOWS = 2  # in a row, before it is said: starting up is no verdict (choice)


@dataclass(frozen=True, slots=True)
class Overload:
    """Who cannot keep up, in words; no words when it does again."""

    who: str
    text: str

    @property
    def sentence(self) -> str:
        """For the operator."""
        return f"{OVERLOADED}: {self.text}" if self.text else f"this machine keeps up again: {self.who}"


@dataclass(slots=True)
class _Verdict:
    """Hysteresis: behind after two windows that were, clear after one that is; repeated as long as it is behind."""

    who: str
    behind: bool = False
    bad: int = 0

    def judge(self, is_late: bool, is_clear: bool, text: str) -> Overload | None:
        self.bad = self.bad + 1 if is_late else 0
        if not self.behind and self.bad >= _WINDOWS:
            self.behind = True
        elif self.behind and is_clear:
            self.behind = False
            return Overload(self.who, "")
        return Overload(self.who, text) if self.behind else None


class TickPace:
    """Pace of the inertial loop."""

    def __init__(self) -> None:
        self._verdict = _Verdict("inertial")
        self._since_ns: int | None = None
        self._ticks = 0

    def ticked(self, now_host_ns: int) -> Overload | None:
        """Take a tick; an overload with each window of one, and where it ends."""
        if self._since_ns is None:
            self._since_ns = now_host_ns
            return None
        self._ticks += 1
        passed_ns = now_host_ns - self._since_ns
        if passed_ns < WINDOW_NS:
            return None
        apart_ns = passed_ns / self._ticks
        self._since_ns, self._ticks = now_host_ns, 0
        text = f"inertial turns every {1e-6 * apart_ns:.0f} ms, wanted every 10"
        return self._verdict.judge(apart_ns > _LATE_NS, apart_ns < _IN_TIME_NS, text)


class VisionPace:
    """Pace of the vision process."""

    def __init__(self) -> None:
        self._verdict = _Verdict("vision")
        self._since_ns: int | None = None
        self._spent_ns = self._waited_ns = 0
        self._pairs = 0
        self._lost = 0.0

    def worked(self, spent_ns: int, pairs: int, lost_frames: int, waited_ns: int) -> None:
        """Take the work on one frame: its time, pairs that came of it, frames lost before it, and its age at the end.

        ``waited_ns`` is 0 where the frame's clock is not the host's.
        """
        self._spent_ns += spent_ns
        self._pairs += pairs
        self._lost += 0.5 * lost_frames  # both cameras lose one
        self._waited_ns = max(self._waited_ns, waited_ns)

    def looked(self, now_host_ns: int) -> Overload | None:
        """Judge, when a window is over; an overload with each window of one, and where it ends."""
        if self._since_ns is None:
            self._since_ns = now_host_ns
        passed_ns = now_host_ns - self._since_ns
        if passed_ns < WINDOW_NS:
            return None
        load = self._spent_ns / passed_ns
        shots = self._pairs + round(self._lost)
        needed = load * shots / max(self._pairs, 1)
        text = f"vision needs {needed:.1f} s a second, images wait {1e-9 * self._waited_ns:.1f} s"
        if shots > self._pairs:
            text += f", {shots - self._pairs} of {shots} shots skipped"
        self._since_ns = now_host_ns
        self._spent_ns = self._waited_ns = self._pairs = 0
        self._lost = 0.0
        return self._verdict.judge(load >= _FULL, load < _SPARE, text)
