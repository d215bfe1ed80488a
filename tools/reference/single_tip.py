"""One tip on its own, the system behind the table of limits: ``[q, v]`` under white gust, optional drifting biases.

Two ways to sample it: averages over the millisecond, as an integrating sensor gives them (exact for a white gust), and
readings at the start of a millisecond through which the gust is held, as the published table took them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.linalg

from tools.reference.discretise import Discrete, averages
from tools.reference.spec import GRAVITY_MPS2

Floats = npt.NDArray[np.float64]
SLOPE_RADPM = 1.39
ACCEL_DENSITY = 70e-6 * GRAVITY_MPS2
GYRO_DENSITY = np.radians(0.0028)
ACCEL_BIAS, GYRO_BIAS, BIAS_TIME_S = 2e-3 * GRAVITY_MPS2, np.radians(0.05), 1000.0


def gust_density(frequency_hz: float, damping: float, rms_m: float) -> float:
    """Two-sided density of the white load that moves the mode by ``rms_m``: 4 zeta omega^3 rms^2."""
    return float(4 * damping * (2 * np.pi * frequency_hz) ** 3 * rms_m**2)


def _views(frequency_hz: float, damping: float, axes: str) -> tuple[Floats, Floats, Floats]:
    """Rows of z (acceleration), y (slope through gravity), p (slope rate); the gust's part; two-sided noise."""
    omega = 2 * np.pi * frequency_hz
    rows = {"z": (-(omega**2), -2 * damping * omega), "y": (SLOPE_RADPM * GRAVITY_MPS2, 0.0), "p": (0.0, SLOPE_RADPM)}
    noise = {"z": ACCEL_DENSITY**2 / 2, "y": ACCEL_DENSITY**2 / 2, "p": GYRO_DENSITY**2 / 2}
    gust = np.array([float(axis == "z") for axis in axes])
    return np.array([rows[axis] for axis in axes]), gust, np.array([noise[axis] for axis in axes])


def averaged(frequency_hz: float, damping: float, rms_m: float, axes: str, step_s: float, drift: bool) -> Discrete:
    """Exact averages over ``step_s``."""
    C, gust, noise = _views(frequency_hz, damping, axes)
    m = len(axes)
    extra = m if drift else 0
    omega = 2 * np.pi * frequency_hz
    A, B = np.zeros((2 + extra,) * 2), np.zeros((2 + extra, 1 + m + extra))
    A[:2, :2] = [[0, 1], [-(omega**2), -2 * damping * omega]]
    B[1, 0] = 1.0
    D = np.zeros((m, 1 + m + extra))
    D[:, 0], D[:, 1 : 1 + m] = gust, np.eye(m)
    W = np.concatenate([[gust_density(frequency_hz, damping, rms_m)], noise])
    rows = np.zeros((m, 2 + extra))
    rows[:, :2] = C
    if drift:
        A[2:, 2:], B[2:, 1 + m :], rows[:, 2:] = -np.eye(m) / BIAS_TIME_S, np.eye(m), np.eye(m)
        W = np.concatenate([W, 2 * _bias_variances(axes) / BIAS_TIME_S])
    return averages(A, B, rows, D, np.diag(W), step_s)


def held(frequency_hz: float, damping: float, rms_m: float, axes: str, step_s: float, drift: bool) -> Discrete:
    """Gust held through ``step_s``, sensors read at its start."""
    C, gust, noise = _views(frequency_hz, damping, axes)
    m = len(axes)
    extra = m if drift else 0
    omega = 2 * np.pi * frequency_hz
    system = np.array([[0, 1, 0], [-(omega**2), -2 * damping * omega, 1], [0, 0, 0]])
    exponential = scipy.linalg.expm(system * step_s)
    load = gust_density(frequency_hz, damping, rms_m) / step_s
    F, Q, H, S = (np.zeros(s) for s in (((2 + extra,) * 2), ((2 + extra,) * 2), (m, 2 + extra), (2 + extra, m)))
    push = exponential[:2, 2]
    F[:2, :2], Q[:2, :2] = exponential[:2, :2], np.outer(push, push) * load
    H[:, :2], S[:2] = C, np.outer(push, gust) * load
    if drift:
        keep = np.exp(-step_s / BIAS_TIME_S)
        F[2:, 2:], H[:, 2:] = keep * np.eye(m), np.eye(m)
        Q[2:, 2:] = np.diag(_bias_variances(axes)) * (1 - keep**2)
    return Discrete(F, H, Q, np.diag(noise / step_s) + np.outer(gust, gust) * load, S)


def _bias_variances(axes: str) -> Floats:
    return np.array([GYRO_BIAS**2 if axis == "p" else ACCEL_BIAS**2 for axis in axes])
