"""The instants at which both images stand stillest, and how well each is known.

J(t) = sum over both cameras of |motion|^2 has a minimum where the wing stands still (in the paper's case, one symmetric
mode, at the deflection peaks). Errors dx of the slope rates and dx' of their derivatives move it by
-(dJ'/dx . dx + dJ'/dx' . dx') / J''. With one mode the second part vanishes and the time's sigma is that of the slope
rate over the slope acceleration; where the minimum is a compromise between two modes, it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.trigger.blur import BlurForecast
from companion.records import Floats

_WORST_SIGMA_NS = 1e9


@dataclass(frozen=True, slots=True)
class StillInstant:
    """One minimum of the predicted blur; ``blur_px`` is the worse camera's expected rms."""

    t_host_ns: int
    sigma_ns: int
    blur_px: float


def still_instants(blur: BlurForecast, from_host_ns: int = 0) -> list[StillInstant]:
    """Find the local minima of the predicted blur, in order of time, those before ``from_host_ns`` left out."""
    energy = np.sum(blur.motion**2, axis=(1, 2))
    inner = (energy[1:-1] <= energy[:-2]) & (energy[1:-1] < energy[2:])
    found = np.flatnonzero(inner & (blur.t_host_ns[1:-1] >= from_host_ns)) + 1
    return [_refine(blur, energy, i) for i in found.tolist()]


def blur_at_px(blur: BlurForecast, t_host_ns: int) -> float:
    """Expected rms blur of the worse camera at an instant of the forecast."""
    elapsed = blur.t_host_ns - blur.t_host_ns[0]
    at = t_host_ns - int(blur.t_host_ns[0])
    return float(np.interp(at, elapsed, blur.rms_px.max(axis=1)))


def _refine(blur: BlurForecast, energy: Floats, i: int) -> StillInstant:
    """Put the minimum between the instants by a parabola, and bound its time."""
    step_ns = int(blur.t_host_ns[i + 1] - blur.t_host_ns[i])
    bend = float(energy[i - 1] - 2 * energy[i] + energy[i + 1])
    share = 0.5 * float(energy[i - 1] - energy[i + 1]) / bend
    t_ns = int(blur.t_host_ns[i]) + round(share * step_ns)
    curvature = bend / (step_ns * 1e-9) ** 2
    sigma_ns = min(np.sqrt(_slope_variance(blur, i, share)) / curvature * 1e9, _WORST_SIGMA_NS)
    square = blur.rms_px[i - 1 : i + 2] ** 2
    rms2 = square[1] + share * (square[2] - square[0]) / 2 + share**2 * (square[2] - 2 * square[1] + square[0]) / 2
    return StillInstant(t_ns, round(sigma_ns), float(np.sqrt(max(rms2.max(), 0.0))))


def _slope_variance(blur: BlurForecast, i: int, share: float) -> float:
    """Variance of dJ/dt = sum of 2 (motion . per_rate) x' at the minimum, from those of x and x'."""
    per_rate = blur.motion_per_rate
    motion = blur.motion[i] + share * (blur.motion[i + 1] - blur.motion[i - 1]) / 2
    by_rate = 2.0 * np.sum(per_rate**2, axis=1) * blur.acceleration_radps2[i]
    by_acceleration = 2.0 * np.sum(motion * per_rate, axis=1)
    variance = by_rate @ blur.rate_covariance[i] @ by_rate
    return float(variance + by_acceleration @ blur.acceleration_covariance[i] @ by_acceleration)
