"""Exact averages and first moments of samples over any cells.

An integrating sensor's sample is the average over its own interval, so the running integral is known at the interval's
edges; between them it is taken as a cubic (Hermite). Where a source has applied a 2nd-order Butterworth low-pass, the
samples themselves are interpolated instead, and the filter is undone by its own differential equation,
``u = y + (sqrt(2)/w) y' + y''/w^2``: the mean of ``u`` over a cell needs only ``y`` and ``y'`` at the cell's ends.
That is an exact inverse with no delay, and the sensor's noise, which went in ahead of the filter, comes out white
again.
"""

from __future__ import annotations

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.records import Floats, Ints

VERTICAL = 2
_BRIDGED = 35.0 / 6.0  # shares of a sample that :func:`bridged` made from 2/3, 2/3, -1/6, -1/6 of its neighbours


@compiled
def cell_means(t: Floats, y: Floats, edges: Floats) -> tuple[Floats, Floats]:
    """Mean of every channel and first moment of the vertical one, from samples that are averages themselves.

    Parameters
    ----------
    t : (s,) float64
        Middles of the samples.
    y : (s, channels) float64
        The samples.
    edges : (n + 1,) float64
        Equally spaced, inside the samples.

    Returns
    -------
    mean : (n, channels) float64
    moment : (n,) float64
        ``integral (t - middle) y_z dt / h^2``.
    """
    samples, cells = len(t), len(edges) - 1
    knots = np.empty(samples + 1)
    knots[1:-1] = 0.5 * (t[1:] + t[:-1])
    knots[0], knots[-1] = 2.0 * t[0] - knots[1], 2.0 * t[-1] - knots[-2]
    h = knots[1:] - knots[:-1]
    at = np.minimum(np.maximum(np.searchsorted(knots, edges, side="right") - 1, 0), samples - 1)
    s = (edges - knots[at]) / h[at]
    begun = np.empty((cells + 1, y.shape[1]))  # integral of the sample that an edge cuts, up to there
    for k in range(cells + 1):
        i, u = at[k], s[k]
        rise, fall = 0.5 * u * (1.0 - u) ** 2, 0.5 * u**2 * (u - 1.0)
        whole = u**2 * (3.0 - 2.0 * u) + rise + fall
        begun[k] = h[i] * (rise * y[max(i - 1, 0)] + whole * y[i] + fall * y[min(i + 1, samples - 1)])
    mean = np.empty((cells, y.shape[1]))
    for k in range(cells):
        inside = h[at[k] : at[k + 1]] @ y[at[k] : at[k + 1]]
        mean[k] = (inside + begun[k + 1] - begun[k]) / (edges[1] - edges[0])
    return mean, _moments(np.ascontiguousarray(y[:, VERTICAL]), h, at, s, edges[1] - edges[0])


@compiled
def _moments(z: Floats, h: Floats, at: Ints, s: Floats, width: float) -> Floats:
    """First moments of one channel; an edge lies at ``s`` of the way through the sample ``at``, (n + 1,) each."""
    total, twice, level = np.zeros(len(z) + 1), np.zeros(len(z) + 1), np.empty(len(z) + 1)
    total[1:] = np.cumsum(h * z)
    level[1:-1] = 0.5 * (z[1:] + z[:-1])
    level[0], level[-1] = z[0], z[-1]
    twice[1:] = np.cumsum(h * (0.5 * (total[1:] + total[:-1]) + h * (level[:-1] - level[1:]) / 12.0))
    step = h[at]
    c0, c1, d0, d1 = total[at], total[at + 1], level[at] * step, level[at + 1] * step
    c2, c3 = 3.0 * (c1 - c0) - 2.0 * d0 - d1, 2.0 * (c0 - c1) + d0 + d1
    integral = c0 + s * (d0 + s * (c2 + s * c3))
    double = twice[at] + step * s * (c0 + s * (d0 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)))
    moment: Floats = (0.5 * (integral[1:] + integral[:-1]) - (double[1:] - double[:-1]) / width) / width
    return moment


