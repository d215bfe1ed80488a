"""Flights as the engine asks them: the catalogue's effects, screened by scores and refitted from where these point."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect
from companion.core.wing.effects import catalogue
from companion.core.wing.samples import SampleDefect
from companion.diagnosis.data.sample_defects import worst_defects
from companion.diagnosis.flights.adequacy import LIMIT, check
from companion.diagnosis.flights.initial_values import initial_values
from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.flights.proposals import best_trial, candidates_of, find_proposals, is_trial
from companion.diagnosis.flights.ringing import with_best_trials
from companion.diagnosis.flights.rival_models import strongest_rival_model
from companion.diagnosis.flights.screen import perturbed_start, screen
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, FlightState, expect, fit, log_count
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.diagnosis import diagnose as diagnose_recordings
from companion.diagnosis.selection.forward_selection import UNPHYSICAL, UNPREJUDICED
from companion.diagnosis.selection.recordings import Cause, Prediction, Progress, Recordings, SelectionPath
from companion.diagnosis.selection.score_tests import Candidate, Screening

_QUIET_DB = 3.0  # least range of a fitted spectrum over its minimum, below which the wing hardly moves (choice)
_FIRST_STEPS = (0.5, 0.05, 0.005)  # chosen: prior sigmas: a strength begins large, then small where large is far off
_STRAINED = 3.0  # prior sigmas from which on an effect may be of another size than expected (choice)
_STRONG = 2.0  # prior sigmas of the strength of an effect that is begun at every place (choice)
# scoring steps: of a refit, of one that goes on, of a fit, of a fold (choice)
_AT_FIRST, _QUICK, _LAST, _FOLD = 5, 10, 24, 3
_NEAR = 25.0  # nat behind the model that it extends, beyond which a first fit is not yet there (choice)
_GUARD_S = 0.5  # at either edge of a block: some periods of the first mode (choice)
_BLOCK_S = 6.0  # shortest that holds exposures between its guards (choice)
_MOST_BLOCKS = 6  # a bound on the cost
_WIDER = 5.0  # factor on prior sigmas in a fold, so that values are those of the data (choice)


def diagnose(
    models: Sequence[FlightModel],
    kinds: Sequence[type[Effect]],
    max_causes: int = 3,
    progress: Progress = lambda _what, _ratio: None,
) -> FlightDiagnosis:
    """Judge flights that share one belief by a catalogue, or a part of it; name at most ``max_causes`` effects."""
    return diagnose_recordings(Flights(models, kinds), max_causes, progress)


class Flights(Recordings[EffectTerm, FlightState]):
    """Flights that share one belief, and the effects of the catalogue that are offered."""

    measures_nearest = False  # half the time of a judgement

    def __init__(self, models: Sequence[FlightModel], kinds: Sequence[type[Effect]] = ()) -> None:
        self._models, self._kinds = models, kinds
        self._channels = sorted({name for model in models for name in model.observations.covariates})
        self._defects = worst_defects([entry for model in models for entry in model.observations.sample_defects])

    @property
    def log_count(self) -> float:
        """Logarithm of how many numbers the accelerations are."""
        return log_count(self._models)

    def null(self) -> FlightFit:
        """The believed airframe, fitted."""
        fits = (fit(self._models, (), start) for start in initial_values(self._models))
        return max(fits, key=lambda candidate: candidate.log_evidence)

    def fit(self, terms: Sequence[EffectTerm], near: FlightFit, wider: float = 1.0, quick: bool = False) -> FlightFit:
        """Nuisances begin as in another fit, effects at their own values."""
        return fit(self._models, terms, near, _QUICK if quick else _LAST, wider)

    def screen(self, fitted: FlightFit, progress: Progress) -> Screening[EffectTerm]:
        """Score the whole catalogue at a fitted model."""
        terms = candidates_of(self._kinds, self._channels, find_proposals(self._models, fitted))
        screening = screen(self._models, fitted, terms, lambda ratio: progress("screen the catalogue", ratio))
        return with_best_trials(self._models, fitted, screening)

    def refit(
        self, fitted: FlightFit, candidate: Candidate[EffectTerm]
    ) -> tuple[Candidate[EffectTerm], FlightFit] | None:
        """Refit with one effect more; from each mode of a multimodal one, if its best is worth anything."""
        trial = best_trial(self._models, fitted, candidate.term)
        offered = candidate if trial is None else dataclasses.replace(candidate, term=trial.term)
        first = (offered.term,) if is_trial(offered.term) else ()
        smaller = (perturbed_start(offered, step, _FIRST_STEPS[0]) for step in _FIRST_STEPS)
        reached = self._begun(fitted, itertools.chain(first, smaller))
        if reached is None:
            return None
        if reached.log_evidence < fitted.log_evidence - _NEAR:
            # the model that it extends is a case of it: nuisances that stood for the effect are still on their way back
            reached = fit(self._models, reached.terms, reached, _QUICK)
        if type(offered.term.effect).multimodal and reached.log_evidence > fitted.log_evidence:
            elsewhere = (self._begun(fitted, [term]) for term in _strong_at_each_place(reached.terms[-1]))
            reached = max([reached, *filter(None, elsewhere)], key=lambda entry: entry.log_evidence)
        return offered, self._unstrained(fitted, reached, candidate.is_far)

    def _unstrained(self, fitted: FlightFit, reached: FlightFit, is_far: bool) -> FlightFit:
        """The last effect under a wide prior, where its score or its place asks for it and that has more evidence."""
        block = list(reached.blocks[-1])
        beyond = np.abs(reached.values[block] - reached.centres[block]) / reached.sigmas[block]
        if not is_far and np.max(beyond) < _STRAINED:
            return reached
        wide = self._begun(fitted, [dataclasses.replace(reached.terms[-1], wider=UNPREJUDICED)])
        return wide if wide is not None and wide.log_evidence > reached.log_evidence else reached

    def _begun(self, fitted: FlightFit, starts: Iterable[EffectTerm]) -> FlightFit | None:
        """A few steps with an effect, from the first of some starts that is physical."""
        for term in starts:
            try:
                return fit(self._models, (*fitted.terms, term), fitted, _AT_FIRST)
            except UNPHYSICAL:
                continue
        return None

    def plausible(self, fitted: FlightFit) -> bool:
        """Whether what nature has one way only came out that way, and a further mode away from those that are there."""
        model = self._models[0]
        *others, effect = (term.effect for term in (*model.belief.terms, *fitted.terms))
        if effect.one_way and fitted.values[fitted.blocks[-1][0]] <= 0.0:
            return False
        return effect.is_distinct(model.structure(fitted.values[: len(model.belief.nuisances)], others))

    def checks(self, fitted: FlightFit) -> list[Check]:
        """Defects of the samples that have no name among the offered, and all tests of a fitted model."""
        offered = {kind.name for kind in self._kinds}
        faults = [
            Check(entry.evidence, _strength(entry), LIMIT) for entry in self._defects if entry.name not in offered
        ]
        return [*faults, *check(self._models, fitted)]

    def folds(self) -> list[Callable[[FlightFit], list[Prediction]]]:
        """Every other block, and the blocks between.

        Of a short recording there are fewer blocks: each must hold exposures between its guards.
        """
        halves = [[_half(model, parity) for model in self._models] for parity in range(2)]
        return [_fold(halves[parity], halves[1 - parity]) for parity in range(2)]

    def not_identifiable(self, null: FlightFit) -> str:
        """Reason where the accelerations stand above the sensors' noise nowhere in the band."""
        for expectation in null.state.expectations:
            power = np.einsum("iif->if", expectation.spectrum).real
            if np.any(10.0 * np.log10(power.max(1) / power.min(1)) > _QUIET_DB):
                return ""
        return "the wing hardly moves above its sensors' noise: record in gusts, or excite it"

    def sample_causes(self) -> list[Cause[EffectTerm]]:
        """Causes that the samples themselves show."""
        offered = {kind.name for kind in self._kinds}
        return [_sample_cause(entry) for entry in self._defects if entry.name in offered]

    def objection(self, null: FlightFit, before: Sequence[Check], path: SelectionPath[EffectTerm, FlightState]) -> str:
        """A law without a name that explains more than the names, in words."""
        rival = strongest_rival_model(self._models, null, before, path.fitted)
        if rival is None or not rival.explains_more:
            return ""
        return f"a law without a name explains it better: {rival.title} (by {rival.ahead:.1f} nat)"

    def foretells(self, term: EffectTerm) -> bool:
        """False of impulses, of which no block foretells another's."""
        return not term.effect.transient


