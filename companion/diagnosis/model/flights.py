"""Likelihood of several flights together under one belief with terms: what :mod:`..selection.fisher_scoring` asks.

Derivatives are differences of :meth:`FlightModel.expect`; :mod:`.scores` makes scores and information of them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect
from companion.diagnosis.model.belief import Belief, Nuisance
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.scores import Column, column, scores
from companion.diagnosis.selection.fisher_scoring import Parameter, Scores
from companion.diagnosis.selection.fit import Fit, climb
from companion.records import Floats

_STEP = 1e-4  # of a parameter's prior sigma, for differences (numerical)
# the same of a frequency or an instant, whose prior is wide beside what a phase tells of it (numerical)
_STEP_OF_PHASE = 1e-6


@dataclass(frozen=True, slots=True)
class FlightState:
    """Expectations by recording, and columns by recording and parameter, at one parameter vector."""

    expectations: tuple[Expectation, ...]
    columns: tuple[tuple[Column, ...], ...]


class FlightsLikelihood:
    """Flights under the belief's nuisances and some terms, whose priors are made ``wider`` times as wide."""

    def __init__(self, models: Sequence[FlightModel], terms: Sequence[EffectTerm], wider: float = 1.0) -> None:
        self._models, self._terms = models, tuple(terms)
        self.parameters = _anywhere(models, terms, priors(models[0].belief, terms, wider))
        # a difference is no better for a wider prior
        declared = [dataclasses.replace(term, wider=1.0) for term in terms]
        self._sigmas: Floats = np.array([entry.sigma for entry in priors(models[0].belief, declared)])
        self._reached: list[tuple[Floats, FlightState, tuple[Expectation, ...]]] = []

    def start(self, nuisances: Floats | None = None) -> Floats:
        """Effects at the values of their terms, nuisances as given or as believed, (p,)."""
        count = len(self._models[0].belief.nuisances)
        values = np.concatenate([np.zeros(count), *[term.values for term in self._terms]])
        if nuisances is not None:
            count = min(len(nuisances), count)
            values[:count] = nuisances[:count]
        return values

    def log_likelihood(self, values: Floats, near: FlightState) -> float:
        """Log likelihood of values (p,), with the posterior covariance of the toe of ``near``."""
        return log_likelihood(self._models, self._expected(values, near))

    def scores(self, values: Floats) -> Scores[FlightState]:
        """Log likelihood, gradient (p,) and information (p, p) of all flights together at values (p,)."""
        expectations = expect(self._models, values, self._terms)
        columns = derivatives(self._models, values, self._terms, expectations, self._sigmas)
        return self._scored(expectations, tuple(tuple(entry) for entry in columns))

    def neighbour_scores(self, values: Floats, near: FlightState) -> Scores[FlightState]:
        """The same for values (p,), with derivatives and the posterior covariance of the toe of ``near``."""
        return self._scored(self._expected(values, near), near.columns)

    def scores_beside(self, values: Floats, fitted: FlightFit) -> Scores[FlightState]:
        """The same for values (p,), with the derivatives of a fit for the parameters that it has as well."""
        places = dict(zip([term.key for term in fitted.terms], fitted.blocks, strict=True))
        lent: list[int | None] = list(range(len(self._models[0].belief.nuisances)))
        for term in self._terms:
            lent += places.get(term.key) or [None] * len(term.values)
        expectations = expect(self._models, values, self._terms)
        fresh = [place for place, other in enumerate(lent) if other is None]
        columns = derivatives(self._models, values, self._terms, expectations, self._sigmas, fresh)
        joined = []
        for new, before in zip(columns, fitted.state.columns, strict=True):
            further = iter(new)
            joined.append(tuple(next(further) if other is None else before[other] for other in lent))
        return self._scored(expectations, tuple(joined))

    def _expected(self, values: Floats, near: FlightState) -> tuple[Expectation, ...]:
        """Expectations beside a state, the last two kept: a step is judged by its height, then scored where it ends."""
        for at, beside, expectations in self._reached:
            if beside is near and np.array_equal(at, values):
                return expectations
        expectations = expect(self._models, values, self._terms, near.expectations)
        self._reached = [*self._reached[-1:], (values, near, expectations)]
        return expectations

    def _scored(
        self, expectations: tuple[Expectation, ...], columns: tuple[tuple[Column, ...], ...]
    ) -> Scores[FlightState]:
        gradient, information = joint_scores(self._models, expectations, columns)
        state = FlightState(expectations, columns)
        return Scores(log_likelihood(self._models, expectations), gradient, information, state)


