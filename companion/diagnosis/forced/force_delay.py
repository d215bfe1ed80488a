"""Delay of a force behind the response.

A force that left another filter than the response makes every coefficient wrong. A delay tau turns the phase of the
force by omega tau at all frequencies, which no mass, damper or spring does.
"""

from __future__ import annotations

import numpy as np

from companion.records import Complexes, Floats

_MOST = 8.0  # steps of a sample, that a delay is sought within (choice)
_COARSE, _FINE = 0.5, 0.05  # steps of the search, samples (choice)


def error_ratio(force: Complexes, columns: Complexes, omega: Floats, delay_s: float) -> float:
    """Error of least squares over the force, both rms; ``force`` (n,), ``columns`` (s, n), ``omega`` (n,) in rad/s."""
    advanced = force * np.exp(1j * omega * delay_s)
    values = np.linalg.lstsq(real_rows(columns).T, real_rows(advanced), rcond=None)[0]
    left = real_rows(advanced) - values @ real_rows(columns)
    return float(np.sqrt(np.mean(left**2) / np.mean(real_rows(advanced) ** 2)))


def least_error(force: Complexes, columns: Complexes, omega: Floats, step_s: float) -> tuple[float, float]:
    """Delay in s of the force (n,) behind the response with the least error ratio, and that ratio."""
    best = (0.0, error_ratio(force, columns, omega, 0.0))
    for step, reach in ((_COARSE, _MOST), (_FINE, _COARSE)):
        about = best[0]
        for away in np.arange(-reach, reach + 0.5 * step, step).tolist():
            delay_s = about + away * step_s
            best = min(best, (delay_s, error_ratio(force, columns, omega, delay_s)), key=lambda pair: pair[1])
    return best


def real_rows(values: Complexes) -> Floats:
    """Real parts of complex rows (..., n), then imaginary ones, (..., 2 n)."""
    return np.concatenate([values.real, values.imag], axis=-1)
