"""Pair left and right frames by exposure time, so that a missing, stale or extra frame never shifts the pairing."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from companion.records import Frame, FramePair, Reject, Rejected, Side

_FORGET_NS = 2_000_000_000  # a frame without a partner for so long will get none (choice)


class _FrameStamp(NamedTuple):
    """Mid-exposure of a frame and its number."""

    t_ns: int
    number: int


_BEFORE_ALL = _FrameStamp(-(2**62), 0)  # before the first frame (convention)


@dataclass(slots=True)
class FramePairer:
    """Hold each frame until its partner comes or can no longer come.

    Two frames are partners when their mid-exposures differ by at most ``tolerance_ns`` (less than half the shortest
    time between shots), no other waiting frame is nearer, and they do not name different plans. Frames of one side
    must come in order of exposure. One that comes again is refused, so that no pair is made twice. One that is more
    than two seconds older belongs to a camera whose clock restarted. Where two frames in order, of later numbers than
    the newest, are older than it, its stamp was wrong. Pairs are numbered from ``next_id``.
    """

    tolerance_ns: int = 8_000_000
    depth: int = 8
    next_id: int = 0
    _waiting: tuple[deque[Frame], deque[Frame]] = field(default_factory=lambda: (deque(), deque()))
    # stamp and number of each side's newest frame, and of the last that was older but of a later number
    _newest: list[_FrameStamp] = field(default_factory=lambda: [_BEFORE_ALL, _BEFORE_ALL])
    _behind: list[_FrameStamp | None] = field(default_factory=lambda: [None, None])

    def add(self, frame: Frame) -> tuple[list[FramePair], list[Rejected]]:
        """Take one frame. Give the pairs that it completes and the frames that remain without a partner."""
        queue, behind_ns = self._waiting[frame.side], self._newest[frame.side].t_ns - frame.mid_exposure_ns
        if 0 <= behind_ns <= _FORGET_NS and not self._newest_was_wrong(frame):
            return [], [self._lonely(frame)]
        unpaired = [self._lonely(queue.popleft()) for _ in range(len(queue))] if behind_ns > 0 else []
        self._newest[frame.side], self._behind[frame.side] = _FrameStamp(frame.mid_exposure_ns, frame.sequence), None
        queue.append(frame)
        pairs = self._match()
        return pairs, unpaired + self._expire(frame.mid_exposure_ns)

    def _newest_was_wrong(self, frame: Frame) -> bool:
        """Whether a frame that is older than the newest, and the one before it, were exposed after that all the same.

        One of them alone may itself have the wrong stamp.
        """
        if frame.sequence <= self._newest[frame.side].number:
            return False
        place = _FrameStamp(frame.mid_exposure_ns, frame.sequence)
        before, self._behind[frame.side] = self._behind[frame.side], place
        return before is not None and before.number < place.number and before.t_ns < place.t_ns

    def _match(self) -> list[FramePair]:
        left, right = self._waiting
        pairs: list[FramePair] = []
        best = self._nearest()
        while best is not None:
            i, j = best
            pairs.append(FramePair(self.next_id, left[i], right[j]))
            self.next_id += 1
            del left[i], right[j]
            best = self._nearest()
        return pairs

    def _nearest(self) -> tuple[int, int] | None:
        left, right = self._waiting
        gaps = [
            (abs(a.mid_exposure_ns - b.mid_exposure_ns), i, j)
            for i, a in enumerate(left)
            for j, b in enumerate(right)
            if not _of_different_plans(a, b)
        ]
        if not gaps or min(gaps)[0] > self.tolerance_ns:
            return None
        return min(gaps)[1:]

    def _expire(self, newest_ns: int) -> list[Rejected]:
        lonely: list[Rejected] = []
        for side in Side:
            waiting, other = self._waiting[side], self._waiting[1 - side]
            while waiting and self._hopeless(waiting[0], other, newest_ns, len(waiting)):
                lonely.append(self._lonely(waiting.popleft()))
        return lonely

    def _hopeless(self, frame: Frame, other: deque[Frame], newest_ns: int, waiting: int) -> bool:
        passed = bool(other) and other[-1].mid_exposure_ns > frame.mid_exposure_ns + self.tolerance_ns
        return passed or waiting > self.depth or newest_ns - frame.mid_exposure_ns > _FORGET_NS

    @staticmethod
    def _lonely(frame: Frame) -> Rejected:
        return Rejected(Reject.UNPAIRED, f"{frame.side.name.lower()} frame {frame.sequence}", frame.mid_exposure_ns)


def _of_different_plans(left: Frame, right: Frame) -> bool:
    """Whether both frames name the plan that fired them, and the plans differ; a negative number names none."""
    return left.plan_id >= 0 and right.plan_id >= 0 and left.plan_id != right.plan_id