FlightFit = Fit[EffectTerm, FlightState]


def fit(
    models: Sequence[FlightModel],
    terms: Sequence[EffectTerm],
    start: Floats | FlightFit | None = None,
    rounds: int = 24,
    wider: float = 1.0,
    values_alone: bool = False,
) -> FlightFit:
    """Find the most probable parameters (p,) in at most ``rounds`` scoring steps.

    Effects begin at the values of ``terms``, nuisances at those of ``start`` or at the belief; a start that is a fit
    of these recordings lends its derivatives too. Prior sigmas of the effects' strengths are multiplied by ``wider``,
    so that values and intervals are those of the data. With ``values_alone`` evidence and covariance are rough.
    """
    likelihood = FlightsLikelihood(models, terms, wider)
    sizes = [len(term.values) for term in terms]
    ends = np.cumsum([len(models[0].belief.nuisances), *sizes]).tolist()
    blocks = [range(end - size, end) for size, end in zip(sizes, ends[1:], strict=True)]
    near = start if isinstance(start, Fit) else None
    begun_at = likelihood.start(start.values if isinstance(start, Fit) else start)
    begun = None if near is None else likelihood.scores_beside(begun_at, near)
    fitted = climb(likelihood, terms, blocks, begun_at, rounds, likelihood.neighbour_scores, values_alone, begun)
    # half a normal prior (an effect of one sign) is twice as dense there
    halves = sum(term.effect.one_way for term in terms)
    # a wide prior is one of two that a strength may have
    widened = sum(term.wider > 1.0 for term in terms)
    evidence = fitted.log_evidence + (halves - widened) * math.log(2.0)
    return dataclasses.replace(fitted, terms=placed(models[0].belief, fitted.values, terms), log_evidence=evidence)


def log_count(models: Sequence[FlightModel]) -> float:
    """Logarithm of how many numbers the accelerations are, which BIC charges for each parameter."""
    return math.log(sum(len(model.band_hz) * 2 * len(model.observations.sides) for model in models))


def log_likelihood(models: Sequence[FlightModel], expectations: Sequence[Expectation]) -> float:
    """Log likelihood of all recordings together."""
    return sum(model.log_likelihood(expectation) for model, expectation in zip(models, expectations, strict=True))


def joint_scores(
    models: Sequence[FlightModel], expectations: Sequence[Expectation], columns: Sequence[Sequence[Column]]
) -> tuple[Floats, Floats]:
    """Gradient (p,) and information (p, p) of all recordings together; ``columns`` by recording, p in each."""
    each = [scores(*entry) for entry in zip(models, expectations, columns, strict=True)]
    return np.sum([gradient for gradient, _ in each], axis=0), np.sum([matrix for _, matrix in each], axis=0)


def expect(
    models: Sequence[FlightModel],
    values: Floats,
    terms: Sequence[EffectTerm],
    near: Sequence[Expectation] | None = None,
) -> tuple[Expectation, ...]:
    """Expectations of the recordings at a parameter vector (p,); ``near`` lends the posterior covariance of the toe."""
    belief = models[0].belief
    placed_terms = placed(belief, values, terms)
    lent = near if near else [None] * len(models)
    deviations = values[: len(belief.nuisances)]
    return tuple(
        model.expect(deviations, placed_terms, neighbour) for model, neighbour in zip(models, lent, strict=True)
    )


def placed(belief: Belief, values: Floats, terms: Sequence[EffectTerm]) -> tuple[EffectTerm, ...]:
    """The effects with the values of a parameter vector (p,)."""
    at, done = len(belief.nuisances), []
    for term in terms:
        names = [entry.name for entry in term.effect.parameters()]
        done.append(term.with_values(dict(zip(names, values[at : at + len(names)].tolist(), strict=True))))
        at += len(names)
    return tuple(done)


