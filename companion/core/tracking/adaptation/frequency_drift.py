"""Drift of the modal frequencies: one relative rate for all frequencies of a segment.

A segment long enough to tell the gust's corners is too long for a wing whose frequency drifts: the peak is broadened,
and what is fitted is the frequency of its middle. Where the logarithm of the frequency grows by ``r`` each second, the
vibration is stationary in a time that runs as ``exp(r t)``. The segment is resampled on that time, with the rate of
greatest posterior density, shrunk by the probability that the wing drifts at all.
"""

from __future__ import annotations

import numpy as np

from companion.core.tracking.adaptation.periodogram import Periodogram
from companion.core.tracking.adaptation.whittle import LogNormalPrior, gradient_and_fisher
from companion.core.tracking.parameters import DAMPING, ParameterIndex
from companion.records import Floats

_SIGMA_PER_S = 0.01  # chosen, relative: prior of a wing that drifts
_LOG_ODDS_AGAINST = 2.0  # chosen: most wings do not drift, and each second is a test
_MAX_PER_S = 0.03  # chosen: three sigma of the prior
_STEP_PER_S = 0.01  # numerical: largest scoring step
_MIN_PER_S = 2e-4  # chosen: 0.4 % over a segment moves nothing
_NO_GROWTH = 1e-6  # numerical: below it the series is exact
_TAPS = 16  # numerical: of the windowed sinc; error below 0.4 % at 40 Hz of 250 (test_tracking_drift)
_FRACTIONS = 512  # numerical: tabulated fractions of a step
_BETA = 8.0  # convention: Kaiser window