@compiled
def bridged(t: Floats, y: Floats, period_s: float, limit_s: float) -> tuple[Floats, Floats]:
    """Put cubics where single samples were lost, for :func:`cell_means` takes each for the average up to the next.

    Gaps beyond ``limit_s`` stay. Samples are (s,) and (s, channels), at least four.
    """
    gap = t[1:] - t[:-1]
    lost = np.where(gap < limit_s, np.round(gap / period_s), 1.0).astype(np.int64) - 1
    lost[0], lost[-1] = 0, 0  # no slope on one side
    lost = np.maximum(lost, 0)
    if not lost.any():
        return t, y
    at = np.arange(len(t))
    at[1:] += np.cumsum(lost)
    full_t, full_y = np.empty(len(t) + lost.sum()), np.empty((len(t) + lost.sum(), y.shape[1]))
    full_t[at] = t
    for channel in range(y.shape[1]):
        full_y[at, channel] = y[:, channel]
    for i in np.flatnonzero(lost):
        left, own, right = gap[i - 1], gap[i], gap[i + 1]
        step = y[i + 1] - y[i]
        first = ((y[i] - y[i - 1]) / left * own**2 + step * left) / (left + own)
        last = ((y[i + 2] - y[i + 1]) / right * own**2 + step * right) / (right + own)
        for j in range(1, lost[i] + 1):
            u = j / (lost[i] + 1.0)
            full_t[at[i] + j] = t[i] + u * own
            bend = 3.0 * step - 2.0 * first - last + u * (first + last - 2.0 * step)
            full_y[at[i] + j] = y[i] + u * (first + u * bend)
    return full_t, full_y


@compiled
def cut_shares(t: Floats, edges: Floats) -> Floats:
    """How much each cell suffers from edges that cut samples: 0 where they fall between two, 1 on average, (n,).

    Inside a sample the path of what it averages is a bridge, whose variance is ``u (1 - u)`` of the way through.
    """
    knots = 0.5 * (t[1:] + t[:-1])
    at = np.minimum(np.maximum(np.searchsorted(knots, edges, side="right") - 1, 0), len(knots) - 2)
    u = (edges - knots[at]) / (knots[at + 1] - knots[at])
    bridge = np.maximum(6.0 * u * (1.0 - u), 0.0)
    shares: Floats = 0.5 * (bridge[1:] + bridge[:-1])
    return shares


@compiled
def bridged_shares(t: Floats, edges: Floats, period_s: float) -> Floats:
    """The same by samples that were lost between those at ``t``: of a white load their neighbours say nothing, (n,)."""
    shares = np.zeros(len(edges) - 1)
    for i in np.flatnonzero(t[1:] - t[:-1] > 1.5 * period_s):
        begin, end = t[i] + 0.5 * period_s, t[i + 1] - 0.5 * period_s
        lost = np.minimum(end, edges[1:]) - np.maximum(begin, edges[:-1])
        shares += _BRIDGED * np.maximum(lost, 0.0) / period_s
    return shares


@compiled
def cell_means_unfiltered(t: Floats, y: Floats, edges: Floats, cutoff_hz: Floats) -> Floats:
    """Mean of every channel ahead of its low-pass (``cutoff_hz`` 0: none): see :func:`cell_means`."""
    samples, channels = y.shape
    h = t[1:] - t[:-1]
    at = np.minimum(np.maximum(np.searchsorted(t, edges, side="right") - 1, 0), samples - 2)
    step = h[at]
    s = (edges - t[at]) / step
    mean = np.empty((len(edges) - 1, channels))
    slope, area = np.empty(samples), np.zeros(samples)
    for channel in range(channels):
        z = np.ascontiguousarray(y[:, channel])
        chord = (z[1:] - z[:-1]) / h
        slope[1:-1] = (chord[:-1] * h[1:] + chord[1:] * h[:-1]) / (h[1:] + h[:-1])
        slope[0], slope[-1] = chord[0], chord[-1]
        area[1:] = np.cumsum(h * (z[:-1] + z[1:]) / 2.0 + h**2 * (slope[:-1] - slope[1:]) / 12.0)
        y0, y1, d0, d1 = z[at], z[at + 1], slope[at] * step, slope[at + 1] * step
        c2, c3 = 3.0 * (y1 - y0) - 2.0 * d0 - d1, 2.0 * (y0 - y1) + d0 + d1
        whole = area[at] + step * s * (y0 + s * (d0 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)))
        if cutoff_hz[channel] > 0.0:
            lag = 1.0 / (2.0 * np.pi * cutoff_hz[channel])
            level = y0 + s * (d0 + s * (c2 + s * c3))
            rate = (d0 + s * (2.0 * c2 + 3.0 * s * c3)) / step
            whole = whole + np.sqrt(2.0) * lag * level + lag**2 * rate
        mean[:, channel] = (whole[1:] - whole[:-1]) / (edges[1] - edges[0])
    return mean
