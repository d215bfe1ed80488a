"""The Whittle fit in plain numpy: ``native/whittle.c``."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.adaptation.periodogram import Periodogram
from companion.core.tracking.adaptation.whittle import LogNormalPrior
from companion.records import Floats
from sitl_tests.reference.kernels.model_spectrum import acceleration_density, acceleration_gradient

_MAX_LOG_STEP = 1.0  # numerical: a factor of e in one step
_CONVERGED = 0.02  # numerical, log posterior: far below one sigma
_MAX_DAMPING = 1e4  # numerical: Levenberg-Marquardt gives up
_MIN_EXPECTED = 1e-12  # numerical, (m/s^2)^2/Hz: below any sensor's noise


def expected_power(periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats) -> Floats:
    """Expected periodogram at the parameters.

    Parameters
    ----------
    periodogram : Periodogram
        Measured.
    prior : LogNormalPrior
        Of the parameters.
    log_params : (p,) float64
        Logarithms of the parameters.

    Returns
    -------
    (b,) float64
        (m/s^2)^2/Hz.
    """
    density = periodogram.noise_density.copy()
    for family in range(len(prior.reference_hz)):
        family_params = log_params[prior.places.first[family] : prior.places.end[family]]
        density += acceleration_density(family_params, periodogram.grid, prior.reference_hz[family])
    return np.maximum(window_convolved(periodogram, density), _MIN_EXPECTED)


def neg_log_likelihood(periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats) -> float:
    """Whittle's negative log likelihood of the periodogram at ``log_params`` (p,)."""
    expected = expected_power(periodogram, prior, log_params)
    return float(np.sum(periodogram.weight * (np.log(expected) + periodogram.power / expected)))


def neg_log_posterior(periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats) -> float:
    """Negative log posterior at ``log_params`` (p,), up to a constant."""
    return neg_log_likelihood(periodogram, prior, log_params) + 0.5 * float(
        np.sum(((log_params - prior.mean) / prior.sigma) ** 2)
    )


def improve(
    periodogram: Periodogram, prior: LogNormalPrior, start: Floats, rounds: int
) -> tuple[Floats, float, Floats]:
    """Parameters after the rounds, their negative log posterior and the information there."""
    log_params, best, damping = start.copy(), neg_log_posterior(periodogram, prior, start), 1e-3
    gradient, information = gradient_and_fisher(periodogram, prior, log_params)
    for _ in range(rounds):
        value, promised = best, np.inf
        while value >= best and promised > _CONVERGED and damping < _MAX_DAMPING:  # a step is cheap beside a slope
            tried = _moved(prior, log_params, gradient, information, damping)
            promised = -0.5 * float(gradient @ (tried - log_params))
            value = neg_log_posterior(periodogram, prior, tried)
            damping = 0.2 * damping if value < best else max(8.0 * damping, 1e-2)
        if value >= best:
            break
        done = best - value < _CONVERGED
        log_params, best = tried, value
        gradient, information = gradient_and_fisher(periodogram, prior, log_params)
        if done:
            break
    return log_params, best, information


def _moved(prior: LogNormalPrior, log_params: Floats, gradient: Floats, information: Floats, damping: float) -> Floats:
    """One damped step; parameters at a bound are held where the step would push them out."""
    at_limit = ((log_params <= prior.low) & (gradient > 0.0)) | ((log_params >= prior.high) & (gradient < 0.0))
    pushed, reduced = -gradient, information.copy()
    for k in range(len(log_params)):
        reduced[k, k] *= 1.0 + damping
    for k in range(len(log_params)):
        if at_limit[k]:
            pushed[k] = 0.0
            reduced[k, :] = 0.0
            reduced[:, k] = 0.0
            reduced[k, k] = 1.0
    step = np.minimum(np.maximum(np.linalg.solve(reduced, pushed), -_MAX_LOG_STEP), _MAX_LOG_STEP)
    moved: Floats = np.minimum(np.maximum(log_params + step, prior.low), prior.high)
    return moved


def gradient_and_fisher(periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats) -> tuple[Floats, Floats]:
    """Gradient and Fisher information of the negative log posterior.

    Parameters
    ----------
    periodogram : Periodogram
        Measured.
    prior : LogNormalPrior
        Of the parameters.
    log_params : (p,) float64
        Logarithms of the parameters.

    Returns
    -------
    gradient : (p,) float64
    information : (p, p) float64
        Expected, prior included.
    """
    jacobian = np.empty((len(log_params), len(periodogram.power)))
    density = periodogram.noise_density.copy()
    for family in range(len(prior.reference_hz)):
        first, end = prior.places.first[family], prior.places.end[family]
        family_params = log_params[first:end]
        rows = acceleration_gradient(family_params, periodogram.grid, prior.reference_hz[family])
        density += rows[0]
        for k in range(end - first):
            jacobian[first + k] = window_convolved(periodogram, rows[1 + k])
    expected = np.maximum(window_convolved(periodogram, density), _MIN_EXPECTED)
    jacobian /= expected
    pull = (log_params - prior.mean) / prior.sigma**2
    gradient = jacobian @ (periodogram.weight * (1.0 - periodogram.power / expected)) + pull
    information = (periodogram.weight * jacobian) @ jacobian.T + np.diag(1.0 / prior.sigma**2)
    return gradient, information


def window_convolved(periodogram: Periodogram, density: Floats) -> Floats:
    """Expected periodogram, numpy."""
    fine = np.lib.stride_tricks.sliding_window_view(density[: periodogram.low_grid], len(periodogram.kernel))
    return np.concatenate([fine[:: periodogram.stride] @ periodogram.kernel, density[periodogram.low_grid :]])
