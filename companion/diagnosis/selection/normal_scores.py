"""Statistics as equivalents of a standard normal, by the tails that they have by chance."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2, gamma, norm, t

from companion.records import Floats

_SMALLEST = -500_000.0  # exponent at which a normal quantile can still be computed (numerical)
_STRAIGHT = 1e-3  # skewness below which a law counts as symmetric (numerical)
_SMALL = 0.5  # sigmas below which a tail is the normal one (choice)


def normal_score(log_tail: float) -> float:
    """|z| whose two-sided tail has this log probability."""
    half = max(log_tail, _SMALLEST) - math.log(2.0)
    if half > -600.0:
        return max(float(norm.isf(math.exp(half))), 0.0)
    return math.sqrt(-2.0 * half)


def two_sided_log_tail(z: float) -> float:
    """Logarithm of the two-sided tail of a standard normal."""
    return float(chi2.logsf(z**2, 1))


def normal_score_of_gamma(z: float, skewness: float) -> float:
    """Standard normal equivalent of a sum of few squares, whose longer tail is that of a gamma law.

    On the side of the shorter tail z is left as it is.
    """
    if z * skewness < _STRAIGHT:
        return z
    shape = 4.0 / skewness**2
    log_tail = float(gamma.logsf(shape + abs(z) * math.sqrt(shape), shape))
    return math.copysign(normal_score(min(log_tail + math.log(2.0), 0.0)), z)


def normal_score_of_products(z: float, bins: float) -> float:
    """Standard normal equivalent of a sum over ``bins`` of products of two independent complex normals.

    Real and imaginary part of such a product follow Laplace's law, so that few have longer tails. By the saddle point
    (Barndorff-Nielsen's r*, Biometrika 73 (1986) 307), with K(t) = -n log(1 - t^2/2n).
    """
    if abs(z) < _SMALL:
        return z
    t = (math.sqrt(1.0 + 2.0 * z**2 / bins) - 1.0) * bins / abs(z)
    remaining = 1.0 - t**2 / (2.0 * bins)
    root = math.sqrt(2.0 * (t * abs(z) + bins * math.log(remaining)))
    slope = t * math.sqrt((2.0 - remaining) / remaining**2)
    return math.copysign(root + math.log(slope / root) / root, z)


def normal_score_of_student(z: float, freedom: int) -> float:
    """Standard normal equivalent of a score over a scatter estimated with this many degrees of freedom."""
    return math.copysign(normal_score(min(float(t.logsf(abs(z), freedom)) + math.log(2.0), 0.0)), z)


def strength(real: float, drawn: Floats) -> float:
    """Standard deviations of a statistic from values drawn by chance, (n,); a skew one by the tail of a gamma law."""
    spread = float(np.std(drawn))
    skewness = float(np.mean(((drawn - np.mean(drawn)) / spread) ** 3))
    return normal_score_of_gamma(float(real - np.mean(drawn)) / spread, skewness)
