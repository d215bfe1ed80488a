"""Vibration of the root, told from blows: motion that its filtered samples do not resolve, but that comes again."""

from __future__ import annotations

from collections import deque

import numpy as np

from companion.records import Bools, Floats

_BLOCK_NS = 200_000_000  # chosen: some periods of an engine's beats; a blow lies in one, or in two
_BLOCKS = 10  # chosen: two seconds, in which the throttle changes little
_AGAIN = 3  # derived: blocks that a single blow does not reach
_SPREAD = 1.5**2  # chosen, of variances: the largest motion varies so from block to block


class RootVibration:
    """Largest variance of the root's unresolved motion in each block of the last two seconds.

    A blow loads the wing as it moves the root, and the filter lets the loads follow it. Vibration does not: an engine
    shakes the root far above the wing's band. Counted as load in every step, it drowned a wing in calm air: deflections
    had a sigma of 11 mm beside 0.4 mm of the gusts.
    """

    def __init__(self) -> None:
        self._blocks: deque[float] = deque([0.0] * _BLOCKS, maxlen=_BLOCKS)
        self._largest, self._until_ns = 0.0, 0

    def note(self, first_ns: int, variance: Floats) -> None:
        """Add the variance of the motion of epochs (n,) from an instant on."""
        if first_ns >= self._until_ns:
            self._blocks.append(self._largest)
            self._largest, self._until_ns = 0.0, first_ns + _BLOCK_NS
        self._largest = max(self._largest, float(variance.max(initial=0.0)))

    def includes(self, variance: Floats) -> Bools:
        """Whether the motion of epochs (n,) is no larger than that of three blocks before or more."""
        return np.asarray(variance <= _SPREAD * sorted(self._blocks)[-_AGAIN])
