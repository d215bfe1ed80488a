"""On-line adaptation: once a second the most probable parameters for the last seconds of vertical acceleration.

A long segment tells the gust's corners, and so the slow bend; where the wing drifts, it is fitted in the time in which
the vibration is stationary (:mod:`companion.core.tracking.adaptation.frequency_drift`). In the first ten seconds the
parameters move by much; the filter then starts again from the beginning, or early errors stay in the biases.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, TypeVar, cast

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.adaptation.channels import COLUMNS, ROLL, STATIC, Channels
from companion.core.tracking.adaptation.frequency_drift import (
    estimate_drift_rate,
    frequency_mask,
    time_warped,
    to_segment_end,
    to_warped_time,
)
from companion.core.tracking.adaptation.noise_psd import NoiseSpectrum
from companion.core.tracking.adaptation.periodogram import Periodogram, make_periodogram, make_periodograms
from companion.core.tracking.adaptation.whittle import (
    LogNormalPrior,
    WhittleFit,
    find_unmodelled_peak,
    fit,
    neg_log_likelihood,
    scan,
)
from companion.core.tracking.model import WingParameters
from companion.core.tracking.parameters import (
    CORNER_1,
    CORNER_2,
    FREQUENCY,
    LOAD,
    ModeParameters,
    ParameterIndex,
    parameter_index,
    parameter_limits,
)
from companion.core.tracking.states import P_ROOT, SensorNoise, StateLayout
from companion.records import Bools, Floats

_LONG_S = 20.0  # chosen: five periods of the lowest frequency that is fitted
_SEGMENT_S = 4.0  # chosen: short, so that a drifting peak is hardly broadened
_EARLY_S = 10.0  # chosen: until then the filter starts again with new parameters
_FIRST_S = 1.5  # chosen: seven periods at 5 Hz for the first fit
_PERIOD_S = 1.0  # chosen: between fits
_SCAN_UNTIL_S = 6.0  # chosen: until then every fit scans the frequency
_PEAK_EVIDENCE = 8.0  # chosen, log likelihood: pays for looking at many frequencies
_FURTHER_EVIDENCE = 3.0  # chosen, log likelihood: about one for each of its parameters
_PRUNED_LOAD_RATIO = 1e-7  # chosen: of the first mode's load, invisible
_CORNERS_HZ = ((2.0, 8.0), (5.0, 20.0), (1.0, 500.0), (500.0, 1000.0))  # chosen: slow, usual, one pole, white
_MAX_SCORING_STEPS = 6  # numerical: scoring converges in fewer from a good start
_MIN_GAIN = 1.0  # chosen, log posterior: a trial must be better by this
_MIN_FREQUENCY_HZ = 0.25  # chosen: down there the gust's corners show, which set a stiff wing's slow bend
_PRIOR_SIGMAS = 4.0  # convention: bounds of the parameters
_MAX_LOG_DRIFT = np.log(2.0)  # chosen: a loaded or iced wing drifts far beyond the prior at rest
_ALIASING_MEMORY_S = 5.0  # chosen: of the mean aliasing noise
_MIN_PRESENT = 0.98  # chosen: of the epochs of a segment
_GAP_EPOCHS = 11  # chosen, odd: mostly absent over so many epochs is a gap, a lost sample is none

_Ring = TypeVar("_Ring", bound=Any)


class Adaptation:
    """Parameters of both families, kept up to date.

    Attributes
    ----------
    parameters : (symmetric, antisymmetric)
    ambiguous : bool
        The last fit had two local optima of about the same posterior.
    refilter : bool
        The last fit happened early enough for the filter to start again.
    """

    def __init__(
        self,
        layout: StateLayout,
        noise: SensorNoise,
        prior: WingParameters,
        levers_m: tuple[float, float],
        step_s: float,
    ) -> None:
        self._channels, self._step_s = Channels(layout, noise, levers_m, step_s), step_s
        self._prior = prior
        self.parameters: WingParameters = prior
        self._bias_parameters, self._bend_per_g_m = np.zeros(len(layout.bias_parameters)), 0.0
        self.ambiguous = False
        self.refilter = False
        size, self._segment_epochs = round(_LONG_S / step_s), round(_SEGMENT_S / step_s)
        self._rows, self._present = np.zeros((size, COLUMNS)), np.zeros((size, 2), dtype=bool)
        self._sensitivity = np.zeros((size, 2, len(layout.bias_parameters)))
        self._count = 0
        self._next = round(_FIRST_S / step_s)
        self.fits = 0
        self._aliasing_noise = 0.0  # by edges of the last epochs that cut samples
        self._contradicted = False
        self._rates = [(0.0, 0.0), (0.0, 0.0)]  # of both families' frequencies, 1/s, and their sigmas
        self._single_tip = 0  # the present tip, where the other is absent

    @property
    def early(self) -> bool:
        """Whether the history is still to be stored."""
        return self._count < round(_EARLY_S / self._step_s)

    def split(self, epochs: Epochs) -> Iterator[Epochs]:
        """Cut a run where parameters may change, so that the spacing of calls changes nothing."""
        at = 0
        while at < epochs.length:
            end = min(epochs.length, at + max(self._next - self._count, 1))
            yield epochs.span(at, end)
            at = end

    def set_bias_parameters(self, bias_parameters: Floats, bend_per_g_m: float) -> None:
        """Bias parameters and bend per g as estimated; they correct the whole stored history."""
        self._bias_parameters, self._bend_per_g_m = bias_parameters.copy(), bend_per_g_m

    def add_epochs(self, epochs: Epochs, contradicted: bool = False) -> bool:
        """Take epochs; whether there are new parameters.

        ``contradicted``: the filter cannot explain its measurements, or could not with the last parameters. A further
        mode then needs no evidence from the vertical axes: a gyro, which the fit does not use, shows one a hundred
        times better.
        """
        self._contradicted = contradicted
        size = len(self._rows)
        first, last = self._count % size, self._count % size + epochs.length
        slots = slice(first, last) if last <= size else np.arange(first, last) % size
        self._rows[slots, :2], self._sensitivity[slots] = epochs.rows[:, :2], epochs.sensitivity[:, :2]
        self._rows[slots, ROLL], self._rows[slots, STATIC] = epochs.rows[:, P_ROOT], epochs.load_g
        self._present[slots] = epochs.present[:, :2]
        self._aliasing_noise += min(1.0, epochs.length * self._step_s / _ALIASING_MEMORY_S) * (
            _mean(epochs.aliasing_noise) - self._aliasing_noise
        )
        self.refilter = self.early
        self._count += epochs.length
        if self._count < self._next:
            return False
        elapsed = self._count * self._step_s
        self._next = round((np.floor(elapsed / _PERIOD_S + 1e-6) + 1.0) * _PERIOD_S / self._step_s)
        return self._fit_all(elapsed)

    def _fit_all(self, elapsed_s: float) -> bool:
        """Fit every family for which enough of the history is present; whether there are new parameters."""
        rows, present = self._corrected_history()
        since = self._last_gap(present)
        if since and len(rows) - since < self._segment_epochs:
            return False
        rows, present = rows[since:], present[since:]
        tips = present.mean(axis=0) >= _MIN_PRESENT
        if not tips.any():
            return False
        self.fits += 1
        self._single_tip = int(np.argmax(tips))
        self.ambiguous = False
        if tips.all():
            families = [self._fit_family(rows, (k,), elapsed_s)[0] for k in (0, 1)]
        else:
            families = self._fit_family(rows, (0, 1), elapsed_s)
        self.parameters = (families[0], families[1])
        return True

    def _last_gap(self, present: Bools) -> int:
        """Beginning of the newest segment with both tips, if one of them was absent for a while; 0 where neither was.

        What one tip alone says of both families is worth less than what both have said before.
        """
        both = present[:, 0] & present[:, 1]
        if both.mean() >= _MIN_PRESENT or not both.any():
            return 0
        mostly = np.convolve(both, np.ones(_GAP_EPOCHS), mode="same") > 0.5
        missing = np.flatnonzero(~mostly)
        return int(missing[-1]) + 1 + _GAP_EPOCHS // 2 if len(missing) else 0

    def _corrected_history(self) -> tuple[Floats, Bools]:
        """Stored rows (n, COLUMNS), oldest first, corrected for bias, and their presence (n, 2)."""
        count = min(self._count, len(self._rows))
        first = (self._count - count) % len(self._rows)
        rows, present = _in_order(self._rows, first, count).copy(), _in_order(self._present, first, count)
        sensitivity = _in_order(self._sensitivity, first, count)
        rows[:, :2] -= (sensitivity.reshape(2 * count, -1) @ self._bias_parameters).reshape(count, 2)
        rows[:, STATIC] *= self._bend_per_g_m
        return rows, present

    def _fit_family(self, rows: Floats, which: tuple[int, ...], elapsed_s: float) -> list[ModeParameters]:
        """Parameters of one family, or of both where only one tip is present."""
        estimates = (self.parameters, self._aliasing_noise, self._bend_per_g_m)
        samples, noise_spectrum = self._channels.channel(rows, which, self._single_tip, *estimates)
        prior = _join([self._prior[k] for k in which])
        start = np.concatenate([self.parameters[k].log_params() for k in which])
        band = self._band(which)
        length_s = len(samples) * self._step_s
        rate, rate_sigma = self._rates[which[0]]
        if elapsed_s > _EARLY_S:
            rate, rate_sigma = self._estimate_drift(samples, band, noise_spectrum, prior, start, rate)
        for k in which:
            self._rates[k] = rate, rate_sigma
        long, start = (
            make_periodogram(time_warped(samples, rate, self._step_s), self._step_s, band, noise_spectrum),
            to_warped_time(start, prior.places, rate, length_s),
        )
        if elapsed_s <= _SCAN_UNTIL_S:
            best = self._search(long, prior, self._scanned(long, prior, start))
        else:
            best = self._improved(long, prior, start, which[0])
        best = _prune_insignificant_modes(long, prior, best, -np.inf if self._contradicted else _FURTHER_EVIDENCE)
        by_rate = 0.5 * length_s * rate_sigma * frequency_mask(prior.places)
        log_params = to_segment_end(best.log_params, prior.places, rate, length_s)
        log_sigma = np.hypot(best.log_sigma, by_rate)
        return [
            self._prior[k].with_log_params(log_params[first:end], log_sigma[first:end])
            for k, first, end in zip(which, prior.places.first, prior.places.end, strict=True)
        ]

    def _estimate_drift(
        self,
        samples: Floats,
        band: tuple[float, float, float],
        noise_spectrum: NoiseSpectrum,
        prior: LogNormalPrior,
        start: Floats,
        rate: float,
    ) -> tuple[float, float]:
        """Drift rate one scoring step on from the last one, 1/s, and its sigma."""
        count = len(samples) // self._segment_epochs
        newest = samples[len(samples) - count * self._segment_epochs :].reshape(count, self._segment_epochs)
        segments = make_periodograms(newest, self._step_s, band, noise_spectrum)
        length_s = count * _SEGMENT_S
        middle = to_warped_time(start, prior.places, rate, length_s)
        return estimate_drift_rate(segments, _SEGMENT_S, prior, middle, rate)

    def _improved(self, periodogram: Periodogram, prior: LogNormalPrior, start: Floats, family: int) -> WhittleFit:
        """Fit from the last optimum; in turns also from other gust corners or with further modes at peaks.

        Such a trial costs more than all the rest: the families take turns.
        """
        best = fit(periodogram, prior, start, 3)
        if self.fits % 2 != family:
            return best
        trial = self.fits // 2 % (1 + len(_CORNERS_HZ))
        tried = (
            _with_corners(best.log_params, prior.places, _CORNERS_HZ[trial - 1])
            if trial
            else self._with_further(periodogram, prior, best.log_params)
        )
        if np.array_equal(tried, best.log_params):
            return best
        other = fit(periodogram, prior, tried, 2 * _MAX_SCORING_STEPS)
        return other if other.neg_log_posterior < best.neg_log_posterior - _MIN_GAIN else best

    def _search(self, periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> WhittleFit:
        """Fit from gusts with several pairs of corners: a wrong one has its own local optimum."""
        best: WhittleFit | None = None
        for corners_hz in (None, *_CORNERS_HZ):
            tried = start if corners_hz is None else _with_corners(start, prior.places, corners_hz)
            result = fit(periodogram, prior, self._with_further(periodogram, prior, tried), _MAX_SCORING_STEPS)
            if best is None or result.neg_log_posterior < best.neg_log_posterior:
                best = result
        assert best is not None
        return fit(periodogram, prior, best.log_params, _MAX_SCORING_STEPS)

    def _with_further(self, periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> Floats:
        """Start with each further mode moved to an unmodelled peak, where there is enough evidence."""
        least_evidence = 0.0 if self._contradicted else _PEAK_EVIDENCE
        for at in prior.places.further:
            moved, gain = find_unmodelled_peak(periodogram, prior, start, at)
            start = moved if gain > least_evidence else start
        return start

    def _band(self, which: tuple[int, ...]) -> tuple[float, float, float]:
        """Lowest frequency, first grouped frequency and highest frequency of a family's fit, Hz."""
        highest = 0.48 / self._step_s
        return _MIN_FREQUENCY_HZ, min(2.2 * max(self._prior[k].frequency_hz for k in which), 0.8 * highest), highest

    def _scanned(self, periodogram: Periodogram, prior: LogNormalPrior, start: Floats) -> Floats:
        """Start with each first frequency at the best of a scan; notes two local optima."""
        for at in prior.places.first:
            reach = min(3.0 * prior.sigma[at], 0.7)
            costs, starts = scan(periodogram, prior, start, at, np.linspace(-reach, reach, 21))
            best = int(np.argmin(costs))
            start = starts[best]
            self.ambiguous |= _two_answers(costs)
        return start


def _mean(values: Floats) -> float:
    """Mean, at a third of the price of numpy's for a few numbers."""
    return float(np.add.reduce(values, axis=None)) / values.size


def _in_order(ring: _Ring, first: int, count: int) -> _Ring:
    """The ``count`` entries of a ring from ``first`` on; as they lie where possible."""
    return cast(_Ring, np.concatenate([ring[first:], ring[:first]]) if first else ring[:count])


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


def _with_corners(start: Floats, index: ParameterIndex, corners_hz: tuple[float, float]) -> Floats:
    """Start with other corners of the gust."""
    moved = start.copy()
    moved[index.first + CORNER_1], moved[index.first + CORNER_2] = np.log(corners_hz)
    return moved


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
