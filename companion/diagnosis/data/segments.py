"""Segments of a recording that can be judged: short gaps in them are bridged, long ones lie between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.records import Floats

SHORTEST_S = 8.0
"""Recorded time that all segments together must hold (choice)."""
REQUIREMENT = (
    f"at least {SHORTEST_S:g} s in all, in stretches of 2 s or more (better one), with gaps of at most 1 s inside"
)
"""Requirement on a recording, in words."""
_LENGTHS_S = (8.0, 4.0, 2.0)  # shorter segments are used only where the longer ones do not make up enough (choice)
_LEAST_GAP_S, _LEAST_STEPS = 0.02, 5.0  # a step longer than both is a gap; shorter ones are interpolated (choice)
_LONGEST_FILLED_S = 1.0  # as long as a mode of 5 Hz and 3 % damping remembers (derived)
_LEAST_SHARE = 0.6  # chosen: least share of a segment that was recorded, so that the smaller part is filled in

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Segment:
    """From ``start_s`` to ``stop_s``, with ``gaps`` in which at least one stream is missing."""

    start_s: float
    stop_s: float
    gaps: tuple[Span, ...] = ()

    @property
    def recorded_s(self) -> float:
        """Time in which every stream was recorded."""
        return self.stop_s - self.start_s - sum(stop - start for start, stop in self.gaps)


def gaps_of(t_s: Floats) -> list[Span]:
    """Gaps of one stream's increasing times (m,)."""
    step = np.diff(t_s)
    if not len(step):
        return []
    wide = np.flatnonzero(step > max(_LEAST_GAP_S, _LEAST_STEPS * float(np.median(step))))
    return [(float(t_s[i]), float(t_s[i + 1])) for i in wide]


def segments_of(streams: Sequence[Floats]) -> list[Segment]:
    """Segments in which all streams with times (m,) have short gaps only; none where they hold less than 8 s."""
    if any(len(t_s) < 2 for t_s in streams):
        return []
    start_s, stop_s = max(float(t_s[0]) for t_s in streams), min(float(t_s[-1]) for t_s in streams)
    gaps = _united([gap for t_s in streams for gap in gaps_of(t_s)], start_s, stop_s)
    for length_s in _LENGTHS_S:
        segments = _cut(Segment(start_s, stop_s, tuple(gaps)), length_s)
        if sum(segment.recorded_s for segment in segments) >= SHORTEST_S:
            return segments
    return []


def longest_stretch_s(streams: Sequence[Floats]) -> float:
    """The longest time in which no stream's times (m,) have a gap."""
    if any(len(t_s) < 2 for t_s in streams):
        return 0.0
    start_s, stop_s = max(float(t_s[0]) for t_s in streams), min(float(t_s[-1]) for t_s in streams)
    gaps = _united([gap for t_s in streams for gap in gaps_of(t_s)], start_s, stop_s)
    edges = [start_s, *(edge for gap in gaps for edge in gap), stop_s]
    return max(0.0, *(b - a for a, b in zip(edges[::2], edges[1::2], strict=True)))


def _united(gaps: Sequence[Span], start_s: float, stop_s: float) -> list[Span]:
    """Gaps of all streams inside a time, those that overlap as one."""
    united: list[Span] = []
    for start, stop in sorted(gaps):
        if stop <= start_s or start >= stop_s:
            continue
        if united and start <= united[-1][1]:
            united[-1] = (united[-1][0], max(stop, united[-1][1]))
        else:
            united.append((start, stop))
    return united


def _cut(segment: Segment, length_s: float) -> list[Segment]:
    """Cut at the longest gap until each segment is whole enough; those that are too short are left out."""
    if segment.stop_s - segment.start_s < length_s:
        return []
    longest = max(segment.gaps, key=lambda gap: gap[1] - gap[0], default=(0.0, 0.0))
    dense = segment.recorded_s >= _LEAST_SHARE * (segment.stop_s - segment.start_s)
    if longest[1] - longest[0] <= _LONGEST_FILLED_S and dense:
        return [segment]
    before = tuple(gap for gap in segment.gaps if gap < longest)
    after = tuple(gap for gap in segment.gaps if gap > longest)
    return [
        *_cut(Segment(segment.start_s, longest[0], before), length_s),
        *_cut(Segment(longest[1], segment.stop_s, after), length_s),
    ]
