"""Initial values for effects with a frequency or instants of their own: peaks of the fitted model's residual.

The residual gives the score of every tone (its periodogram), of every parametric excitation of the stiffness (the
periodogram of residual force times spring force) and of every impulse (the residual force itself). Each proposal says
how many places were tried, which its strength has to pay for.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from companion.core.wing.effect import Effect, ResidualPeak
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, expect, log_likelihood
from companion.units import MAD_TO_SIGMA

_MARGIN = 1.0  # nats by which a peak must exceed the strongest of so many trials by chance (choice)
_APART_S = 0.15  # chosen: two kicks nearer than most of a period at 5 Hz are proposed as one
_IMPULSES = 3  # convention: kicks of one effect (core/wing/effects/forcing/impulsive_forcing.py)
_SLOWEST_CYCLES = 6.0  # in the recording: a slower line is drift (choice)
_BETWEEN = 4  # places a bin: a line half way between two bins shows 0.4 of its power in either (choice)
_FEWEST_BINS = 32  # of a band in which a line is sought (choice)
_NEIGHBOURS = 40  # bins on either side whose median is the background of a line (choice)
_FASTEST = 2.3  # of the first mode, for parametric excitation (choice)


@dataclass(frozen=True, slots=True)
class Proposal:
    """Peaks at which an effect should begin (Hz or s), strongest first, and the logarithm of how many were tried."""

    peaks: tuple[float, ...]
    log_trials: float


Proposals = Mapping[ResidualPeak, Proposal]
NO_PROPOSALS: Proposals = MappingProxyType({})


def find_proposals(models: Sequence[FlightModel], fitted: FlightFit) -> Proposals:
    """Peaks of one recording's residual; several recordings share no phase, and give none."""
    if len({model.recording for model in models}) > 1:
        return NO_PROPOSALS
    model, expectation = models[0], fitted.state.expectations[0]
    proposals = {
        ResidualPeak.LINE: _proposed(strongest_line(model, expectation)),
        ResidualPeak.STIFFNESS_LINE: _proposed(strongest_parametric_excitation(model, expectation)),
        ResidualPeak.IMPULSES: _impulses(models, fitted),
    }
    return {peak: proposal for peak, proposal in proposals.items() if proposal is not None}


def proposed_terms(kind: type[Effect], proposals: Proposals) -> list[EffectTerm]:
    """The effect at the peaks where it is to begin; none where no such peak stands out."""
    proposal = proposals.get(kind.starts_at) if kind.starts_at is not None else None
    return [] if proposal is None else [EffectTerm(kind.at_peaks(proposal.peaks), log_trials=proposal.log_trials)]


def candidates_of(
    kinds: Iterable[type[Effect]], channels: Sequence[str], proposals: Proposals = NO_PROPOSALS
) -> list[EffectTerm]:
    """Every effect at strength 0, once for each value at which it is to be begun and each channel it may follow.

    Effects that the data themselves must lead to (a tone's frequency) begin where ``proposals`` say, or not at all;
    effects that show in the samples themselves are not screened.
    """
    terms = []
    for kind in kinds:
        if kind.in_samples:
            continue
        if kind.starts_at is not None:
            terms += proposed_terms(kind, proposals)
            continue
        follows = [channel for channel in channels if kind.may_follow(channel)] if kind.follows_channel else [""]
        names, grids = list(kind.scan), [kind.scan[name] for name in kind.scan]
        for values in itertools.product(*grids):
            effect = kind.from_values(dict(zip(names, values, strict=True)))
            terms += [EffectTerm(effect, channel) for channel in follows]
    return terms


def _proposed(line: Line | None) -> Proposal | None:
    if line is None or line.log_tail > -_MARGIN:
        return None
    return Proposal((line.frequency_hz,), line.log_trials)


@dataclass(frozen=True, slots=True)
class BestTrial:
    """The likeliest of the values that an effect wants tried, and by how many nats it is likelier than none."""

    term: EffectTerm
    gain: float


def best_trial(models: Sequence[FlightModel], fitted: FlightFit, term: EffectTerm) -> BestTrial | None:
    """The likeliest of the values that the effect wants tried (a mount's resonance); None where none beats none."""
    trials = type(term.effect).trial_values(models[0].belief.airframe.wing.symmetric.frequency_hz.value)
    if not trials or is_trial(term):
        return None
    terms = [term.with_values(values) for values in trials]
    likelihoods = [_likelihood_with(models, fitted, trial) for trial in terms]
    best, log_trials = int(np.argmax(likelihoods)), math.log(len(trials))
    gain = likelihoods[best] - fitted.log_likelihood
    return BestTrial(replace(terms[best], log_trials=log_trials), gain) if gain > log_trials else None


