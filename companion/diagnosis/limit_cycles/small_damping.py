"""Damping ratio of small vibrations over airspeed: zeta = a + b (V - mean V) + c A^2, A over the largest amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Floats

SMALL = 0.35
"""Amplitude over the largest, below which a vibration counts as small (choice)."""
NOISY = (1e-4, 0.3)
"""Ratios of the largest amplitude, between which the error of a window is proportional to 1/amplitude (choice)."""


@dataclass(frozen=True, slots=True)
class SmallDamping:
    """``values`` a, b, c with their covariance, and the ``variance`` of a window of relative amplitude 1."""

    mean_mps: float
    values: Floats
    covariance: Floats
    variance: float

    def airspeed_mps(self, zeta: float, variance: float = 0.0) -> tuple[float, float]:
        """Airspeed, with its sigma, at which the damping ratio at A = 0 is one that was measured with a variance."""
        a, b, _ = self.values
        away = (zeta - a) / b
        slope = np.array([-1.0, -away]) / b
        sigma = np.sqrt(slope @ self.covariance[:2, :2] @ slope + variance / b**2)
        return float(self.mean_mps + away), float(sigma)


def damping_over_airspeed(speeds: Floats, a: Floats, zeta: Floats) -> SmallDamping:
    """Least squares over windows (w,), weighted with their amplitudes ``a`` over the largest."""
    weight = np.clip(a, *NOISY)
    design = np.stack([np.ones(len(a)), speeds - speeds.mean(), a**2], 1) * weight[:, None]
    values: Floats = np.asarray(np.linalg.lstsq(design, zeta * weight, rcond=None)[0], dtype=np.float64)
    residual = zeta * weight - design @ values
    variance = float(residual @ residual) / max(len(a) - 3, 1)
    covariance: Floats = np.asarray(variance * np.linalg.pinv(design.T @ design), dtype=np.float64)
    return SmallDamping(float(speeds.mean()), values, covariance, variance)
