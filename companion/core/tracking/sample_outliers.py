"""Outliers among the values of a stream: single ones that contradict all their neighbours, altered on their way.

A value is predicted by the cubic through two neighbours of its channel on either side. It is an outlier where its
residual is many times the sensor's noise and the median residual around it, and where its neighbours, once it is
replaced, agree among themselves. Vibration raises all residuals, and a blow takes several samples: neither is an
outlier. Where a wing bends fast, a lateral axis, slope times force, has such values that do not lie; so what the other
axes of the sample show is kept.
"""

from __future__ import annotations

import numpy as np

from companion.native.library import ARRAY, INTEGER, REAL, kernel
from companion.records import Bools, Floats, Ints

NEIGHBOURS = 3  # derived: two for the cubic, one more for the cubic of a neighbour
_VERTICAL = 2  # channel of the vertical force (by definition)

_outliers = kernel("stream_outliers", ARRAY, ARRAY, INTEGER, ARRAY, REAL, ARRAY)


def find_outliers(t_ns: Ints, values: Floats, first: int, noise_sigma: Floats, period_ns: float) -> Bools:
    """Outliers of a stream, by channel.

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
    (s, channels) bool
    """
    out = np.empty(values.shape, np.bool_)
    _outliers(t_ns, values, first, noise_sigma, period_ns, out)
    return out


def without_outliers(t_ns: Ints, values: Floats, outliers: Bools) -> tuple[Ints, Floats]:
    """Stamps (m,) and values (m, channels) of a stream with its outliers (s, channels) interpolated.

    A sample whose vertical force is one is removed: in a white gust nothing stands for it, and a gap is honest.
    """
    values = values.copy()
    for channel in np.flatnonzero(outliers.any(axis=0)):
        lies, series = outliers[:, channel], values[:, channel]
        series[lies] = np.interp(t_ns[lies], t_ns[~lies], series[~lies])
    sound = ~outliers[:, _VERTICAL]
    return t_ns[sound], values[sound]
