"""The parts of ``native/streams.c`` by themselves, with the signatures of their numpy versions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.tracking.streams import CHANNELS, SampleBuffer, StreamSamples, _appended
from companion.native.library import ARRAY, REAL, RECORD, kernel, packed
from companion.records import Bools, Floats, Ints

_integrals = kernel("stream_average_integrals", ARRAY, ARRAY, ARRAY, ARRAY, ARRAY)
_deconvolved = kernel("stream_average_deconvolved", ARRAY, ARRAY, ARRAY, ARRAY, ARRAY)
_fill = kernel("stream_fill_gaps", ARRAY, ARRAY, REAL, REAL, ARRAY, ARRAY)
_aliasing = kernel("stream_aliasing", ARRAY, ARRAY, REAL, ARRAY, ARRAY)


def epoch_averages(t: Floats, y: Floats, edges: Floats) -> tuple[Floats, Floats]:
    mean, moment = np.empty((len(edges) - 1, y.shape[1])), np.empty(len(edges) - 1)
    _integrals(t, y, edges, mean, moment)
    return mean, moment


def epoch_averages_deconvolved(t: Floats, y: Floats, edges: Floats, cutoff_hz: Floats) -> Floats:
    mean = np.empty((len(edges) - 1, y.shape[1]))
    _deconvolved(t, y, edges, cutoff_hz, mean)
    return mean


def interpolate_lost(t: Floats, y: Floats, period_s: float, limit_s: float) -> tuple[Floats, Floats]:
    full_t, full_y = t, y
    while (count := _fill(t, y, period_s, limit_s, full_t := full_t.copy(), full_y := full_y.copy())) > len(full_t):
        full_t, full_y = np.empty(count), np.empty((count, y.shape[1]))
    return full_t, full_y


def edge_aliasing(t: Floats, edges: Floats) -> Floats:
    return _both(t, edges, 1.0)[0]


def gap_aliasing(t: Floats, edges: Floats, period_s: float) -> Floats:
    return _both(t, edges, period_s)[1]


def _both(t: Floats, edges: Floats, period_s: float) -> tuple[Floats, Floats]:
    by_edges, by_gaps = np.empty(len(edges) - 1), np.empty(len(edges) - 1)
    _aliasing(t, edges, period_s, by_edges, by_gaps)
    return by_edges, by_gaps


def respaced(t_ns: Ints, period_ns: int) -> Ints:
    return _appended(t_ns[:0], np.empty((0, 1)), t_ns, np.empty((len(t_ns), 1)), period_ns, 0)[0]


class EpochAverages(NamedTuple):
    """Averages of a stream over consecutive epochs; zero where not covered.

    Attributes
    ----------
    mean : (n, 6) float64
    moment : (n,) float64
        First moment of the vertical axis, ``integral (t - middle) z dt / h^2``.
    aliasing_noise : (n,) float64
        By edges that cut samples (0 where they fall between two, 1 on average) and by lost samples.
    covered : (n,) bool
        There are samples.
    resolved : (n,) bool
        There are enough for a moment, and none was lost.
    """

    mean: Floats
    moment: Floats
    aliasing_noise: Floats
    covered: Bools
    resolved: Bools


_pack_samples, _pack_averages = packed(StreamSamples), packed(EpochAverages)
_averages = kernel("stream_averages", RECORD, ARRAY, RECORD)


def averages(samples: StreamSamples, edges_ns: Ints) -> EpochAverages:
    """Averages of a stream over the epochs between equally spaced edges (n + 1,)."""
    n = len(edges_ns) - 1
    means = (np.empty((n, CHANNELS)), np.empty(n), np.empty(n))
    out = EpochAverages(*means, np.empty(n, np.bool_), np.empty(n, np.bool_))
    _averages(_pack_samples(samples), edges_ns, _pack_averages(out))
    return out


def averages_of(stream: SampleBuffer, edges_ns: Ints) -> EpochAverages:
    """Averages of all that a stream has at hand over the epochs between these edges (n + 1,)."""
    return averages(stream.plain(int(edges_ns[-1])), edges_ns)
