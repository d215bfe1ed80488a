"""Defects of a channel of a bench recording by its samples alone: whether it is clipped, and single wild samples."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.signal import medfilt

from companion.records import Bools, Floats

_PILED = 0.005  # share of samples at the largest or smallest value, from which they may be clipped (choice)
_SPIKY = 12.0  # median steps from the median of neighbours, beyond which a sample is wild (choice)
_AROUND = 51  # chosen: samples whose median step is the usual one there, some periods
# chosen, of the samples: more are the channel's form; short pulses of a random binary force are a fifth of it
_MOST_WILD = 0.05
_STEEP = 6.0  # chosen: times the samples of the next value; of a coarsely sampled sine it is 1/(2^(1/2) - 1) = 2.4

CLIPPED = "piles up at its largest or smallest value: it is clipped"
"""What a channel that :func:`is_clipped` does, for a sentence that begins with its name."""
SPIKE = 5
"""Samples of a median that a single wild one does not pass (choice)."""


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


def wild_samples(values: Floats) -> Bools:
    """Single samples (n,) that lie far from their neighbours; none where so many do that the channel has that form."""
    distance = np.abs(values - medfilt(values, SPIKE))
    step = np.abs(np.diff(values, prepend=values[0]))
    around = min(_AROUND, len(values) - 1 + len(values) % 2)  # odd
    usual = np.maximum(medfilt(step, around), float(np.median(step)))  # a vibration may be calm most of the time
    wild = np.asarray(distance > _SPIKY * usual)
    return wild if np.count_nonzero(wild) <= _MOST_WILD * len(values) else np.zeros_like(wild)


def unbroken(t_s: Floats, widest_s: float) -> tuple[slice, int]:
    """The longest stretch of stamps (n,) without a wider step, and how many wider ones there are."""
    wide = np.flatnonzero(np.diff(t_s) > widest_s)
    edges = [0, *(wide + 1).tolist(), len(t_s)]
    return slice(*max(itertools.pairwise(edges), key=lambda pair: pair[1] - pair[0])), wide.size
