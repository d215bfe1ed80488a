"""The instants at which both images stand stillest, and how well each is known.

J(t) = sum over both cameras of |motion|^2 has a minimum where the wing stands still (in the paper's case, one symmetric
mode, at the deflection peaks). An error dx of the slope rates moves it by -(dJ'/dx . dx) / J'', so with one mode the
time's sigma is that of the slope rate over the slope acceleration.
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


def still_instants(blur: BlurForecast) -> list[StillInstant]:
    """Find the local minima of the predicted blur, in order of time."""
    energy = np.sum(blur.motion**2, axis=(1, 2))
    inner = (energy[1:-1] <= energy[:-2]) & (energy[1:-1] < energy[2:])
    return [_refine(blur, energy, int(i) + 1) for i in np.flatnonzero(inner)]


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
    # dJ/dt = sum 2 (motion . per_rate) x', and by the rates x: 2 |per_rate|^2 x'
    gradient = 2.0 * np.sum(blur.motion_per_rate**2, axis=1) * blur.acceleration_radps2[i]
    spread = float(np.sqrt(gradient @ blur.rate_covariance[i] @ gradient))
    sigma_ns = min(spread / curvature * 1e9, _WORST_SIGMA_NS)
    square = blur.rms_px[i - 1 : i + 2] ** 2
    rms2 = square[1] + share * (square[2] - square[0]) / 2 + share**2 * (square[2] - 2 * square[1] + square[0]) / 2
    return StillInstant(t_ns, round(sigma_ns), float(np.sqrt(max(rms2.max(), 0.0))))
