"""Single samples of a stream that contradict all their neighbours: a value hit on its way, not a motion.

A sample is predicted by the cubic through two neighbours on either side. It is a lapse where it misses that by many
times what the samples around it do, and where its neighbours, once it is replaced, agree among themselves. Vibration
raises what all samples miss, and a blow takes several samples: neither is a lapse.
"""

from __future__ import annotations

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.records import Bools, Floats, Ints

BESIDE = 3  # samples on either side that a verdict needs
_CLEARLY = 8.0  # sigmas of the sensor's noise
_STANDING_OUT = 12.0  # sigmas of what is usual: a lateral axis shows slope times force, whose tails are long
_ALONE = 0.3  # of what it misses: its neighbours miss less once it is replaced
_STEEP = 0.5  # of the span of its neighbours: what bends that sharply is moving
_AROUND = 16  # samples on either side tell how much is usual
_NORMAL = 1.4826  # sigmas in a median of magnitudes
_CLOSE, _FAR = 0.2, 2.5  # periods between neighbours; beyond these they say nothing


@compiled
def lapses(t_ns: Ints, values: Floats, first: int, floor: Floats, period_ns: float) -> Bools:
    """Tell which samples are lapses.

    Parameters
    ----------
    t_ns : (s,) int64
        In order.
    values : (s, channels) float64
        What was sampled.
    first : int
        The first one to judge; those without neighbours are none.
    floor : (channels,) float64
        Standard deviation that the sensor's own noise makes a prediction miss.
    period_ns : float
        Usual time between samples.

    Returns
    -------
    (s,) bool
    """
    count, channels = values.shape
    out = np.zeros(count, np.bool_)
    misses = np.zeros(count)
    for channel in range(channels):
        own = np.ascontiguousarray(values[:, channel])
        largest = 0.0
        for i in range(max(first - _AROUND, 2), count - 2):
            misses[i] = np.abs(_missed(t_ns, own, i, period_ns))
            if i >= first:
                largest = max(largest, misses[i])
        if largest <= _CLEARLY * floor[channel]:
            continue
        for i in range(max(first, BESIDE), count - BESIDE):
            if misses[i] > _CLEARLY * floor[channel] and _alone(t_ns, own, i, misses[i], period_ns):
                out[i] |= misses[i] > _STANDING_OUT * _NORMAL * _usual(misses, i)
    return out


@compiled
def _missed(t_ns: Ints, y: Floats, i: int, period_ns: float) -> float:
    """By how much a sample misses the cubic through its neighbours; 0 where they are too far or too close."""
    for k in range(i - 2, i + 2):
        if not _CLOSE * period_ns < t_ns[k + 1] - t_ns[k] < _FAR * period_ns:
            return 0.0
    a, b = float(t_ns[i - 2] - t_ns[i]), float(t_ns[i - 1] - t_ns[i])
    c, d = float(t_ns[i + 1] - t_ns[i]), float(t_ns[i + 2] - t_ns[i])
    first = y[i - 2] * (b * c * d) / ((b - a) * (c - a) * (d - a))
    second = y[i - 1] * (a * c * d) / ((a - b) * (c - b) * (d - b))
    third = y[i + 1] * (a * b * d) / ((a - c) * (b - c) * (d - c))
    last = y[i + 2] * (a * b * c) / ((a - d) * (b - d) * (c - d))
    return float(y[i] - (first + second + third + last))


@compiled
def _alone(t_ns: Ints, y: Floats, i: int, missed: float, period_ns: float) -> bool:
    """Whether its neighbours lie close to each other beside it, and fit once it is replaced by what they predict."""
    lowest, highest = min(y[i - 2], y[i - 1], y[i + 1], y[i + 2]), max(y[i - 2], y[i - 1], y[i + 1], y[i + 2])
    if missed < _STEEP * (highest - lowest):
        return False
    kept = y[i]
    y[i] -= _missed(t_ns, y, i, period_ns)
    before = np.abs(_missed(t_ns, y, i - 1, period_ns))
    after = np.abs(_missed(t_ns, y, i + 1, period_ns))
    y[i] = kept
    return bool(max(before, after) < _ALONE * missed)


@compiled
def _usual(misses: Floats, i: int) -> float:
    """Median miss of the samples around one, those left out that it spoils itself."""
    before, after = misses[max(i - _AROUND, 2) : i - 2], misses[i + 3 : len(misses) - 2][: _AROUND - 2]
    return float(np.median(np.concatenate((before, after)))) if len(before) + len(after) else 0.0