def _strong_at_each_place(term: EffectTerm) -> list[EffectTerm]:
    """A strong effect at each place of its scan."""
    declared, scan = term.effect.parameters(), type(term.effect).scan
    values = {entry.name: float(getattr(term.effect, entry.name)) for entry in declared}
    values[declared[0].name] = _STRONG * declared[0].sigma
    return [
        term.with_values(values | dict(zip(scan, place, strict=True))) for place in itertools.product(*scan.values())
    ]


@dataclass(frozen=True, slots=True)
class _Half:
    """Every other block of a recording.

    The motion at an exposure follows from the accelerations about it and is not held out, because a block of 9 s leaves
    the motion unknown at its ends. ``exposures`` are those of each block, under the motion of the whole recording.
    """

    accelerations: tuple[FlightModel, ...]
    exposures: tuple[FlightModel | None, ...]
    together: tuple[FlightModel, ...]


def _fold(train: Sequence[_Half], test: Sequence[_Half]) -> Callable[[FlightFit], list[Prediction]]:
    models = [model for half in train for model in (*half.accelerations, *half.together)]

    def predict(fitted: FlightFit) -> list[Prediction]:
        again = fit(models, fitted.terms, fitted.values, _FOLD, _WIDER, values_alone=True)
        return [
            _judge(block, exposures, again)
            for half in test
            for block, exposures in zip(half.accelerations, half.exposures, strict=True)
        ]

    return predict