def priors(belief: Belief, terms: Sequence[EffectTerm], wider: float = 1.0) -> tuple[Parameter, ...]:
    """Entries of the whole parameter vector: nuisances, then the parameters of each term.

    Prior sigmas of strengths are at least ``wider`` times the declared ones, those of parameters in ``scan`` (a yield,
    a frequency) as declared.
    """
    nuisances = [Parameter(entry.key, 0.0, entry.sigma) for entry in belief.nuisances]
    declared = [
        (entry, 1.0 if entry.name in type(term.effect).scan else max(wider, term.wider))
        for term in terms
        for entry in term.effect.parameters()
    ]
    return (*nuisances, *(Parameter(entry.name, entry.default, factor * entry.sigma) for entry, factor in declared))


def _anywhere(
    models: Sequence[FlightModel], terms: Sequence[EffectTerm], parameters: Sequence[Parameter]
) -> tuple[Parameter, ...]:
    """The parameters with instants anywhere in the recordings: the normal law of the same mean and variance."""
    begin_s = min(model.observations.start_s for model in models)
    length_s = max(model.observations.start_s + model.observations.duration_s for model in models) - begin_s
    instants = {name for term in terms for name in type(term.effect).instants}
    return tuple(
        Parameter(entry.key, begin_s + 0.5 * length_s, length_s / math.sqrt(12.0)) if entry.key in instants else entry
        for entry in parameters
    )


def derivatives(
    models: Sequence[FlightModel],
    values: Floats,
    terms: Sequence[EffectTerm],
    expectations: Sequence[Expectation],
    sigmas: Floats,
    only: Sequence[int] | None = None,
) -> list[list[Column]]:
    """Columns by recording for all parameters, values and sigmas (p,), or for those of ``only``."""
    belief = models[0].belief
    owners: list[Nuisance | tuple[Effect, int]] = [*belief.nuisances]
    owners += [
        (term.effect, which) for term in placed(belief, values, terms) for which in range(len(term.effect.parameters()))
    ]
    columns: list[list[Column]] = [[] for _ in models]
    for i in range(len(values)) if only is None else only:
        owner = owners[i]
        # the posterior covariance of the toe is taken as constant; the variance of its measurement is not
        noisy = owner.key.startswith("match") if isinstance(owner, Nuisance) else owner[0].adds_toe_variance
        for model, expectation, recording_columns in zip(models, expectations, columns, strict=True):
            if isinstance(owner, Nuisance) and not owner.concerns(model.recording):
                recording_columns.append(Column())
                continue
            other, step = _beside(model, expectation, values, i, _step(owner) * float(sigmas[i]), terms)
            if isinstance(owner, Nuisance):
                shift, warps = model.delay_shift(owner), False
            else:
                shift = model.time_shift(*owner)
                warps = shift is not None and type(owner[0]).response is Effect.response
            recording_columns.append(column(expectation, other, step, noisy, shift, warps, model.weight > 0.0))
    return columns


def _step(owner: Nuisance | tuple[Effect, int]) -> float:
    """Step of a difference quotient in units of the prior sigma."""
    if isinstance(owner, Nuisance) or owner[0].starts_at is None:
        return _STEP
    return _STEP_OF_PHASE if owner[0].parameters()[owner[1]].unit in ("Hz", "s") else _STEP


def _beside(
    model: FlightModel, expectation: Expectation, values: Floats, i: int, step_up: float, terms: Sequence[EffectTerm]
) -> tuple[Expectation, float]:
    """An expectation with one parameter a small step up, or down where a step up is not physical; and the step."""
    count = len(model.belief.nuisances)
    for step in (step_up, -step_up):
        perturbed = values.copy()
        perturbed[i] += step
        try:
            return model.expect(perturbed[:count], placed(model.belief, perturbed, terms), expectation, True), step
        except ValueError as error:
            edge = error
    raise edge
