"""Free decays without a model of the air: frequency and damping against amplitude, and the spring's force curve.

A spring q'' + omega_0^2 q + k_3 q^3 + k_5 q^5 rings at omega^2 = omega_0^2 + (3/4) k_3 A^2 + (5/8) k_5 A^4 (first
harmonic), so a fit of omega^2 on A^2 and A^4 is the force curve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.diagnosis.limit_cycles.tracks import VibrationTrack
from companion.records import Floats

_FEWEST = 5  # chosen: windows for a curve of three coefficients, and two to judge it
_CUBIC, _QUINTIC = 0.75, 0.625  # first harmonics of cos^3 and cos^5 (derived)
_POINTS = 41  # chosen: of a drawn curve: it looks smooth


@dataclass(frozen=True, slots=True)
class ForceCurve:
    """Spring of one response: stiffness and force per mass over deflection up to the largest amplitude.

    Attributes
    ----------
    omega_radps : float
        At small amplitude.
    cubic, quintic : float
        k_3 and k_5, 1/s^2 per squared and fourth unit of the response.
    sigmas : tuple of float
        Of omega^2, k_3, k_5.
    deflection, force : (p,)
        In the response's unit, and that per s^2.
    """

    omega_radps: float
    cubic: float
    quintic: float
    sigmas: tuple[float, float, float]
    deflection: Floats
    force: Floats


def force_curve(entry: VibrationTrack, response: str) -> ForceCurve | None:
    """The spring by the windows of one recording; None where there are too few, or of too few amplitudes."""
    a = entry.amplitude[response]
    if len(a) < _FEWEST or float(np.ptp(a)) == 0.0:
        return None
    largest = float(a.max())
    design = np.stack([np.ones(len(a)), (a / largest) ** 2, (a / largest) ** 4], 1) * a[:, None]
    square = (2.0 * np.pi * entry.frequency_hz) ** 2 * a
    values, rest, rank, _ = np.linalg.lstsq(design, square, rcond=None)
    if rank < design.shape[1]:
        return None
    variance = float(rest[0]) / max(len(a) - 3, 1) if len(rest) else 0.0
    spread = np.sqrt(variance * np.diag(np.linalg.inv(design.T @ design)))
    k3, k5 = values[1] / (_CUBIC * largest**2), values[2] / (_QUINTIC * largest**4)
    q = np.linspace(-largest, largest, _POINTS)
    return ForceCurve(
        float(np.sqrt(max(values[0], 0.0))),
        float(k3),
        float(k5),
        (float(spread[0]), float(spread[1] / (_CUBIC * largest**2)), float(spread[2] / (_QUINTIC * largest**4))),
        q,
        np.asarray(values[0] * q + k3 * q**3 + k5 * q**5),
    )
