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

from companion.records import Floats

VERTICAL = 2


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
    knots = np.empty(len(t) + 1)
    knots[1:-1] = 0.5 * (t[1:] + t[:-1])
    knots[0], knots[-1] = 2.0 * t[0] - knots[1], 2.0 * t[-1] - knots[-2]
    h = (knots[1:] - knots[:-1])[:, None]
    total = np.zeros((len(knots), y.shape[1]))
    np.cumsum(h * y, axis=0, out=total[1:])
    level = np.empty_like(total)
    level[1:-1] = 0.5 * (y[1:] + y[:-1])
    level[0], level[-1] = y[0], y[-1]
    at = np.minimum(np.maximum(knots.searchsorted(edges, side="right") - 1, 0), len(t) - 1)
    step = h[at]
    s = (edges - knots[at])[:, None] / step
    c0, c1, d0, d1 = total[at], total[at + 1], level[at] * step, level[at + 1] * step
    c2, c3 = 3.0 * (c1 - c0) - 2.0 * d0 - d1, 2.0 * (c0 - c1) + d0 + d1
    integral = c0 + s * (d0 + s * (c2 + s * c3))
    width = edges[1] - edges[0]
    mean = (integral[1:] - integral[:-1]) / width
    z = VERTICAL
    twice = np.zeros(len(knots))
    area = 0.5 * (total[1:, z] + total[:-1, z]) + h[:, 0] * (level[:-1, z] - level[1:, z]) / 12.0
    np.cumsum(h[:, 0] * area, out=twice[1:])
    u = s[:, 0]
    part = u * (c0[:, z] + u * (d0[:, z] / 2.0 + u * (c2[:, z] / 3.0 + u * c3[:, z] / 4.0)))
    double = twice[at] + step[:, 0] * part
    moment = (0.5 * (integral[1:, z] + integral[:-1, z]) - (double[1:] - double[:-1]) / width) / width
    return mean, moment


def cell_means_unfiltered(t: Floats, y: Floats, edges: Floats, cutoff_hz: Floats) -> Floats:
    """Mean of every channel ahead of its low-pass (``cutoff_hz`` 0: none): see :func:`cell_means`."""
    h = (t[1:] - t[:-1])[:, None]
    chord = (y[1:] - y[:-1]) / h
    slope = np.empty_like(y)
    slope[1:-1] = (chord[:-1] * h[1:] + chord[1:] * h[:-1]) / (h[1:] + h[:-1])
    slope[0], slope[-1] = chord[0], chord[-1]
    area = np.zeros_like(y)
    np.cumsum(h * (y[:-1] + y[1:]) / 2.0 + h**2 * (slope[:-1] - slope[1:]) / 12.0, axis=0, out=area[1:])
    at = np.minimum(np.maximum(t.searchsorted(edges, side="right") - 1, 0), len(t) - 2)
    step = h[at]
    s = (edges - t[at])[:, None] / step
    y0, y1, d0, d1 = y[at], y[at + 1], slope[at] * step, slope[at + 1] * step
    c2, c3 = 3.0 * (y1 - y0) - 2.0 * d0 - d1, 2.0 * (y0 - y1) + d0 + d1
    integral = area[at] + step * s * (y0 + s * (d0 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)))
    level = y0 + s * (d0 + s * (c2 + s * c3))
    rate = (d0 + s * (2.0 * c2 + 3.0 * s * c3)) / step
    lag = np.where(cutoff_hz > 0.0, 1.0 / (2.0 * np.pi * np.where(cutoff_hz > 0.0, cutoff_hz, 1.0)), 0.0)
    whole = integral + np.sqrt(2.0) * lag * level + lag**2 * rate
    mean: Floats = (whole[1:] - whole[:-1]) / (edges[1] - edges[0])
    return mean
