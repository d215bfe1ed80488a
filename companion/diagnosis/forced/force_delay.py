"""Delay of a force behind the response, and which derivative of the deflection the response is.

A channel that is called a deflection and is an acceleration, or a force that left another filter than the response,
makes every coefficient wrong. Both show without a law: the error of the force falls where the equation is written for
what was recorded. A delay tau turns the force by omega tau at all frequencies, which no mass, damper or spring does.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from companion.records import Floats

Spectra = npt.NDArray[np.complex128]
DEFLECTION = 0  # by definition: derivatives from the deflection to the response
SPEED = 1  # by definition, as before
ACCELERATION = 2  # by definition, as before
KINDS = {DEFLECTION: ("a deflection", "m"), SPEED: ("a speed", "mps"), ACCELERATION: ("an acceleration", "mps2")}
"""In words, and the unit at the end of a channel's name that says so."""
_MOST = 8.0  # steps of a sample, that a delay is sought within (choice)
_COARSE, _FINE = 0.5, 0.05  # steps of the search, samples (choice)
_CLEARER = 0.5  # of the stated kind's error: another kind with less is what was recorded (choice)
_POOR = 0.3  # of the force, from which the error of the stated kind is doubted (choice)


def error_ratio(force: Spectra, columns: Spectra, omega: Floats, delay_s: float) -> float:
    """Error of least squares over the force, both rms; ``force`` (n,), ``columns`` (s, n), ``omega`` (n,) in rad/s."""
    turned = force * np.exp(1j * omega * delay_s)
    values = np.linalg.lstsq(real_rows(columns).T, real_rows(turned), rcond=None)[0]
    left = real_rows(turned) - values @ real_rows(columns)
    return float(np.sqrt(np.mean(left**2) / np.mean(real_rows(turned) ** 2)))


def least_error(force: Spectra, columns: Spectra, omega: Floats, step_s: float) -> tuple[float, float]:
    """Delay in s of the force (n,) behind the response with the least error ratio, and that ratio."""
    best = (0.0, error_ratio(force, columns, omega, 0.0))
    for step, reach in ((_COARSE, _MOST), (_FINE, _COARSE)):
        about = best[0]
        for away in np.arange(-reach, reach + 0.5 * step, step).tolist():
            delay_s = about + away * step_s
            best = min(best, (delay_s, error_ratio(force, columns, omega, delay_s)), key=lambda pair: pair[1])
    return best


def another_kind(stated: int, errors: dict[int, float]) -> int | None:
    """The kind of response that the error ratios (kind to ratio) name instead of the stated one, None: as stated."""
    kind = min(errors, key=lambda entry: errors[entry])
    clearer = errors[stated] > _POOR and errors[kind] < _CLEARER * errors[stated]
    return kind if clearer else None


def real_rows(values: Spectra) -> Floats:
    """Real parts of complex rows (..., n), then imaginary ones, (..., 2 n)."""
    return np.concatenate([values.real, values.imag], axis=-1)