def _judge(block: FlightModel, exposures: FlightModel | None, fitted: FlightFit) -> Prediction:
    (expectation,) = expect([block], fitted.values, fitted.terms)
    scores = block.log_scores(expectation)
    if exposures is None:
        return Prediction(scores)
    (expectation,) = expect([exposures], fitted.values, fitted.terms)
    residual = expectation.toe_residual_rad
    return Prediction(scores | exposures.log_scores(expectation), float(np.sum(residual**2)), 0.0, len(residual))


def _half(model: FlightModel, parity: int) -> _Half:
    observations = model.observations
    count = min(_MOST_BLOCKS, max(2, 2 * int(observations.duration_s / (2.0 * _BLOCK_S))))
    length = observations.duration_s / count
    windows = [(k * length + _GUARD_S, (k + 1) * length - _GUARD_S) for k in range(parity, count, 2)]
    still = dataclasses.replace(observations, toe=None)
    accelerations = tuple(
        FlightModel(model.belief, still.window(*window), model.top_hz, model.recording) for window in windows
    )
    together = _with_exposures(model, windows)
    return _Half(
        accelerations,
        tuple(_with_exposures(model, [window]) for window in windows),
        () if together is None else (together,),
    )


def _with_exposures(model: FlightModel, windows: Sequence[tuple[float, float]]) -> FlightModel | None:
    """A recording of which only the exposures in some windows are judged; None where there are hardly any."""
    observations = model.observations
    if observations.toe is None:
        return None
    since_s = observations.toe.t_s - observations.start_s
    inside = np.any([(since_s > start_s) & (since_s < stop_s) for start_s, stop_s in windows], axis=0)
    toe = observations.toe.taken(np.asarray(inside))
    if toe is None:
        return None
    exposed = dataclasses.replace(observations, toe=toe)
    return FlightModel(model.belief, exposed, model.top_hz, model.recording, toe_alone=True)


def _sample_cause(defect: SampleDefect) -> Cause[EffectTerm]:
    kind = catalogue()[defect.name]
    names = [entry.name for entry in kind.parameters()]
    return Cause(
        EffectTerm(kind.from_values(defect.values)),
        (),
        defect.log_bayes_factor,
        -2.0 * defect.log_bayes_factor,
        _strength(defect),
        tuple(defect.values[name] for name in names),
        tuple(defect.sigmas[name] for name in names),
        defect.evidence,
    )


def _strength(defect: SampleDefect) -> float:
    return math.sqrt(2.0 * defect.log_bayes_factor)
