"""Axes that a stream sends now: one that stops coming is missing, and no measured zero."""

from __future__ import annotations

import numpy as np

from companion.records import AXIS_LETTERS, Axis, Bools, Floats, Ints

_HELD_NS = 50_000_000  # chosen: messages with some axes each come in turn; one that is missing for longer has stopped


class AxisPresence:
    """Follows which axes come; ``axes`` are those that do.

    A sample without an axis that came shortly before has its last value.
    """

    def __init__(self) -> None:
        self.axes = Axis.NONE
        self.missing = Axis.NONE
        """Axes that came once, and no longer do."""
        self._came_ns: Ints = np.full(len(AXIS_LETTERS), -(2**62), dtype=np.int64)
        self._last: Floats = np.zeros(len(AXIS_LETTERS))

    def completed(self, t_ns: Ints, values: Floats, axes: Axis) -> Floats:
        """Values (n, 6) of a batch with some axes, those that it lacks held where they may be."""
        newest_ns = int(t_ns[-1])
        if axes == self.axes and not self.missing:
            self._came_ns[:], self._last[:] = newest_ns, values[-1]
            return values
        come: Bools = axes.mask
        self._came_ns[come], self._last[come] = newest_ns, values[-1, come]
        held = (self.axes.mask & ~come) & (newest_ns - self._came_ns <= _HELD_NS)
        before = self.axes | self.missing
        self.axes = axes | _of(held)
        self.missing = before & ~self.axes
        return np.where(held, self._last, values) if held.any() else values

    def sentences(self, place: str) -> list[str]:
        """Sentence for the operator, where axes no longer come."""
        return [f"{place} sends no {self.missing.letters} any more: used without"] if self.missing else []


def _of(mask: Bools) -> Axis:
    """The axes of a mask (6,)."""
    return Axis(int(sum(1 << column for column in np.flatnonzero(mask).tolist())))
