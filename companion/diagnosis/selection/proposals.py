"""Where to begin with what has a frequency or an instant of its own: the data lead to it.

From the fitted model's residual come the score of every tone (its periodogram), of every swing of the stiffness (the
periodogram of residual force times spring force) and of every kick (the residual force itself). Each lead says how many
places were looked at, which its strength has to pay for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.fit import Fit, expect, log_likelihood
from companion.diagnosis.spectral_matrices import adjoint, apply

LED = frozenset({"tone", "periodic-forcing", "parametric-stiffness", "impulsive-forcing"})
EVENTS = frozenset({"impulsive-forcing"})
"""Effects of instants of their own: of them no block tells what another one shows."""
_MARGIN = 1.0  # nats above what the strongest of so many looks reaches by chance
_APART_S = 0.15
_IMPULSES = 3
_SLOWEST_CYCLES = 6.0
_FEWEST_BINS = 32
_NEIGHBOURS = 40
_MOUNT_HZ = (8.0, 80.0)
_MOUNT_APART = 0.01  # a quarter of the width of a peak with 2 % damping
_MOUNT_ABOVE = 1.5  # times the first mode: below, it would ring with the wing
_FASTEST = 2.3  # of the first mode, for swings of the stiffness


@dataclass(frozen=True, slots=True)
class Proposal:
    """Values at which an effect should begin, and the logarithm of how many places were looked at."""

    values: dict[str, float]
    log_trials: float


Proposals = Mapping[str, tuple[Proposal, ...]]
NO_PROPOSALS: Proposals = MappingProxyType({})


def find_proposals(models: Sequence[FlightModel], fitted: Fit) -> Proposals:
    """What the residuals of one recording lead to; several recordings share no phase, and give none."""
    if len({model.recording for model in models}) > 1:
        return NO_PROPOSALS
    model, expectation = models[0], fitted.expectations[0]
    tones, swings = (
        _proposed(strongest_line(model, expectation)),
        _proposed(strongest_parametric_excitation(model, expectation)),
    )
    kicks = _impulses(models, fitted)
    return {"tone": tones, "periodic-forcing": tones, "parametric-stiffness": swings, "impulsive-forcing": kicks}


def _proposed(line: Line | None) -> tuple[Proposal, ...]:
    if line is None or line.log_tail > -_MARGIN:
        return ()
    return (Proposal({"frequency_hz": line.frequency_hz}, line.log_trials),)


def mount_resonance_proposal(models: Sequence[FlightModel], fitted: Fit, term: EffectTerm) -> EffectTerm | None:
    """Where a camera's mount rings, if it follows its station as an oscillator; None where no place beats none.

    A little softness is a gain that grows; a resonance in the band is found only by going to where it is.
    """
    if term.effect.name != "mount-resonance":
        return None
    places_hz = np.exp(np.arange(math.log(_MOUNT_HZ[0]), math.log(_MOUNT_HZ[1]), _MOUNT_APART))
    first_hz = models[0].belief.airframe.wing.symmetric.frequency_hz.value
    softness = [(2.0 * math.pi * place) ** -2 for place in places_hz.tolist() if place > _MOUNT_ABOVE * first_hz]
    likelihoods = [
        log_likelihood(
            models,
            expect(
                models,
                np.append(fitted.values, value),
                (*fitted.terms, term.with_values({"softness_s2": value})),
                fitted.expectations,
            ),
        )
        for value in softness
    ]
    best, log_trials = int(np.argmax(likelihoods)), math.log(len(softness))
    if likelihoods[best] - log_trials < fitted.log_likelihood:
        return None
    return replace(term.with_values({"softness_s2": softness[best]}), log_trials=log_trials)


@dataclass(frozen=True, slots=True)
class Line:
    """A single frequency that stands out: where, the logarithm of its chance (paid for looking), and of the looks."""

    frequency_hz: float
    log_tail: float
    log_trials: float


def strongest_line(model: FlightModel, expectation: Expectation) -> Line:
    """The highest peak of the whitened periodogram."""
    white = apply(adjoint(expectation.motion.whitener), expectation.residual)
    power = np.sum(np.abs(white) ** 2, axis=0)
    best, log_trials = int(np.argmax(power)), math.log(power.size)
    # of c channels the power is Gamma(c, 1); neighbours that the taper ties together are counted all the same
    tail = -float(power[best]) + (math.log1p(float(power[best])) if len(white) > 1 else 0.0)
    # the whitened spectrum on finer frequencies about the peak: the taper's own shape interpolates
    in_time = np.fft.ifft(white, axis=1)
    fine = best + np.linspace(-1.0, 1.0, 41)
    turn = np.exp(-2j * np.pi * np.outer(fine, np.arange(power.size)) / power.size)
    peak = np.sum(np.abs(turn @ in_time.T) ** 2, axis=1)
    step = model.band_hz[1] - model.band_hz[0]
    return Line(float(model.band_hz[0] + step * fine[np.argmax(peak)]), tail + log_trials, log_trials)


def strongest_parametric_excitation(model: FlightModel, expectation: Expectation) -> Line | None:
    """The highest peak of the periodogram of residual force times spring force; None where there is no room for one."""
    product = np.sum(model.force_score(expectation) * model.spring_force(expectation), axis=0)
    power = np.abs(np.fft.rfft(product - product.mean())) ** 2
    step = 1.0 / model.observations.duration_s
    first_hz = model.belief.airframe.wing.symmetric.frequency_hz.value
    low, high = math.ceil(_SLOWEST_CYCLES), min(int(_FASTEST * first_hz / step), len(power) - 1)
    if high - low < _FEWEST_BINS:
        return None
    power = power[low:high]
    padded = np.pad(power, _NEIGHBOURS, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
    ratio = power / (np.median(around, axis=1) / math.log(2.0))  # the median of an exponential is ln 2 of its mean
    best, log_trials = int(np.argmax(ratio)), math.log(len(ratio))
    fine = (low + best + np.linspace(-0.8, 0.8, 33)) * step
    turn = np.exp(-2j * np.pi * np.outer(fine, model.observations.t_s))
    return Line(float(fine[np.argmax(np.abs(turn @ product))]), -float(ratio[best]) + log_trials, log_trials)


def _impulses(models: Sequence[FlightModel], fitted: Fit) -> tuple[Proposal, ...]:
    """The strongest instants of the residual force; three are taken, so three pay for the looking."""
    t_s, strength = [], []
    for model, expectation in zip(models, fitted.expectations, strict=True):
        force = model.force_score(expectation)[:2]
        inner = slice(len(model.observations.t_s) // 16, -len(model.observations.t_s) // 16)
        typical = np.median(np.abs(force[:, inner]), axis=1, keepdims=True) / 0.6745
        t_s.append(model.observations.t_s[inner])
        strength.append(np.sum((force / typical)[:, inner] ** 2, axis=0))
    at_s, power = np.concatenate(t_s), np.concatenate(strength)
    places = len(power) / 4.0
    if power.max() < 2.0 * (math.log(places) + 2.0 * _MARGIN):
        return ()
    chosen: list[float] = []
    for index in np.argsort(-power).tolist():
        if all(abs(at_s[index] - other) > _APART_S for other in chosen):
            chosen.append(float(at_s[index]))
        if len(chosen) == _IMPULSES:
            break
    log_trials = len(chosen) * math.log(places) - math.lgamma(len(chosen) + 1)
    return (Proposal({f"at{k + 1}_s": at for k, at in enumerate(chosen)}, log_trials),)