def time_warped(samples: Floats, rate_per_s: float, step_s: float) -> Floats:
    """Samples (n,) on the time in which a frequency that grows by the rate is constant; same length and number."""
    if abs(rate_per_s) < _MIN_PER_S:
        return samples
    count = len(samples)
    total = rate_per_s * count * step_s
    fraction_of_time = (np.arange(count) + 0.5) / count  # in warped time
    place = count * np.log1p(fraction_of_time * np.expm1(total)) / total - 0.5
    before = np.floor(place)
    fraction = np.rint((place - before) * _FRACTIONS).astype(np.int64)
    first = np.clip(before.astype(np.int64) - (_TAPS // 2 - 1), 0, count - _TAPS)
    neighbours = np.lib.stride_tricks.sliding_window_view(samples, _TAPS)[first]
    return np.asarray(np.einsum("nk,nk->n", neighbours, np.take(_WEIGHTS, fraction, axis=0)))


def to_segment_end(log_params: Floats, index: ParameterIndex, rate_per_s: float, length_s: float) -> Floats:
    """Log parameters (p,) at the end of a segment from those in warped time."""
    return log_params + _log_growth(rate_per_s, length_s) * frequency_mask(index)


def to_warped_time(log_params: Floats, index: ParameterIndex, rate_per_s: float, length_s: float) -> Floats:
    """Log parameters (p,) in warped time from those at the end of a segment: inverse of :func:`to_segment_end`."""
    return log_params - _log_growth(rate_per_s, length_s) * frequency_mask(index)


def _log_growth(rate_per_s: float, length_s: float) -> float:
    """Logarithm of the end frequency over the constant frequency in warped time."""
    total = rate_per_s * length_s
    return float(np.log(total / -np.expm1(-total))) if abs(total) > _NO_GROWTH else 0.5 * total


def frequency_mask(index: ParameterIndex) -> Floats:
    """1 for each frequency among the parameters, else 0, (p,)."""
    mask = np.zeros(index.end[-1])
    mask[index.first], mask[index.further] = 1.0, 1.0
    return mask


def estimate_drift_rate(
    segments: list[Periodogram], spacing_s: float, prior: LogNormalPrior, log_params: Floats, rate_per_s: float
) -> tuple[float, float]:
    """One scoring step from a drift rate to the most probable one, shrunk by the probability that there is a drift.

    The first modes must tell it alone and together with further ones, and the smaller rate counts: an engine that
    passes for a further mode changes its speed, and a line that passes for a first one is switched.

    Parameters
    ----------
    segments : list of Periodogram
        Short consecutive segments; short, so that their own broadening is small.
    spacing_s : float
        From one segment to the next.
    prior : LogNormalPrior
        Of the parameters.
    log_params : (p,) float64
        Parameters in the middle of all segments; each family's frequencies grow at the rate.
    rate_per_s : float
        Where the step begins.

    Returns
    -------
    rate_per_s, sigma_per_s : float
        The possibility of no drift is part of the sigma. Both are 0 where a mode rings on for longer than a segment: it
        is a line there, whose few bins are correlated and would count as independent evidence of a drift. A line that
        does drift is broadened over the whole segment and is fitted with a larger damping.
    """
    if _rings_on(log_params[prior.places.first] + log_params[prior.places.first + DAMPING], spacing_s):
        return 0.0, 0.0
    first = np.zeros(len(log_params))
    first[prior.places.first] = 1.0
    alone = _stepped(segments, spacing_s, prior, log_params, rate_per_s, first)
    if not len(prior.places.further):
        return alone
    together = _stepped(segments, spacing_s, prior, log_params, rate_per_s, frequency_mask(prior.places))
    return alone if abs(alone[0]) <= abs(together[0]) else together


def _stepped(
    segments: list[Periodogram],
    spacing_s: float,
    prior: LogNormalPrior,
    log_params: Floats,
    rate_per_s: float,
    drifting: Floats,
) -> tuple[float, float]:
    """Rate and sigma by a scoring step, where those of the parameters (p,) drift at which ``drifting`` is 1."""
    size = len(log_params)
    flat_prior = prior._replace(sigma=np.full(size, np.inf))
    gradient, information = np.zeros(size + 1), np.zeros((size + 1, size + 1))
    jacobian = np.eye(size + 1)[:, :size]  # of a segment's parameters by those of the middle and the rate, transposed
    for number, segment in enumerate(segments):
        jacobian[size] = (number - 0.5 * (len(segments) - 1)) * spacing_s * drifting
        segment_gradient, segment_information = gradient_and_fisher(
            segment, flat_prior, log_params + rate_per_s * jacobian[size]
        )
        gradient += jacobian @ segment_gradient
        information += jacobian @ segment_information @ jacobian.T
    gradient += np.append((log_params - prior.mean) / prior.sigma**2, rate_per_s / _SIGMA_PER_S**2)
    information += np.diag(np.append(prior.sigma, _SIGMA_PER_S) ** -2.0)
    step = np.linalg.solve(information, -gradient)[size]
    sigma = np.sqrt(np.linalg.inv(information)[size, size])
    stepped = rate_per_s + float(np.clip(step, -_STEP_PER_S, _STEP_PER_S))
    evidence = 0.5 * (stepped / sigma) ** 2 + np.log(sigma / _SIGMA_PER_S) - _LOG_ODDS_AGAINST
    probability = 1.0 / (1.0 + np.exp(-evidence))
    sigma_shrunk = np.sqrt(probability * (sigma**2 + (1.0 - probability) * stepped**2))
    return float(np.clip(probability * stepped, -_MAX_PER_S, _MAX_PER_S)), float(sigma_shrunk)


def _rings_on(log_decay_hz: Floats, length_s: float) -> bool:
    """Whether a mode, of these logarithms of damping times frequency, decays by less than ``e`` in this time."""
    return bool(np.min(2.0 * np.pi * np.exp(log_decay_hz)) * length_s < 1.0)


def _windowed_sinc() -> Floats:
    """Kaiser-windowed sinc: weights of the taps for every fraction of a step, (fractions + 1, taps)."""
    distance = np.arange(_FRACTIONS + 1)[:, None] / _FRACTIONS - (np.arange(_TAPS) - (_TAPS // 2 - 1))
    inside = np.sqrt(np.clip(1.0 - (distance / (_TAPS / 2)) ** 2, 0.0, None))
    weights = np.sinc(distance) * np.i0(_BETA * inside)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


_WEIGHTS = _windowed_sinc()
