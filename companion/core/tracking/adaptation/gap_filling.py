"""Gaps of a stored history: filled as its own spectrum has it, for a fit that takes every epoch for measured.

Zeros in a gap leak over all frequencies: 20 ms each 1.5 s passed for two hundred times the sensors' noise. Splines bend
otherwise than the wing, and overshoot under a white load: they err 1.3 to 6 times as much.
"""

from __future__ import annotations

import numpy as np

from companion.records import Bools, Floats, Ints

_ORDER = 32  # chosen, in epochs: a fraction of a period of the first mode is enough, its samples are nearly exact
_PASSES = 2  # chosen: the second takes its spectrum from what the first has filled
_REGULAR = 1e-9  # numerical: of the power, below any sensor's noise


def fill_gaps(values: Floats, present: Bools) -> Floats:
    """Values (n,), those that are not ``present`` (n,) replaced by the most probable ones.

    They leave the least residual of an autoregressive process that has the history's spectrum (Janssen, Veldhuis and
    Vries, IEEE TASSP 34, 1986).
    """
    missing = np.flatnonzero(~present)
    at = np.arange(len(values))
    filled = values.copy()
    filled[missing] = np.interp(missing, at[present], values[present])
    mean = float(filled.mean())
    filled -= mean
    # gaps farther apart than the order know nothing of each other
    groups = np.split(missing, np.flatnonzero(np.diff(missing) > _ORDER) + 1)
    for _ in range(_PASSES):
        precision = _precision(filled)
        filled[missing] = 0.0
        pull = np.convolve(filled, precision, mode="same")
        for group in groups:
            apart = np.abs(group[:, None] - group)
            matrix = np.where(apart <= _ORDER, precision[_ORDER + np.minimum(apart, _ORDER)], 0.0)
            filled[group] = -np.linalg.solve(matrix, pull[group])
    return filled + mean


def _precision(values: Floats) -> Floats:
    """Inverse covariance between values of a process with the spectrum of these, by their distance, (2 order + 1,)."""
    n = len(values)
    spectrum = np.fft.rfft(np.hanning(n) * values, 2 * n)
    covariance = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, 2 * n)[: _ORDER + 1]
    covariance[0] += _REGULAR * covariance[0] + np.finfo(np.float64).tiny
    lags: Ints = np.abs(np.arange(_ORDER)[:, None] - np.arange(_ORDER))
    predictor = np.linalg.solve(covariance[lags], covariance[1:])
    error = np.concatenate([[1.0], -predictor])
    return np.asarray(np.convolve(error, error[::-1]), dtype=np.float64)
