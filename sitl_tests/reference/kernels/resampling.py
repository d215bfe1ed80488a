"""Averages and first moments of samples over epochs of any phase.

An integrating sensor's sample is the average over its own interval, so the running integral is known at the interval's
edges; between them it is taken as a cubic (Hermite). Where a source has applied a 2nd-order Butterworth low-pass, the
samples themselves are interpolated instead, and the filter is inverted by its differential equation, ``u = y +
(sqrt(2)/w) y' + y''/w^2``: the mean of ``u`` over an epoch needs only ``y`` and ``y'`` at the epoch's ends. The inverse
has no delay, and the sensor's noise, which entered ahead of the filter, comes out white again.
"""

from __future__ import annotations

import numpy as np

from companion.records import Floats, Ints

VERTICAL = 2  # channel
# derived: variance of a sample interpolated as 2/3, 2/3, -1/6, -1/6 of its neighbours, in units of edge_aliasing
_LOST_SAMPLE_VARIANCE = 35.0 / 6.0


def epoch_averages(t: Floats, y: Floats, edges: Floats) -> tuple[Floats, Floats]:
    """Mean of every channel and first moment of the vertical one, from samples that are averages themselves.

    Parameters
    ----------
    t : (s,) float64
        Middles of the samples, s.
    y : (s, channels) float64
        The samples.
    edges : (n + 1,) float64
        Equally spaced, inside the samples, s.

    Returns
    -------
    mean : (n, channels) float64
    moment : (n,) float64
        ``integral (t - middle) y_z dt / h^2``.
    """
    samples, epochs = len(t), len(edges) - 1
    knots = np.empty(samples + 1)
    knots[1:-1] = 0.5 * (t[1:] + t[:-1])
    knots[0], knots[-1] = 2.0 * t[0] - knots[1], 2.0 * t[-1] - knots[-2]
    h = knots[1:] - knots[:-1]
    sample = np.minimum(np.maximum(np.searchsorted(knots, edges, side="right") - 1, 0), samples - 1)
    s = (edges - knots[sample]) / h[sample]
    partial = np.empty((epochs + 1, y.shape[1]))  # integral of the sample that an edge cuts, up to there
    for k in range(epochs + 1):
        i, u = sample[k], s[k]
        rise, fall = 0.5 * u * (1.0 - u) ** 2, 0.5 * u**2 * (u - 1.0)
        weight = u**2 * (3.0 - 2.0 * u) + rise + fall
        partial[k] = h[i] * (rise * y[max(i - 1, 0)] + weight * y[i] + fall * y[min(i + 1, samples - 1)])
    mean = np.empty((epochs, y.shape[1]))
    for k in range(epochs):
        inside = h[sample[k] : sample[k + 1]] @ y[sample[k] : sample[k + 1]]
        mean[k] = (inside + partial[k + 1] - partial[k]) / (edges[1] - edges[0])
    return mean, _moments(np.ascontiguousarray(y[:, VERTICAL]), h, sample, s, edges[1] - edges[0])


def _moments(z: Floats, h: Floats, sample: Ints, s: Floats, width: float) -> Floats:
    """First moments of one channel; an edge lies at fraction ``s`` of the sample ``sample``, (n + 1,) each."""
    total, twice, level = np.zeros(len(z) + 1), np.zeros(len(z) + 1), np.empty(len(z) + 1)
    total[1:] = np.cumsum(h * z)
    level[1:-1] = 0.5 * (z[1:] + z[:-1])
    level[0], level[-1] = z[0], z[-1]
    twice[1:] = np.cumsum(h * (0.5 * (total[1:] + total[:-1]) + h * (level[:-1] - level[1:]) / 12.0))
    step = h[sample]
    c0, c1, d0, d1 = total[sample], total[sample + 1], level[sample] * step, level[sample + 1] * step
    c2, c3 = 3.0 * (c1 - c0) - 2.0 * d0 - d1, 2.0 * (c0 - c1) + d0 + d1
    integral = c0 + s * (d0 + s * (c2 + s * c3))
    double = twice[sample] + step * s * (c0 + s * (d0 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)))
    moment: Floats = (0.5 * (integral[1:] + integral[:-1]) - (double[1:] - double[:-1]) / width) / width
    return moment


