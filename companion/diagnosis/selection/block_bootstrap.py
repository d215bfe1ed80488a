"""Intervals of held-out scores by a bootstrap over blocks (Kuensch, Ann. Statist. 17 (1989) 1217)."""

from __future__ import annotations

import numpy as np

from companion.records import Floats

_DRAWS = 1000  # which tell a sigma to 2 % (choice)
_SEED = 7  # convention: any fixed number
_WITHIN = (2.5, 97.5)  # convention: per cent: the middle 95
Interval = tuple[float, float, float]
"""Estimate, and the ends of its 95 % interval."""


def sum_with_interval(values: Floats) -> Interval:
    """Sum over blocks (b,) with its interval."""
    low, high = np.percentile(_resampled(values), _WITHIN)
    return float(values.sum()), float(low), float(high)


def share_gone(before: Floats, after: Floats) -> Interval:
    """Share of a sum of squares over blocks (b,) that is gone, with its interval; 0 of nothing."""
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
