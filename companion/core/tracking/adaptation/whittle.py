"""Debiased Whittle fit: modal and gust parameters from a few seconds of vertical acceleration.

The tapered periodogram ``I_j`` of a segment has expectation ``E_j = (S * |W|^2)(f_j)`` and is nearly exponential; the
fit minimises ``sum ln E_j + I_j / E_j`` plus the prior's quadratic (Sykulski et al., Biometrika 106, 2019) by Fisher
scoring. The symmetric family is read from the tips' mean, the antisymmetric one from half their difference; with one
tip, both are fitted to it at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.tracking.adaptation.periodogram import Periodogram
from companion.core.tracking.parameters import ParameterIndex
from companion.native.library import ARRAY, INTEGER, RECORD, kernel, packed
from companion.records import Floats

_PEAK_WIDTH = 0.03  # chosen, relative half width: of a lightly damped mode


class LogNormalPrior(NamedTuple):
    """Normal prior of the logarithms of one or two families' parameters.

    Attributes
    ----------
    mean, sigma : (p,) float64
    low, high : (p,) float64
        Bounds beyond which a parameter loses its meaning: a second mode that is all damping is no mode.
    reference_hz : (families,) float64
        Frequency at which each family's first load is stated.
    places : ParameterIndex
        Where the parameters of which family are.
    """

    mean: Floats
    sigma: Floats
    low: Floats
    high: Floats
    reference_hz: Floats
    places: ParameterIndex


@dataclass(frozen=True, slots=True)
class WhittleFit:
    """End of the iteration.

    Attributes
    ----------
    log_params, log_sigma : (p,) float64
    neg_log_posterior : float
        Up to a constant.
    """

    log_params: Floats
    log_sigma: Floats
    neg_log_posterior: float


_pack_periodogram, _pack_prior = packed(Periodogram), packed(LogNormalPrior)
_expected = kernel("whittle_expected", RECORD, RECORD, ARRAY, ARRAY)
_neg_log_posterior = kernel("whittle_cost", RECORD, RECORD, ARRAY, ARRAY)
_gradient = kernel("whittle_gradient", RECORD, RECORD, ARRAY, ARRAY, ARRAY)
_improve = kernel("whittle_improve", RECORD, RECORD, ARRAY, INTEGER, ARRAY, ARRAY)


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
    expected = np.empty(len(periodogram.power))
    _expected(_pack_periodogram(periodogram), _pack_prior(prior), log_params, expected)
    return expected


def neg_log_likelihood(periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats) -> float:
    """Whittle's negative log likelihood of the periodogram at ``log_params`` (p,)."""
    return _costs(periodogram, prior, log_params)[0]


def neg_log_posterior(periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats) -> float:
    """Negative log posterior at ``log_params`` (p,), up to a constant."""
    return _costs(periodogram, prior, log_params)[1]


def _costs(periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats) -> tuple[float, float]:
    """Negative log likelihood and posterior."""
    costs = np.empty(2)
    _neg_log_posterior(_pack_periodogram(periodogram), _pack_prior(prior), log_params, costs)
    likelihood, posterior = costs.tolist()
    return likelihood, posterior


def fit(periodogram: Periodogram, prior: LogNormalPrior, start: Floats, rounds: int) -> WhittleFit:
    """Improve ``start`` (p,) by at most ``rounds`` steps of Fisher scoring with Levenberg-Marquardt damping.

    Returns
    -------
    WhittleFit
        ``log_sigma`` is from the inverse Fisher information at the end.
    """
    log_params, best, information = start.copy(), np.empty(1), np.empty((len(start), len(start)))
    _improve(_pack_periodogram(periodogram), _pack_prior(prior), log_params, rounds, information, best)
    spread: Floats = np.sqrt(np.diag(np.asarray(np.linalg.inv(information), dtype=np.float64)))
    return WhittleFit(log_params, spread, float(best[0]))


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
    gradient, information = np.empty(len(log_params)), np.empty((len(log_params), len(log_params)))
    _gradient(_pack_periodogram(periodogram), _pack_prior(prior), log_params, gradient, information)
    return gradient, information


def scan(
    periodogram: Periodogram, prior: LogNormalPrior, start: Floats, which: int, offsets: Floats
) -> tuple[Floats, Floats]:
    """Negative log posterior with one parameter at ``prior.mean + offsets`` and its family's load rescaled to fit.

    Parameters
    ----------
    periodogram : Periodogram
        Measured.
    prior : LogNormalPrior
        Of the parameters.
    start : (p,) float64
        Log parameters to begin from.
    which : int
        Index of the parameter; two behind it is its load.
    offsets : (m,) float64
        Offsets of the parameter's logarithm.

    Returns
    -------
    costs : (m,) float64
    starts : (m, p) float64
    """
    load = which + 2
    starts = np.tile(start, (len(offsets), 1))
    starts[:, which] = prior.mean[which] + offsets
    costs = np.empty(len(offsets))
    for k, log_params in enumerate(starts):
        for _ in range(2):
            expected = expected_power(periodogram, prior, log_params)
            log_params[load] += np.log(
                max(float(periodogram.weight @ (periodogram.power / expected) / periodogram.weight.sum()), 1e-9)
            )
        costs[k] = neg_log_posterior(periodogram, prior, log_params)
    return costs, starts


def find_unmodelled_peak(
    periodogram: Periodogram, prior: LogNormalPrior, start: Floats, which: int
) -> tuple[Floats, float]:
    """Peak of the periodogram that the model at ``start`` does not explain, as a place for a further mode.

    Parameters
    ----------
    periodogram : Periodogram
        Measured.
    prior : LogNormalPrior
        Of the parameters.
    start : (p,) float64
        Log parameters to begin from.
    which : int
        Index of the frequency to move; its damping and load follow it.

    Returns
    -------
    moved : (p,) float64
    gain : float
        Log likelihood that it may gain.
    """
    expected = expected_power(periodogram, prior, start)
    f, w = periodogram.frequency_hz, periodogram.weight
    middle, reach = prior.mean[which], 2.5 * prior.sigma[which]
    tried = np.exp(np.arange(middle - reach, middle + reach + 1e-9, _PEAK_WIDTH))
    tried = tried[(tried > f[0]) & (tried < 0.98 * f[-1])]
    if not len(tried):
        return start, 0.0
    summed, weights_sum = (np.concatenate([[0.0], np.cumsum(x)]) for x in (w * periodogram.power / expected, w))
    low, high = (np.searchsorted(f, tried * (1.0 + sense * _PEAK_WIDTH)) for sense in (-1, 1))
    count = np.maximum(weights_sum[high] - weights_sum[low], 1e-9)
    excess = np.maximum((summed[high] - summed[low]) / count, 1.0)
    gain = count * (excess - 1.0 - np.log(excess)) - 0.5 * ((np.log(tried) - middle) / prior.sigma[which]) ** 2
    best = int(np.argmax(gain))
    moved = start.copy()
    local = float(np.interp(tried[best], f, expected)) * (excess[best] - 1.0)
    damping = float(np.exp(prior.mean[which + 1]))
    moved[which : which + 3] = np.log(tried[best]), prior.mean[which + 1], np.log(8.0 * damping**2 * local + 1e-12)
    return moved, float(gain[best])
