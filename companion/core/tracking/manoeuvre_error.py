"""Slope error by the sensors' constants that a manoeuvre brings and takes away.

A constant c (a gyro's scale, a misalignment) puts ``s(t)' c`` into the slope, and its sensitivity ``s`` is another in a
roll than in level flight. What the mean sensitivity of the last seconds makes of it lasts: matched features learn it
once. The rest, of variance ``(s - mean)' P (s - mean)``, is fresh in every manoeuvre.
"""

from __future__ import annotations

import math

import numpy as np

from companion.records import Floats

_MEAN_S = 20.0  # of the sensitivity (choice: several manoeuvres)
_FIRST_S = (
    1.0  # for which the first sensitivity counts, and the most for which any does: a pause teaches nothing (choice)
)


class ManoeuvreError:
    """Running mean of the sensitivity, in order of the instants that are smoothed."""

    def __init__(self) -> None:
        self._mean: Floats | None = None
        self._newest_ns, self._memory_s = 0, _FIRST_S

    def sigma_rad(self, t_host_ns: int, slope_by_bias: Floats, covariance: Floats) -> float:
        """One-sigma of the fresh error at an instant, for a sensitivity (c,) and the constants' covariance (c, c)."""
        if self._mean is None:
            self._mean, self._newest_ns = slope_by_bias.copy(), t_host_ns
        passed_s = min(1e-9 * max(t_host_ns - self._newest_ns, 0), _FIRST_S)
        self._newest_ns = max(t_host_ns, self._newest_ns)
        self._memory_s = min(self._memory_s + passed_s, _MEAN_S)
        self._mean = self._mean + passed_s / self._memory_s * (slope_by_bias - self._mean)
        fresh = slope_by_bias - self._mean
        return math.sqrt(max(float(np.dot(fresh, covariance @ fresh)), 0.0))
