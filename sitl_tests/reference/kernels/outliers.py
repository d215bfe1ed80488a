"""Outliers among samples in plain Python: ``native/outliers.c``."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.sample_outliers import NEIGHBOURS
from companion.records import Bools, Floats, Ints

_NOISE_SIGMAS = 8.0  # chosen: of the sensor's noise; Gaussian noise exceeds it once in 1e15
_MEDIAN_SIGMAS = 12.0  # chosen: a lateral axis shows slope times force, whose tails are long
_NEIGHBOUR_RATIO = 0.3  # chosen: residual of the neighbours over the sample's, once this is replaced
_SPAN_RATIO = 0.5  # chosen: residual over the span of the neighbours; a smaller one is motion
_MOST_TILT = 0.2  # chosen, rad: of a bent tip, whose lateral axis shows so much of a white vertical force
_VERTICAL = 2  # channel (by definition)
_WINDOW = 16  # chosen: samples on either side for the median residual
_SIGMAS_PER_MEDIAN = 1.4826  # derived: standard deviation over the median magnitude of a Gaussian
_MIN_GAP_PERIODS, _MAX_GAP_PERIODS = 0.2, 2.5  # chosen: a cubic through samples farther or closer says nothing


def find_outliers(t_ns: Ints, values: Floats, first: int, noise_sigma: Floats, period_ns: float) -> Bools:
    """Outliers of a stream.

    Parameters
    ----------
    t_ns : (s,) int64
        In order.
    values : (s, channels) float64
        Samples.
    first : int
        First sample to test; those without neighbours are none.
    noise_sigma : (channels,) float64
        Standard deviation of the residual by the sensor's own noise.
    period_ns : float
        Usual time between samples.

    Returns
    -------
    (s,) bool
    """
    count, channels = values.shape
    out = np.zeros(count, np.bool_)
    residual = np.zeros(count)
    for channel in range(channels):
        series = np.ascontiguousarray(values[:, channel])
        largest = 0.0
        for i in range(max(first - _WINDOW, 2), count - 2):
            residual[i] = np.abs(_interpolation_residual(t_ns, series, i, period_ns))
            if i >= first:
                largest = max(largest, residual[i])
        if largest <= _NOISE_SIGMAS * noise_sigma[channel]:
            continue
        for i in range(max(first, NEIGHBOURS), count - NEIGHBOURS):
            if residual[i] > _NOISE_SIGMAS * noise_sigma[channel] and _isolated(
                t_ns, series, i, residual[i], period_ns
            ):
                vertical = np.abs(_interpolation_residual(t_ns, values[:, _VERTICAL], i, period_ns))
                if channel < _VERTICAL and residual[i] < _MOST_TILT * vertical:
                    continue
                out[i] |= residual[i] > _MEDIAN_SIGMAS * _SIGMAS_PER_MEDIAN * _median_residual(residual, i)
    return out


def _interpolation_residual(t_ns: Ints, y: Floats, i: int, period_ns: float) -> float:
    """Residual of a sample from the cubic through its neighbours; 0 where they are too far or too close."""
    for k in range(i - 2, i + 2):
        if not _MIN_GAP_PERIODS * period_ns < t_ns[k + 1] - t_ns[k] < _MAX_GAP_PERIODS * period_ns:
            return 0.0
    a, b = float(t_ns[i - 2] - t_ns[i]), float(t_ns[i - 1] - t_ns[i])
    c, d = float(t_ns[i + 1] - t_ns[i]), float(t_ns[i + 2] - t_ns[i])
    first = y[i - 2] * (b * c * d) / ((b - a) * (c - a) * (d - a))
    second = y[i - 1] * (a * c * d) / ((a - b) * (c - b) * (d - b))
    third = y[i + 1] * (a * b * d) / ((a - c) * (b - c) * (d - c))
    last = y[i + 2] * (a * b * c) / ((a - d) * (b - d) * (c - d))
    return float(y[i] - (first + second + third + last))


def _isolated(t_ns: Ints, y: Floats, i: int, residual_here: float, period_ns: float) -> bool:
    """Whether a sample stands clear of the span of its neighbours, and these fit once it is replaced."""
    lowest, highest = min(y[i - 2], y[i - 1], y[i + 1], y[i + 2]), max(y[i - 2], y[i - 1], y[i + 1], y[i + 2])
    if residual_here < _SPAN_RATIO * (highest - lowest):
        return False
    original = y[i]
    y[i] -= _interpolation_residual(t_ns, y, i, period_ns)
    before = np.abs(_interpolation_residual(t_ns, y, i - 1, period_ns))
    after = np.abs(_interpolation_residual(t_ns, y, i + 1, period_ns))
    y[i] = original
    return bool(max(before, after) < _NEIGHBOUR_RATIO * residual_here)


def _median_residual(residual: Floats, i: int) -> float:
    """Median residual of the samples around one, without those that it affects itself."""
    before, after = residual[max(i - _WINDOW, 2) : i - 2], residual[i + 3 : len(residual) - 2][: _WINDOW - 2]
    return float(np.median(np.concatenate((before, after)))) if len(before) + len(after) else 0.0
