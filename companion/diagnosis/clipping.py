"""Whether a channel of a bench recording is clipped, by its samples alone: its sensor's range is not stated there."""

from __future__ import annotations

import numpy as np

from companion.records import Floats

_PILED = 0.005  # share of samples at the largest or smallest value, from which they may be clipped (choice)
_STEEP = 6.0  # chosen: times the samples of the next value; of a coarsely sampled sine it is 1/(2^(1/2) - 1) = 2.4


def is_clipped(values: Floats) -> bool:
    """Whether samples (n,) pile up at an end again and again, beyond what coarse steps make of a sine.

    One pile alone, the longest, may be a static deflection that was held before it was released.
    """
    levels, counts = np.unique(values, return_counts=True)
    for end, following in ((levels[0], counts[1:2]), (levels[-1], counts[-2:-1])):
        edges = np.diff(values == end, prepend=False, append=False)
        piles = np.diff(np.flatnonzero(edges))[::2]
        piles = piles[piles > 1]  # single samples that are alike are those of a sine without noise
        if piles.sum() - piles.max(initial=0) > max(_PILED * len(values), _STEEP * following.sum()):
            return True
    return False
