"""The instants at which both images stand stillest, and how well each is known.

J(t) = sum over both cameras of |motion|^2 has a minimum where the wing stands still (in the paper's case, one symmetric
mode, at the deflection peaks). Errors dx of the slope rates and dx' of their derivatives move it by
-(dJ'/dx . dx + dJ'/dx' . dx') / J''. With one mode the second part vanishes and the time's sigma is that of the slope
rate over the slope acceleration; where the minimum is a compromise between two modes, it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.trigger.blur import BlurForecast
from companion.records import Floats, Ints

_WORST_SIGMA_NS = 1e9  # keeps an unknown time finite


@dataclass(frozen=True, slots=True)
class StillInstant:
    """One minimum of the predicted blur; ``blur_px`` is the worse camera's expected rms."""

    t_host_ns: int
    sigma_ns: int
    blur_px: float


def still_instants(blur: BlurForecast, from_host_ns: int = 0) -> list[StillInstant]:
    """Find the local minima of the predicted blur, in order of time, those before ``from_host_ns`` left out."""
    first_ns = int(blur.t_host_ns[0])
    minima = _minima(
        blur.t_host_ns,
        from_host_ns,
        blur.motion,
        blur.motion_per_rate,
        blur.acceleration_radps2,
        blur.rate_covariance,
        blur.q_covariance,
        blur.spring,
        blur.rms_px,
    )
    return [StillInstant(first_ns + round(t), round(sigma), px) for t, sigma, px in minima.tolist()]


def blur_at_px(blur: BlurForecast, t_host_ns: int) -> float:
    """Expected rms blur of the worse camera at an instant of the forecast."""
    elapsed = blur.t_host_ns - blur.t_host_ns[0]
    at = t_host_ns - int(blur.t_host_ns[0])
    return float(np.interp(at, elapsed, blur.rms_px.max(axis=1)))


@compiled
def _minima(
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


@compiled
def _between(before: Floats, at: Floats, after: Floats, fraction: float) -> float:
    """The larger of two roots whose squares are known at three instants, by parabolas."""
    square = at + fraction * (after - before) / 2.0 + fraction**2 * (after - 2.0 * at + before) / 2.0
    return float(np.sqrt(max(square.max(), 0.0)))


@compiled
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
