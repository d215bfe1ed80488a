"""Blur and its minima in plain numpy: ``native/trigger.c``."""

from __future__ import annotations

import numpy as np

from companion.core.trigger.blur import _ImageMotionMaps
from companion.records import Floats, Ints

_WORST_SIGMA_NS = 1e9


def streak_px(
    maps: _ImageMotionMaps,
    rates: Floats,
    covariance: Floats,
    step_s: float,
    shifts_ns: tuple[float, float],
    sigmas_ns: tuple[float, float],
    body_rate_radps: Floats,
    velocity_mps: Floats,
    nearness: float,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Image motion, what a slope rate adds to it, slope accelerations and expected rms blur over the instants."""
    acceleration, per_rate = _derivative(rates, step_s), maps.by_slope + nearness * maps.by_lift
    image, rms = np.empty((len(rates), 2, 3)), np.empty((len(rates), 2))
    for side in range(2):
        rigid = maps.by_rate[side] @ body_rate_radps
        rigid += nearness * (maps.by_velocity[side] @ velocity_mps + maps.by_lever[side] @ body_rate_radps)
        timing = (sigmas_ns[side] * 1e-9) ** 2 + maps.exposure_s[side] ** 2 / 12.0
        rate = rates[:, side] + acceleration[:, side] * (shifts_ns[side] * 1e-9)
        square = (covariance[:, side, side] + acceleration[:, side] ** 2 * timing) * np.sum(per_rate[side] ** 2)
        for axis in range(3):
            moved = rigid[axis] + per_rate[side, axis] * rate
            image[:, side, axis] = moved
            square += moved**2
        rms[:, side] = maps.px * np.sqrt(square)
    return image, per_rate, acceleration, rms


def _derivative(rates: Floats, step_s: float) -> Floats:
    """Slope acceleration (n, 2) of equally spaced instants, by central differences."""
    derivative = np.empty_like(rates)
    derivative[1:-1] = (rates[2:] - rates[:-2]) / (2 * step_s)
    derivative[0], derivative[-1] = (rates[1] - rates[0]) / step_s, (rates[-1] - rates[-2]) / step_s
    return derivative


def minima(
    t_ns: Ints,
    from_ns: int,
    motion: Floats,
    per_rate: Floats,
    acceleration: Floats,
    rate_covariance: Floats,
    q_covariance: Floats,
    spring: Floats,
    rms_px: Floats,
) -> Floats:
    """Time and its sigma, in ns, and rms blur of each minimum, (m, 3); times count from the first instant."""
    energy = np.zeros(len(t_ns))
    for side in range(2):
        for axis in range(3):
            energy += motion[:, side, axis] ** 2
    minima, count = np.empty((len(t_ns), 3)), 0
    for i in range(1, len(t_ns) - 1):
        if energy[i] <= energy[i - 1] and energy[i] < energy[i + 1] and t_ns[i] >= from_ns:
            step_ns = t_ns[i + 1] - t_ns[i]
            bend = energy[i - 1] - 2.0 * energy[i] + energy[i + 1]
            fraction = 0.5 * (energy[i - 1] - energy[i + 1]) / bend
            middle = motion[i] + fraction * (motion[i + 1] - motion[i - 1]) / 2.0
            variance = _slope_variance(middle, per_rate, acceleration[i], rate_covariance[i], q_covariance[i], spring)
            sigma_ns = np.sqrt(variance) / (bend / (step_ns * 1e-9) ** 2) * 1e9
            minima[count, 0] = t_ns[i] - t_ns[0] + fraction * step_ns
            minima[count, 1] = min(sigma_ns, _WORST_SIGMA_NS)
            minima[count, 2] = _between(rms_px[i - 1] ** 2, rms_px[i] ** 2, rms_px[i + 1] ** 2, fraction)
            count += 1
    return minima[:count]


def _between(before: Floats, at: Floats, after: Floats, fraction: float) -> float:
    """The larger of two roots whose squares are known at three instants, by parabolas."""
    square = at + fraction * (after - before) / 2.0 + fraction**2 * (after - 2.0 * at + before) / 2.0
    return float(np.sqrt(max(square.max(), 0.0)))


def _slope_variance(
    motion: Floats,
    per_rate: Floats,
    acceleration: Floats,
    rate_covariance: Floats,
    q_covariance: Floats,
    spring: Floats,
) -> float:
    """Variance of dJ/dt = sum of 2 (motion . per_rate) x' at the minimum, from those of x and x'."""
    by_rate = 2.0 * np.sum(per_rate**2, axis=1) * acceleration
    by_q = 2.0 * np.sum(motion * per_rate, axis=1) @ spring
    variance = 0.0
    for i in range(2):
        for j in range(2):
            variance += by_rate[i] * by_rate[j] * rate_covariance[i, j]
            variance += by_q[i] * by_q[j] * q_covariance[i, j]
    return variance
