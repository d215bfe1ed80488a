"""Intervals of held-out scores by a bootstrap over blocks (Kuensch, Ann. Statist. 17 (1989) 1217)."""

from __future__ import annotations

import numpy as np

from companion.records import Floats

_DRAWS = 1000  # of the blocks: a sigma is then known to 2 % (choice)
_SEED = 7  # convention: any fixed number
_WITHIN = (2.5, 97.5)  # convention: percentiles that bound a 95 % interval
Interval = tuple[float, float, float]
"""Estimate, and the ends of its 95 % interval."""


def sum_with_interval(values: Floats) -> Interval:
    """Sum over blocks (b,) with its interval."""
    low, high = np.percentile(_resampled(values), _WITHIN)
    return float(values.sum()), float(low), float(high)


def share_gone(before: Floats, after: Floats) -> Interval:
    """Relative decrease of a sum of squares over blocks (b,), with its interval; 0 where the sum before is 0."""
    first, second = _resampled(before), _resampled(after)
    some = first > 0.0
    if not some.any():
        return 0.0, 0.0, 0.0
    low, high = np.percentile(1.0 - second[some] / first[some], _WITHIN)
    return 1.0 - float(after.sum() / before.sum()), float(low), float(high)


def _resampled(values: Floats) -> Floats:
    """Sums over as many blocks drawn with replacement, (draws,); the same draws for equal numbers of blocks."""
    draws = np.random.default_rng(_SEED).integers(0, len(values), (_DRAWS, len(values)))
    return np.asarray(values[draws].sum(1))
