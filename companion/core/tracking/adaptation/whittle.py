"""Debiased Whittle fit: modal and gust parameters from a few seconds of vertical acceleration.

The tapered periodogram ``I_j`` of a stretch has expectation ``E_j = (S * |W|^2)(f_j)`` and is nearly exponential; the
fit minimises ``sum ln E_j + I_j / E_j`` plus the prior's quadratic (Sykulski et al., Biometrika 106, 2019) by Fisher
scoring. A family that moves both tips alike is read from their mean, the other from half their difference; with one
tip, both are fitted to it at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.adaptation.model_spectrum import acceleration_density, acceleration_slopes
from companion.core.tracking.adaptation.periodogram import Stretch, smeared
from companion.core.tracking.parameters import PARAMETERS
from companion.records import Floats

_PEAK_WIDTH = 0.03
_LARGEST_STEP = 1.0
_CONVERGED = 0.02
_GIVE_UP = 1e4
_LEAST_EXPECTED = 1e-12


class Prior(NamedTuple):
    """Normal prior of the logarithms of one or two families' parameters.

    Attributes
    ----------
    mean, sigma : (p,) float64
    low, high : (p,) float64
        Beyond these a parameter no longer means what it is called: a second mode that is all damping is no mode.
    reference_hz : (families,) float64
        Where each family's load is told.
    """

    mean: Floats
    sigma: Floats
    low: Floats
    high: Floats
    reference_hz: Floats


@dataclass(frozen=True, slots=True)
class Fit:
    """Where the fit ended.

    Attributes
    ----------
    logs, log_sigma : (p,) float64
    cost : float
        Negative log posterior, up to a constant.
    """

    logs: Floats
    log_sigma: Floats
    cost: float


@compiled
def expected_power(stretch: Stretch, prior: Prior, logs: Floats) -> Floats:
    """Expected periodogram at the parameters ``logs``."""
    density = stretch.floor.copy()
    for family in range(len(prior.reference_hz)):
        own = logs[family * PARAMETERS : (family + 1) * PARAMETERS]
        density += acceleration_density(own, stretch.grid, prior.reference_hz[family])
    return np.maximum(smeared(stretch, density), _LEAST_EXPECTED)


@compiled
def misfit(stretch: Stretch, prior: Prior, logs: Floats) -> float:
    """Negative log likelihood of the stretch."""
    expected = expected_power(stretch, prior, logs)
    return float(np.sum(stretch.weight * (np.log(expected) + stretch.power / expected)))


@compiled
def cost(stretch: Stretch, prior: Prior, logs: Floats) -> float:
    """Negative log posterior."""
    return misfit(stretch, prior, logs) + 0.5 * float(np.sum(((logs - prior.mean) / prior.sigma) ** 2))


def fit(stretch: Stretch, prior: Prior, start: Floats, rounds: int) -> Fit:
    """Improve ``start`` by at most ``rounds`` of Fisher scoring, damped as Levenberg and Marquardt do."""
    logs, best, information = _improve(stretch, prior, start, rounds)
    spread: Floats = np.sqrt(np.diag(np.asarray(np.linalg.inv(information), dtype=np.float64)))
    return Fit(logs, spread, float(best))


@compiled
def _improve(stretch: Stretch, prior: Prior, start: Floats, rounds: int) -> tuple[Floats, float, Floats]:
    """Where the rounds end, its cost and the information there."""
    logs, best, damping = start.copy(), cost(stretch, prior, start), 1e-3
    gradient, information = slopes(stretch, prior, logs)
    for _ in range(rounds):
        value, promised = best, np.inf
        while value >= best and promised > _CONVERGED and damping < _GIVE_UP:  # a step is cheap beside a slope
            tried = _moved(prior, logs, gradient, information, damping)
            promised = -0.5 * float(gradient @ (tried - logs))
            value = cost(stretch, prior, tried)
            damping = 0.2 * damping if value < best else max(8.0 * damping, 1e-2)
        if value >= best:
            break
        done = best - value < _CONVERGED
        logs, best = tried, value
        gradient, information = slopes(stretch, prior, logs)
        if done:
            break
    return logs, best, information


@compiled
def _moved(prior: Prior, logs: Floats, gradient: Floats, information: Floats, damping: float) -> Floats:
    """One step, parameters at their limits held where the step would push them out."""
    held = ((logs <= prior.low) & (gradient > 0.0)) | ((logs >= prior.high) & (gradient < 0.0))
    pushed, reduced = -gradient, information.copy()
    for k in range(len(logs)):
        reduced[k, k] *= 1.0 + damping
    for k in range(len(logs)):
        if held[k]:
            pushed[k] = 0.0
            reduced[k, :] = 0.0
            reduced[:, k] = 0.0
            reduced[k, k] = 1.0
    step = np.minimum(np.maximum(np.linalg.solve(reduced, pushed), -_LARGEST_STEP), _LARGEST_STEP)
    moved: Floats = np.minimum(np.maximum(logs + step, prior.low), prior.high)
    return moved


@compiled
def slopes(stretch: Stretch, prior: Prior, logs: Floats) -> tuple[Floats, Floats]:
    """Gradient and Fisher information of the cost."""
    jacobian = np.empty((len(logs), len(stretch.power)))
    density = stretch.floor.copy()
    for family in range(len(prior.reference_hz)):
        first = family * PARAMETERS
        own = logs[first : first + PARAMETERS]
        rows = acceleration_slopes(own, stretch.grid, prior.reference_hz[family])
        density += rows[0]
        for k in range(PARAMETERS):
            jacobian[first + k] = smeared(stretch, rows[1 + k])
    expected = np.maximum(smeared(stretch, density), _LEAST_EXPECTED)
    jacobian /= expected
    pull = (logs - prior.mean) / prior.sigma**2
    gradient = jacobian @ (stretch.weight * (1.0 - stretch.power / expected)) + pull
    information = (stretch.weight * jacobian) @ jacobian.T + np.diag(1.0 / prior.sigma**2)
    return gradient, information


def scan(stretch: Stretch, prior: Prior, start: Floats, which: int, offsets: Floats) -> tuple[Floats, Floats]:
    """Cost with one parameter at ``prior.mean + offsets`` and its family's load rescaled to fit: costs and starts."""
    load = which + 2
    starts = np.tile(start, (len(offsets), 1))
    starts[:, which] = prior.mean[which] + offsets
    costs = np.empty(len(offsets))
    for k, logs in enumerate(starts):
        for _ in range(2):
            expected = expected_power(stretch, prior, logs)
            logs[load] += np.log(max(float(stretch.weight @ (stretch.power / expected) / stretch.weight.sum()), 1e-9))
        costs[k] = cost(stretch, prior, logs)
    return costs, starts