def interpolate_lost(t: Floats, y: Floats, period_s: float, limit_s: float) -> tuple[Floats, Floats]:
    """Fill gaps of lost samples with cubics: :func:`epoch_averages` takes each for the average up to the next.

    Parameters
    ----------
    t : (s,) float64
        At least four.
    y : (s, channels) float64
        Samples.
    period_s : float
        Usual time between samples.
    limit_s : float
        Longer gaps stay.

    Returns
    -------
    t : (s + lost,) float64
    y : (s + lost, channels) float64
    """
    gap = t[1:] - t[:-1]
    lost = np.where(gap < limit_s, np.round(gap / period_s), 1.0).astype(np.int64) - 1
    lost[0], lost[-1] = 0, 0  # no slope on one side
    lost = np.maximum(lost, 0)
    if not lost.any():
        return t, y
    sample = np.arange(len(t))
    sample[1:] += np.cumsum(lost)
    full_t, full_y = np.empty(len(t) + lost.sum()), np.empty((len(t) + lost.sum(), y.shape[1]))
    full_t[sample] = t
    for channel in range(y.shape[1]):
        full_y[sample, channel] = y[:, channel]
    for i in np.flatnonzero(lost):
        gap_before, gap_here, gap_after = gap[i - 1], gap[i], gap[i + 1]
        step = y[i + 1] - y[i]
        first = ((y[i] - y[i - 1]) / gap_before * gap_here**2 + step * gap_before) / (gap_before + gap_here)
        last = ((y[i + 2] - y[i + 1]) / gap_after * gap_here**2 + step * gap_after) / (gap_after + gap_here)
        for j in range(1, lost[i] + 1):
            u = j / (lost[i] + 1.0)
            full_t[sample[i] + j] = t[i] + u * gap_here
            bend = 3.0 * step - 2.0 * first - last + u * (first + last - 2.0 * step)
            full_y[sample[i] + j] = y[i] + u * (first + u * bend)
    return full_t, full_y


def edge_aliasing(t: Floats, edges: Floats) -> Floats:
    """Aliasing noise of each epoch by edges that cut samples: 0 where they fall between two, 1 on average.

    Inside a sample the path of what it averages is a Brownian bridge, whose variance is ``u (1 - u)`` at fraction u.

    Parameters
    ----------
    t : (s,) float64
        Middles of the samples, s.
    edges : (n + 1,) float64
        Epoch edges, s.

    Returns
    -------
    (n,) float64
        Multiple of ``density T / (3 h^2)``, T the time between samples.
    """
    knots = 0.5 * (t[1:] + t[:-1])
    sample = np.minimum(np.maximum(np.searchsorted(knots, edges, side="right") - 1, 0), len(knots) - 2)
    u = (edges - knots[sample]) / (knots[sample + 1] - knots[sample])
    bridge = np.maximum(6.0 * u * (1.0 - u), 0.0)
    variance_ratio: Floats = 0.5 * (bridge[1:] + bridge[:-1])
    return variance_ratio


def gap_aliasing(t: Floats, edges: Floats, period_s: float) -> Floats:
    """Aliasing noise of each epoch by lost samples: their neighbours say nothing of a white load in the gap.

    Parameters
    ----------
    t : (s,) float64
        Middles of the samples that came, s.
    edges : (n + 1,) float64
        Epoch edges, s.
    period_s : float
        Usual time between samples.

    Returns
    -------
    (n,) float64
        In units of :func:`edge_aliasing`.
    """
    variance_ratio = np.zeros(len(edges) - 1)
    for i in np.flatnonzero(t[1:] - t[:-1] > 1.5 * period_s):
        begin, end = t[i] + 0.5 * period_s, t[i + 1] - 0.5 * period_s
        lost = np.minimum(end, edges[1:]) - np.maximum(begin, edges[:-1])
        variance_ratio += _LOST_SAMPLE_VARIANCE * np.maximum(lost, 0.0) / period_s
    return variance_ratio


def epoch_averages_deconvolved(t: Floats, y: Floats, edges: Floats, cutoff_hz: Floats) -> Floats:
    """Mean of every channel ahead of its 2nd-order Butterworth low-pass.

    Parameters
    ----------
    t : (s,) float64
        Stamps, s.
    y : (s, channels) float64
        Samples.
    edges : (n + 1,) float64
        Equally spaced, s.
    cutoff_hz : (channels,) float64
        0: no filter.

    Returns
    -------
    (n, channels) float64
    """
    samples, channels = y.shape
    h = t[1:] - t[:-1]
    sample = np.minimum(np.maximum(np.searchsorted(t, edges, side="right") - 1, 0), samples - 2)
    step = h[sample]
    s = (edges - t[sample]) / step
    mean = np.empty((len(edges) - 1, channels))
    slope, area = np.empty(samples), np.zeros(samples)
    for channel in range(channels):
        z = np.ascontiguousarray(y[:, channel])
        chord = (z[1:] - z[:-1]) / h
        slope[1:-1] = (chord[:-1] * h[1:] + chord[1:] * h[:-1]) / (h[1:] + h[:-1])
        slope[0], slope[-1] = chord[0], chord[-1]
        area[1:] = np.cumsum(h * (z[:-1] + z[1:]) / 2.0 + h**2 * (slope[:-1] - slope[1:]) / 12.0)
        y0, y1, d0, d1 = z[sample], z[sample + 1], slope[sample] * step, slope[sample + 1] * step
        c2, c3 = 3.0 * (y1 - y0) - 2.0 * d0 - d1, 2.0 * (y0 - y1) + d0 + d1
        integral = area[sample] + step * s * (y0 + s * (d0 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)))
        if cutoff_hz[channel] > 0.0:
            lag = 1.0 / (2.0 * np.pi * cutoff_hz[channel])
            level = y0 + s * (d0 + s * (c2 + s * c3))
            rate = (d0 + s * (2.0 * c2 + 3.0 * s * c3)) / step
            integral = integral + np.sqrt(2.0) * lag * level + lag**2 * rate
        mean[:, channel] = (integral[1:] - integral[:-1]) / (edges[1] - edges[0])
    return mean
