"""Vibration's noise beside a gust's load in the spectral fit: two optima with nothing between them that fits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from companion.core.tracking.adaptation.noise_psd import NoiseSpectrum
from companion.core.tracking.adaptation.periodogram import Periodogram
from companion.core.tracking.adaptation.whittle import LogNormalPrior, WhittleFit, expected_power, fit
from companion.core.tracking.parameters import CORNER_1, CORNER_2, FURTHER_PARAMETERS, ParameterIndex
from companion.core.tracking.spread_work import Stages
from companion.records import Bools, Floats

CORNERS_HZ = ((2.0, 8.0), (5.0, 20.0), (1.0, 500.0), (500.0, 1000.0))  # chosen: slow, usual, one pole, white
MAX_SCORING_STEPS = 6  # numerical: scoring converges in fewer from a good start
_NOISE_STEPS = (8.0, 2.0, 0.5)  # chosen, of density: noise many times the belief shows where twice it does not
# chosen, in turns, of the density in the upper half of the band: between a quiet sensor under a white gust and a shaken
# sensor under a slow one nothing fits, so that steps do not lead from one to the other
NOISE_LEAPS = (1.0, 0.25, 4.0)
_LOUD = 100.0  # chosen, of density: above it every second leap leads back, to a quiet sensor under a white gust
_NOISE_SIGMA = np.log(8.0)  # chosen: of the density's logarithm; vibration is many times a quiet sensor's noise
_NOISE_GAIN = 6.0  # chosen, log posterior: a white gust's tail looks like noise, and vibration shows by a hundred
_CLEAR_EXCESS = 0.3  # chosen, of the expected power: a gust's tail is extrapolated no better
MOST_DEVIANCE = 2.0  # chosen, deviance per bin: 0.8 to 1.2 under gusts alone, up to 18 beside a petrol engine
_LEAST_RATIO = 1e-12  # numerical: a still sensor's power is 0


def next_leap(turn: int, ratio: float, clipped: bool) -> float | None:
    """Leap of a turn, for the ratio of noise learned by now; None is the one back to a quiet sensor.

    There is none back while samples are clipped: what that leaves is white noise of 1e5 times a quiet sensor's density
    (1.6 m/s^2 a sample where 0.5 % of a Gaussian are clipped at 16 g), and no vibration's.
    """
    if ratio > _LOUD and turn % 2 and not clipped:
        return None
    return NOISE_LEAPS[turn % len(NOISE_LEAPS)]


def fit_with_noise(
    louder: Callable[[float], NoiseSpectrum],
    ratio: float,
    leap: float | None,
    periodogram: Periodogram,
    prior: LogNormalPrior,
    best: WhittleFit,
) -> Stages[tuple[Periodogram, WhittleFit, float]]:
    """Periodogram, fit and ratio with other noise than that of ``ratio``, where it explains clearly more.

    ``leap`` is what :func:`next_leap` gives. No sensor is taken for better than its file says.
    """
    trials = [_leapt(louder, leap, periodogram, prior, best.log_params)]
    trials += [(factor * ratio, best.log_params, 3) for factor in _NOISE_STEPS]
    for tried, start, steps in trials:
        if tried < 1.0:
            continue
        other_periodogram = periodogram.with_noise(louder(tried))
        other = fit(other_periodogram, prior, start, steps)
        before, after = 0.5 * (np.log([ratio, tried]) / _NOISE_SIGMA) ** 2
        if other.neg_log_posterior + after < best.neg_log_posterior + before - _NOISE_GAIN:
            periodogram, best, ratio = other_periodogram, other, tried
        yield
    return periodogram, best, ratio


def _leapt(
    louder: Callable[[float], NoiseSpectrum],
    leap: float | None,
    periodogram: Periodogram,
    prior: LogNormalPrior,
    log_params: Floats,
) -> tuple[float, Floats, int]:
    """Noise ratio far from the present one, the start (p,) of a fit with it, and its scoring steps.

    Noise that explains the upper half of the band alone, ``leap`` times, beside a slow gust; for None the believed
    noise beside a white gust, and further modes as believed: they fill what white noise leaves.
    """
    if leap is None:
        start = with_corners(log_params, prior.places, CORNERS_HZ[-1])
        for at in prior.places.further:
            start[at : at + FURTHER_PARAMETERS] = prior.mean[at : at + FURTHER_PARAMETERS]
        return 1.0, start, 3 * MAX_SCORING_STEPS
    used = periodogram.weight > 0.0
    upper = used & (periodogram.frequency_hz > 0.5 * periodogram.frequency_hz[used][-1])
    alone = 1.0 + _noise_ratio(louder, periodogram, upper, louder(1.0)(periodogram.frequency_hz))
    return leap * alone, with_corners(log_params, prior.places, CORNERS_HZ[0]), 2 * MAX_SCORING_STEPS


def deviance_per_bin(periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> float:
    """Deviance per bin of a fit from ``start`` (p,) to all bins; about 1 by chance."""
    fitted = fit(periodogram, prior, start, 2 * MAX_SCORING_STEPS)
    ratio = np.maximum(periodogram.power / expected_power(periodogram, prior, fitted.log_params), _LEAST_RATIO)
    return 2.0 * float(np.mean(periodogram.weight * (ratio - 1.0 - np.log(ratio))))


def noise_beyond(
    louder: Callable[[float], NoiseSpectrum], periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats
) -> float:
    """Ratio of the believed noise that bins (b,) which were not fitted show beyond the fit; 0 where it is little."""
    beyond = periodogram.weight == 0.0
    if not beyond.any():
        return 0.0
    expected = expected_power(periodogram, prior, log_params)
    excess = float(np.median(periodogram.power[beyond] / expected[beyond])) - 1.0
    return _noise_ratio(louder, periodogram, beyond, expected) if excess > _CLEAR_EXCESS else 0.0


def _noise_ratio(
    louder: Callable[[float], NoiseSpectrum], periodogram: Periodogram, bins: Bools, explained: Floats
) -> float:
    """Ratio of the believed noise that explains the rest of the power in some bins (b,); none is negative."""
    frequency_hz = periodogram.frequency_hz[bins]
    believed = louder(2.0)(frequency_hz) - louder(1.0)(frequency_hz)
    return max(0.0, float(np.median((periodogram.power - explained)[bins] / believed)))


def with_corners(start: Floats, index: ParameterIndex, corners_hz: tuple[float, float]) -> Floats:
    """Start (p,) with other corners of the gust."""
    moved = start.copy()
    moved[index.first + CORNER_1], moved[index.first + CORNER_2] = np.log(corners_hz)
    return moved
