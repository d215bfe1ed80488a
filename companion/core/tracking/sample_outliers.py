"""Outliers among the samples of a stream: single values that contradict all their neighbours, altered on their way.

A sample is predicted by the cubic through two neighbours on either side. It is an outlier where its residual is many
times the sensor's noise and the median residual around it, and where its neighbours, once it is replaced, agree among
themselves. Vibration raises all residuals, and a blow takes several samples: neither is an outlier. A horizontal force
is none where the vertical one of the same sample, which a bent tip's tilt turns into it, has five times its residual.
"""

from __future__ import annotations

import numpy as np

from companion.native.library import ARRAY, INTEGER, REAL, kernel
from companion.records import Bools, Floats, Ints

NEIGHBOURS = 3  # derived: two for the cubic, one more for the cubic of a neighbour

_outliers = kernel("stream_outliers", ARRAY, ARRAY, INTEGER, ARRAY, REAL, ARRAY)


def find_outliers(t_ns: Ints, values: Floats, first: int, noise_sigma: Floats, period_ns: float) -> Bools:
    """Outliers of a stream.

    Parameters
    ----------
    t_ns : (s,) int64
        In order.
    values : (s, channels) float64
        Samples: specific force x y z, then rates.
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
    out = np.empty(len(t_ns), np.bool_)
    _outliers(t_ns, values, first, noise_sigma, period_ns, out)
    return out