def is_trial(term: EffectTerm) -> bool:
    """Whether a term stands where the likeliest of its trials was."""
    return type(term.effect).starts_at is None and term.log_trials > 0.0


def _likelihood_with(models: Sequence[FlightModel], fitted: FlightFit, term: EffectTerm) -> float:
    values = np.append(fitted.values, term.values)
    return log_likelihood(models, expect(models, values, (*fitted.terms, term), fitted.state.expectations))


@dataclass(frozen=True, slots=True)
class Line:
    """A single frequency that stands out, the log of its chance with all trials paid for, and the log of the trials."""

    frequency_hz: float
    log_tail: float
    log_trials: float


def strongest_line(model: FlightModel, expectation: Expectation) -> Line:
    """The highest peak of the whitened periodogram."""
    white = expectation.white_residual
    count = white.shape[1]
    # the whitened spectrum on finer frequencies: the taper's own shape interpolates
    fine = np.fft.fft(np.fft.ifft(white, axis=1), _BETWEEN * count, axis=1)[:, : _BETWEEN * (count - 1) + 1]
    power = np.sum(np.abs(fine) ** 2, axis=0)
    best = int(np.argmax(power))
    step = (model.band_hz[1] - model.band_hz[0]) / _BETWEEN
    return _line(float(model.band_hz[0] + step * best), float(power[best]), count, len(white))


def strongest_parametric_excitation(model: FlightModel, expectation: Expectation) -> Line | None:
    """The highest peak of the periodogram of residual force times spring force; None where there is no room for one."""
    product = np.sum(model.force_score(expectation) * model.spring_force(expectation), axis=0)
    power = np.abs(np.fft.rfft(product - product.mean(), _BETWEEN * len(product))) ** 2
    step = 1.0 / (_BETWEEN * model.observations.duration_s)
    first_hz = model.belief.airframe.wing.symmetric.frequency_hz.value
    low, high = math.ceil(_BETWEEN * _SLOWEST_CYCLES), min(int(_FASTEST * first_hz / step), len(power) - _BETWEEN)
    if high - low < _BETWEEN * _FEWEST_BINS:
        return None
    power = power[low:high]
    padded = np.pad(power, _BETWEEN * _NEIGHBOURS, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _BETWEEN * _NEIGHBOURS + 1)[:, ::_BETWEEN]
    ratio = power / (np.median(around, axis=1) / math.log(2.0))  # the median of an exponential is ln 2 of its mean
    best = int(np.argmax(ratio))
    return _line(float((low + best) * step), float(ratio[best]), len(ratio) // _BETWEEN, 1)


def _line(frequency_hz: float, power: float, bins: int, channels: int) -> Line:
    """The strongest of all frequencies of a spectrum, whose power in so many channels is Gamma(channels, 1) by chance.

    Between the bins there are more than one trial to each: the chance is that of any crossing of this height (Davies,
    Biometrika 74 (1987) 33), which for a whole band is bins sqrt(pi / 3) P^(channels - 1/2) e^-P / Gamma(channels).
    """
    height = max(power, 1.0)
    tail = (channels - 1.0) * math.log(height) - height - math.lgamma(channels)
    log_trials = math.log(bins) + 0.5 * math.log(math.pi * height / 3.0)
    return Line(frequency_hz, tail + log_trials, log_trials)


def _impulses(models: Sequence[FlightModel], fitted: FlightFit) -> Proposal | None:
    """The strongest instants of the residual force; three are taken, so three pay for the trials."""
    t_s, strength = [], []
    for model, expectation in zip(models, fitted.state.expectations, strict=True):
        force = model.force_score(expectation)[:2]
        inner = slice(len(model.observations.t_s) // 16, -len(model.observations.t_s) // 16)
        typical = MAD_TO_SIGMA * np.median(np.abs(force[:, inner]), axis=1, keepdims=True)
        t_s.append(model.observations.t_s[inner])
        strength.append(np.sum((force / typical)[:, inner] ** 2, axis=0))
    at_s, power = np.concatenate(t_s), np.concatenate(strength)
    places = len(power) / 4.0
    if power.max() < 2.0 * (math.log(places) + 2.0 * _MARGIN):
        return None
    chosen: list[float] = []
    for index in np.argsort(-power).tolist():
        if all(abs(at_s[index] - other) > _APART_S for other in chosen):
            chosen.append(float(at_s[index]))
        if len(chosen) == _IMPULSES:
            break
    log_trials = len(chosen) * math.log(places) - math.lgamma(len(chosen) + 1)
    return Proposal(tuple(chosen), log_trials)
