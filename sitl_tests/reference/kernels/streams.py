"""A stream and its averages in plain numpy: ``native/streams.c``."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.streams import CHANNELS, StreamSamples
from companion.records import Floats, Ints
from sitl_tests.native.averaging import EpochAverages
from sitl_tests.reference.kernels.resampling import (
    edge_aliasing,
    epoch_averages,
    epoch_averages_deconvolved,
    gap_aliasing,
    interpolate_lost,
)

_SATURATION_MARGIN = 0.002  # chosen: a value within this of the range was clipped
_GAP_PERIODS = 3.5  # chosen: two lost samples are interpolated, more are a gap
_MIN_GAP_S = 0.012  # chosen: three epochs of 4 ms; shorter gaps are interpolated at any rate
_MOMENT_GAP_PERIODS = 1.6  # derived: a single lost sample leaves a gap of two periods
_LATE_AFTER_PERIODS, _LATE_BEFORE_PERIODS = 0.4, 1.3  # chosen: two samples sent in one go behind a gap
_MOMENT_SAMPLES = 2.9  # chosen: three samples an epoch, less tolerance of the rate, make a first moment


def respaced(t_ns: Ints, period_ns: int) -> Ints:
    """Stamps with late ones put back: a sample close ahead of the next, and far behind the one before it.

    A sender that stamps at the instant of sending and was held up sends two samples in one go. The first belongs in the
    middle of the gap.

    Parameters
    ----------
    t_ns : (s,) int64
        Stamps in order.
    period_ns : int
        Usual time between samples.

    Returns
    -------
    (s,) int64
    """
    close = t_ns[2:] - t_ns[1:-1] < _LATE_AFTER_PERIODS * period_ns
    late = 1 + np.flatnonzero(close & (t_ns[1:-1] - t_ns[:-2] > _LATE_BEFORE_PERIODS * period_ns))
    if not len(late):
        return t_ns
    moved = t_ns.copy()
    moved[late] = (t_ns[late - 1] + t_ns[late + 1]) // 2
    return moved


def all_valid(t_ns: Ints, values: Floats, limits: Floats, oldest_ns: int) -> bool:
    """Whether every sample is new, finite and inside the sensor's range."""
    if not (t_ns > oldest_ns).all() or not np.isfinite(values).all():
        return False
    return not (np.abs(values) / limits > 1.0 - _SATURATION_MARGIN).any()


def appended(
    t_ns: Ints, values: Floats, more_ns: Ints, more: Floats, period_ns: int, needed_ns: int
) -> tuple[Ints, Floats, bool]:
    """Samples behind those still needed, respaced; False where they are not in order of time."""
    first = np.searchsorted(t_ns, needed_ns)
    together = np.concatenate((t_ns[first:], more_ns))
    ordered = bool((together[1:] > together[:-1]).all())
    return respaced(together, period_ns) if ordered else together, np.concatenate((values[first:], more)), ordered


def averages(samples: StreamSamples, edges_ns: Ints) -> EpochAverages:
    """Averages of a stream over epochs.

    Parameters
    ----------
    samples : StreamSamples
        Of one station.
    edges_ns : (n + 1,) int64
        Equally spaced.

    Returns
    -------
    EpochAverages
    """
    epochs = len(edges_ns) - 1
    low = max(int(np.searchsorted(samples.t_ns, edges_ns[0])) - 4, 0)
    high = int(np.searchsorted(samples.t_ns, edges_ns[-1])) + 4
    t_ns, y = samples.t_ns[low:high], samples.values[low:high]
    if len(t_ns) < 4:
        zeros, false = np.zeros(epochs), np.zeros(epochs, np.bool_)
        return EpochAverages(np.zeros((epochs, CHANNELS)), zeros, zeros, false, false)
    t = (t_ns - edges_ns[0]) * 1e-9
    edges = (edges_ns - edges_ns[0]) * 1e-9
    limit_s = max(_GAP_PERIODS / samples.rate_hz, _MIN_GAP_S)
    if samples.filtered:
        mean, moment = epoch_averages_deconvolved(t, y, edges, samples.cutoff_hz), np.zeros(epochs)
        aliasing_noise = np.zeros(epochs)
    else:
        period_s = 1.0 / samples.rate_hz
        full_t, full_y = interpolate_lost(t, y, period_s, limit_s)
        mean, moment = epoch_averages(full_t, full_y, edges)
        aliasing_noise = edge_aliasing(full_t, edges) + gap_aliasing(t, edges, period_s)
    widest = _widest_gaps(t, edges)
    covered, resolved = widest <= limit_s, widest <= _MOMENT_GAP_PERIODS / samples.rate_hz
    for k in range(epochs):
        if not covered[k]:
            mean[k], moment[k] = 0.0, 0.0
    if samples.filtered or (edges[1] - edges[0]) * samples.rate_hz < _MOMENT_SAMPLES:
        resolved[:] = False
    return EpochAverages(mean, moment, aliasing_noise, covered, resolved)


def _widest_gaps(t: Floats, edges: Floats) -> Floats:
    """Longest gap in and around each epoch, s, (n,); infinite without samples on both sides."""
    gap, widest = t[1:] - t[:-1], np.full(len(edges) - 1, np.inf)
    after = np.searchsorted(t, edges[:-1], side="right")
    until = np.searchsorted(t, edges[1:], side="left")
    for k in range(len(widest)):
        if after[k] > 0 and until[k] < len(t):
            widest[k] = gap[after[k] - 1 : until[k]].max()
    return widest
