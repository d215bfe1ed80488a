"""Whittle fit of both families in stages short enough for a turn of the service.

A stage takes less than 1 ms of a fast core. The data of a fit are fixed when it begins (:class:`FitInput`), so that its
result does not depend on when its stages run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.core.tracking.adaptation.channels import Channels
from companion.core.tracking.adaptation.frequency_drift import (
    estimate_drift_rate,
    frequency_mask,
    time_warped,
    to_segment_end,
    to_warped_time,
)
from companion.core.tracking.adaptation.noise_psd import VIBRATION_HZ, NoiseSpectrum
from companion.core.tracking.adaptation.noise_search import (
    CORNERS_HZ,
    MAX_SCORING_STEPS,
    MOST_DEVIANCE,
    deviance_per_bin,
    fit_with_noise,
    next_leap,
    noise_beyond,
    with_corners,
)
from companion.core.tracking.adaptation.periodogram import Periodogram, make_periodogram, make_periodograms
from companion.core.tracking.adaptation.slow_load import slow_corner_hz
from companion.core.tracking.adaptation.whittle import (
    LogNormalPrior,
    WhittleFit,
    find_unmodelled_peak,
    fit,
    neg_log_likelihood,
    scan,
)
from companion.core.tracking.model import WingParameters
from companion.core.tracking.parameters import FREQUENCY, LOAD, ModeParameters, parameter_index, parameter_limits
from companion.core.tracking.spread_work import Stages
from companion.records import Floats

SEGMENT_S = 4.0  # chosen: short, so that a drifting peak is hardly broadened
EARLY_S = 10.0  # chosen: until then the filter starts again with new parameters
_SCAN_UNTIL_S = 6.0  # chosen: until then every fit scans the frequency
_PEAK_EVIDENCE = 8.0  # chosen, log likelihood: pays for looking at many frequencies
_FURTHER_EVIDENCE = 3.0  # chosen, log likelihood: about one for each of its parameters
_MIN_GAIN = 1.0  # chosen, log posterior: a trial must be better by this
_PRUNED_LOAD_RATIO = 1e-7  # chosen: of the first mode's load, invisible
_MODES_REACH = 1.7  # chosen, of the highest believed frequency: a further mode may lie so much higher
# chosen, of the first believed frequency: clipping leaves a slow force, 20 times the gust's power at 0.7 Hz beside a
# mode at 5 Hz, 1.7 times at 1.7 Hz, 1.1 times at 2.5 Hz (measured), and no noise of a sensor looks so
_CLEAN_RATIO = 0.4
_MIN_FREQUENCY_HZ = 0.25  # chosen: down there the gust's corners show, which set a stiff wing's slow bend
_PRIOR_SIGMAS = 4.0  # convention: bounds of the parameters
_MAX_LOG_DRIFT = np.log(2.0)  # chosen: a loaded or iced wing drifts far beyond the prior at rest


class FitInput(NamedTuple):
    """Data of one fit.

    Attributes
    ----------
    rows : (n, COLUMNS) float64
        History, oldest first; vertical rows and load factor are corrected for bias, rates of slope as they came.
    single_tip : int or None
        The present tip where the other is absent.
    elapsed_s : float
        Since the first epoch.
    parameters : (symmetric, antisymmetric)
        Of the last fit.
    aliasing_noise : float
        Mean of the last seconds.
    bend_per_g_m : float
    contradicted : bool
        The filter cannot explain its measurements: a further mode needs no evidence.
    clipped : bool
        Samples are clipped often: their noise is what it shows (:func:`.noise_search.next_leap`).
    """

    rows: Floats
    single_tip: int | None
    elapsed_s: float
    parameters: WingParameters
    aliasing_noise: float
    bend_per_g_m: float
    contradicted: bool
    clipped: bool


class _FamilyData(NamedTuple):
    """Data of one family's fit, or of both.

    Attributes
    ----------
    which : tuple of int
        The families.
    prior : LogNormalPrior
        Of their parameters.
    louder : callable
        Noise spectrum with the believed noise times a ratio.
    full, fitted : Periodogram
        Of all samples, and below the frequencies that no mode reaches, where those count for nothing.
    length_s : float
        Of the samples.
    rate, rate_sigma : float
        Of the frequencies' change, 1/s.
    """

    which: tuple[int, ...]
    prior: LogNormalPrior
    louder: Callable[[float], NoiseSpectrum]
    full: Periodogram
    fitted: Periodogram
    length_s: float
    rate: float
    rate_sigma: float


class SpectralFit:
    """Most probable parameters of both families for a history.

    Attributes
    ----------
    ambiguous : bool
        The last fit had two local optima of about the same posterior.
    fits : int
        Fits begun.
    """

    def __init__(self, channels: Channels, prior: WingParameters, step_s: float) -> None:
        self._channels, self._prior, self._step_s = channels, prior, step_s
        self._segment_epochs = round(SEGMENT_S / step_s)
        self.ambiguous = False
        self.fits = 0
        self._rates = [(0.0, 0.0), (0.0, 0.0)]  # of both families' frequencies, 1/s, and their sigmas
        self._noise_ratios = [1.0, 1.0]  # of both families, for the bins that count
        self._limited = [False, False]  # whether bins above what the modes reach count for nothing

    def stages(self, inputs: FitInput) -> Stages[WingParameters]:
        """Fit both families."""
        self.fits += 1
        self.ambiguous = False
        if inputs.single_tip is None:
            (symmetric,) = yield from self._fit_family(inputs, (0,))
            yield
            (antisymmetric,) = yield from self._fit_family(inputs, (1,))
        else:
            symmetric, antisymmetric = yield from self._fit_family(inputs, (0, 1))
        return symmetric, antisymmetric

    def _fit_family(self, inputs: FitInput, which: tuple[int, ...]) -> Stages[list[ModeParameters]]:
        """Parameters of one family, or of both where only one tip is present."""
        data, start = yield from self._data(inputs, which)
        prior, fitted = data.prior, data.fitted
        yield
        best = self._begin(inputs, fitted, prior, start)
        yield
        if inputs.elapsed_s > _SCAN_UNTIL_S and self.fits % 2 == which[0]:
            best = self._retried(inputs, fitted, prior, best)
            yield
        has_turn = inputs.elapsed_s <= EARLY_S or self.fits % 2 != which[0]  # later the families take turns
        if has_turn:
            fitted, best, noise_ratio = yield from self._learned_noise(data, best, inputs.clipped)
        else:
            noise_ratio = inputs.parameters[which[0]].noise_ratio
        best = _prune_insignificant_modes(fitted, prior, best, -np.inf if inputs.contradicted else _FURTHER_EVIDENCE)
        by_rate = 0.5 * data.length_s * data.rate_sigma * frequency_mask(prior.places)
        log_params = to_segment_end(best.log_params, prior.places, data.rate, data.length_s)
        log_sigma = np.hypot(best.log_sigma, by_rate)
        slow_hz = [inputs.parameters[k].slow_corner_hz for k in which]
        if has_turn:
            yield
            slow_hz = self._slow_corners_hz(inputs, data, slow_hz, fitted, best.log_params)
        return [
            self._prior[k].with_log_params(log_params[first:end], log_sigma[first:end], slow, noise_ratio)
            for k, first, end, slow in zip(which, prior.places.first, prior.places.end, slow_hz, strict=True)
        ]

    def _data(self, inputs: FitInput, which: tuple[int, ...]) -> Stages[tuple[_FamilyData, Floats]]:
        """Periodograms of a family's samples, its drift taken out, and the logarithms at which its fit begins."""
        estimates = (inputs.parameters, inputs.aliasing_noise, inputs.bend_per_g_m)
        samples, believed = self._channels.channel(inputs.rows, which, inputs.single_tip or 0, *estimates)
        noise_ratio, tips_ratio = self._noise_ratios[which[0]], self._noise_ratios[1]

        def louder(ratio: float) -> NoiseSpectrum:
            return believed.louder(tips_ratio if which == (0,) else ratio, ratio)

        noise_spectrum = louder(noise_ratio)
        prior = _join([self._prior[k] for k in which])
        start = np.concatenate([inputs.parameters[k].log_params() for k in which])
        band, reach_hz = self._band(which, inputs.clipped), self._reach_hz(which) if self._limited[which[0]] else np.inf
        length_s = len(samples) * self._step_s
        rate, rate_sigma = self._rates[which[0]]
        if inputs.elapsed_s > EARLY_S:
            segments = self._segments(samples, band, noise_spectrum, reach_hz)
            middle = to_warped_time(start, prior.places, rate, len(segments) * SEGMENT_S)
            rate, rate_sigma = estimate_drift_rate(segments, SEGMENT_S, prior, middle, rate)
            yield
        for k in which:
            self._rates[k] = rate, rate_sigma
        full = make_periodogram(time_warped(samples, rate, self._step_s), self._step_s, band, noise_spectrum)
        data = _FamilyData(which, prior, louder, full, full.below(reach_hz), length_s, rate, rate_sigma)
        return data, to_warped_time(start, prior.places, rate, length_s)

    def _learned_noise(
        self, data: _FamilyData, best: WhittleFit, clipped: bool
    ) -> Stages[tuple[Periodogram, WhittleFit, float]]:
        """Periodogram and fit with the noise that explains most, and the ratio of it that the filter takes."""
        ratio = self._noise_ratios[data.which[0]]
        leap = next_leap((self.fits + 1) // 2, ratio, clipped)
        fitted, best, ratio = yield from fit_with_noise(data.louder, ratio, leap, data.fitted, data.prior, best)
        loud = data.full.with_noise(data.louder(ratio))
        limited = deviance_per_bin(loud, data.prior, best.log_params) > MOST_DEVIANCE
        for k in data.which:
            self._noise_ratios[k], self._limited[k] = ratio, limited
        yield
        return fitted, best, ratio + noise_beyond(data.louder, fitted, data.prior, best.log_params)

    def _slow_corners_hz(
        self, inputs: FitInput, data: _FamilyData, before_hz: list[float], fitted: Periodogram, log_params: Floats
    ) -> list[float]:
        """Corners of the families' slow loads, not above those ``before_hz`` while a history that began anew is short.

        It cannot exclude a slow load that the one before did not.
        """
        rates = self._channels.slope_rates(inputs.rows, data.which)
        new_hz = [slow_corner_hz(fitted, data.prior, log_params, int(at), rates) for at in data.prior.places.first]
        if inputs.elapsed_s > EARLY_S > data.length_s:
            return [min(before, new) for before, new in zip(before_hz, new_hz, strict=True)]
        return new_hz

    def _segments(
        self, samples: Floats, band: tuple[float, float, float], noise_spectrum: NoiseSpectrum, reach_hz: float
    ) -> list[Periodogram]:
        """Periodograms of the newest short segments."""
        count = len(samples) // self._segment_epochs
        newest = samples[len(samples) - count * self._segment_epochs :].reshape(count, self._segment_epochs)
        segments = make_periodograms(newest, self._step_s, band, noise_spectrum)
        return [segment.below(reach_hz) for segment in segments]

    def _begin(self, inputs: FitInput, periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> WhittleFit:
        """Fit from the last optimum; in the first seconds from the best of a scan."""
        if inputs.elapsed_s > _SCAN_UNTIL_S:
            return fit(periodogram, prior, start, 3)
        return self._search(inputs, periodogram, prior, self._scanned(periodogram, prior, start))

    def _retried(
        self, inputs: FitInput, periodogram: Periodogram, prior: LogNormalPrior, best: WhittleFit
    ) -> WhittleFit:
        """Better of ``best`` and a fit from other gust corners or with further modes at peaks, in turns.

        Such a trial costs more than all the rest: the families take turns.
        """
        trial = self.fits // 2 % (1 + len(CORNERS_HZ))
        tried = (
            with_corners(best.log_params, prior.places, CORNERS_HZ[trial - 1])
            if trial
            else self._with_further(inputs, periodogram, prior, best.log_params)
        )
        if np.array_equal(tried, best.log_params):
            return best
        other = fit(periodogram, prior, tried, 2 * MAX_SCORING_STEPS)
        return other if other.neg_log_posterior < best.neg_log_posterior - _MIN_GAIN else best

    def _search(self, inputs: FitInput, periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> WhittleFit:
        """Fit from gusts with several pairs of corners: a wrong one has its own local optimum."""
        best: WhittleFit | None = None
        for corners_hz in (None, *CORNERS_HZ):
            tried = start if corners_hz is None else with_corners(start, prior.places, corners_hz)
            result = fit(periodogram, prior, self._with_further(inputs, periodogram, prior, tried), MAX_SCORING_STEPS)
            if best is None or result.neg_log_posterior < best.neg_log_posterior:
                best = result
        assert best is not None
        return fit(periodogram, prior, best.log_params, MAX_SCORING_STEPS)

    def _with_further(self, inputs: FitInput, periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> Floats:
        """Start with each further mode moved to an unmodelled peak, where there is enough evidence."""
        least_evidence = 0.0 if inputs.contradicted else _PEAK_EVIDENCE
        for at in prior.places.further:
            moved, gain = find_unmodelled_peak(periodogram, prior, start, at)
            start = moved if gain > least_evidence else start
        return start

    def _band(self, which: tuple[int, ...], clipped: bool) -> tuple[float, float, float]:
        """Lowest frequency, first grouped frequency and highest frequency of a family's fit, Hz."""
        first_hz, highest = [self._prior[k].frequency_hz for k in which], 0.48 / self._step_s
        lowest = max(_MIN_FREQUENCY_HZ, _CLEAN_RATIO * min(first_hz)) if clipped else _MIN_FREQUENCY_HZ
        return lowest, min(2.2 * max(first_hz), 0.8 * highest), highest

    def _reach_hz(self, which: tuple[int, ...]) -> float:
        """Frequency above which no mode is believed, only noise and propulsion's bands, for which there is no model."""
        highest = max(mode.frequency_hz for k in which for mode in self._prior[k].modes)
        return max(_MODES_REACH * highest, 2.0 * VIBRATION_HZ)

    def _scanned(self, periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> Floats:
        """Start with each first frequency at the best of a scan; notes two local optima."""
        for at in prior.places.first:
            reach = min(3.0 * prior.sigma[at], 0.7)
            costs, starts = scan(periodogram, prior, start, at, np.linspace(-reach, reach, 21))
            best = int(np.argmin(costs))
            start = starts[best]
            self.ambiguous |= _two_answers(costs)
        return start


def _join(families: list[ModeParameters]) -> LogNormalPrior:
    """Prior of several families' parameters, with bounds."""
    log_params = [family.log_params() for family in families]
    mean, sigma = np.concatenate(log_params), np.concatenate([family.log_sigma for family in families])
    index = parameter_index([len(family.modes) for family in families])
    limits = [parameter_limits(len(family.modes)) for family in families]
    low, high = (np.log(np.concatenate(limit)) for limit in zip(*limits, strict=True))
    lowest = np.maximum(low, mean - _PRIOR_SIGMAS * sigma)
    highest = np.minimum(high, mean + _PRIOR_SIGMAS * sigma)
    lowest[index.further + LOAD] = low[index.further + LOAD]
    frequency = index.first + FREQUENCY
    lowest[frequency] = np.minimum(lowest[frequency], mean[frequency] - _MAX_LOG_DRIFT)
    highest[frequency] = np.maximum(highest[frequency], mean[frequency] + _MAX_LOG_DRIFT)
    return LogNormalPrior(mean, sigma, lowest, highest, np.array([family.reference_hz for family in families]), index)


def _prune_insignificant_modes(
    periodogram: Periodogram, prior: LogNormalPrior, result: WhittleFit, least_evidence: float
) -> WhittleFit:
    """Remove further modes without evidence: under a white load they cannot be told from the first."""
    log_params, reference = result.log_params.copy(), neg_log_likelihood(periodogram, prior, result.log_params)
    for first, at in zip(prior.places.further_first, prior.places.further, strict=True):
        tried, load = log_params.copy(), at + LOAD
        tried[load] = max(tried[first + LOAD] + np.log(_PRUNED_LOAD_RATIO), prior.low[load])
        without = neg_log_likelihood(periodogram, prior, tried)
        if without - reference < least_evidence:
            log_params, reference = tried, without
    return dataclasses.replace(result, log_params=log_params)


def _two_answers(costs: Floats) -> bool:
    """Whether a scan has two local optima within 2 of each other in negative log posterior."""
    inner = (costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:])
    lows = np.sort(costs[1:-1][inner])
    return len(lows) > 1 and bool(lows[1] - lows[0] < 2.0)