def seek_peak(stretch: Stretch, prior: Prior, start: Floats, which: int) -> tuple[Floats, float]:
    """Look for a peak that the model at ``start`` has not: the start moved there, and the log likelihood it may gain.

    ``which`` is the index of the frequency to move; its damping and load follow it.
    """
    expected = expected_power(stretch, prior, start)
    f, w = stretch.frequency_hz, stretch.weight
    middle, reach = prior.mean[which], 2.5 * prior.sigma[which]
    tried = np.exp(np.arange(middle - reach, middle + reach + 1e-9, _PEAK_WIDTH))
    tried = tried[(tried > f[0]) & (tried < 0.98 * f[-1])]
    if not len(tried):
        return start, 0.0
    summed, weighed = (np.concatenate([[0.0], np.cumsum(x)]) for x in (w * stretch.power / expected, w))
    low, high = (np.searchsorted(f, tried * (1.0 + turn * _PEAK_WIDTH)) for turn in (-1, 1))
    count = np.maximum(weighed[high] - weighed[low], 1e-9)
    excess = np.maximum((summed[high] - summed[low]) / count, 1.0)
    gain = count * (excess - 1.0 - np.log(excess)) - 0.5 * ((np.log(tried) - middle) / prior.sigma[which]) ** 2
    best = int(np.argmax(gain))
    moved = start.copy()
    local = float(np.interp(tried[best], f, expected)) * (excess[best] - 1.0)
    damping = float(np.exp(prior.mean[which + 1]))
    moved[which : which + 3] = np.log(tried[best]), prior.mean[which + 1], np.log(8.0 * damping**2 * local + 1e-12)
    return moved, float(gain[best])
