"""One mode with its gust filter as a chain of states ``[q, v, gust...]``, scaled to the wanted rms."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.linalg

from tools.reference.spec import GustShape, ModeSpec

Floats = npt.NDArray[np.float64]


def chain(frequency_hz: float, damping: float, gust: GustShape) -> tuple[Floats, Floats, Floats]:
    """Give ``A`` (n, n), the noise input ``b`` (n,) and the row ``a`` (n,) with acceleration = a x + b[1] w.

    The load has unit gain at zero frequency: ``g = w`` (white), or ``w`` through the poles and the zero of ``gust``.
    """
    omega = 2 * np.pi * frequency_hz
    n = 2 + len(gust.poles_hz)
    A, b = np.zeros((n, n)), np.zeros(n)
    A[0, 1] = 1.0
    A[1, :2] = -(omega**2), -2 * damping * omega
    if not gust.poles_hz:
        b[1] = 1.0
        return A, b, A[1].copy()
    for i, pole in enumerate(gust.poles_hz):
        A[2 + i, 2 + i] = -2 * np.pi * pole
        if i:
            A[2 + i, 1 + i] = 2 * np.pi * pole
    b[2] = 2 * np.pi * gust.poles_hz[0]
    A[1, n - 1] = 1.0
    if gust.zero_hz is not None:
        A[1] += A[n - 1] / (2 * np.pi * gust.zero_hz)  # output of (1 + s/z) acting on the last pole
    return A, b, A[1].copy()


def intensity(mode: ModeSpec, gust: GustShape) -> float:
    """Two-sided density of ``w`` that gives the mode its rms (stationary Lyapunov equation)."""
    A, b, _ = chain(mode.frequency_hz, mode.damping, gust)
    unit = scipy.linalg.solve_continuous_lyapunov(A, -np.outer(b, b))
    return float(mode.rms_m**2 / unit[0, 0])
