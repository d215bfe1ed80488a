"""Fits the super-model with given effects: Fisher scoring on nuisances and effect parameters, with their priors.

Derivatives are differences of :meth:`FlightModel.expect`; :mod:`.scores` makes scores and information of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect
from companion.diagnosis.model.belief import Belief
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.scores import Column, column, scores
from companion.records import Floats

_STEP = 1e-4
_ENOUGH = 0.02
_TRIES = 9
_DAMPED_TRIES = 2  # then the step is shortened as well
_DAMPING, _HARDER, _SOFTER, _UNDAMPED = 0.5, 4.0, 4.0, 0.1
_FARTHEST = 3.0  # prior sigmas in one step


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted model.

    Attributes
    ----------
    terms : tuple of EffectTerm
        The effects at their fitted values.
    values : (p,)
        Nuisance deviations, then effect parameters in order.
    centres, sigmas : (p,)
        Their priors.
    covariance : (p, p)
        Posterior covariance.
    log_likelihood, log_evidence : float
    expectations : tuple of Expectation
        At the fitted values, by recording.
    columns : tuple of tuple of Column
        Derivatives there, by recording and parameter.
    converged : bool
    """

    terms: tuple[EffectTerm, ...]
    values: Floats
    centres: Floats
    sigmas: Floats
    covariance: Floats
    log_likelihood: float
    log_evidence: float
    expectations: tuple[Expectation, ...]
    columns: tuple[tuple[Column, ...], ...]
    converged: bool

    def neg_log_prior(self, count: int) -> float:
        """Minus the log prior of the first ``count`` parameters, which are the airframe's, up to a constant."""
        away = (self.values[:count] - self.centres[:count]) / self.sigmas[:count]
        return 0.5 * float(np.sum(away**2))


def fit(
    models: Sequence[FlightModel],
    terms: Sequence[EffectTerm],
    start: Floats | None = None,
    rounds: int = 24,
    wider: float = 1.0,
) -> Fit:
    """Find the most probable parameters in at most ``rounds`` scoring steps.

    Effects begin at the values of ``terms``, nuisances at those of ``start`` or at the belief. The priors of the
    effects are made ``wider`` times as wide: for values and intervals that are the data's own.
    """
    belief = models[0].belief
    centres, sigmas = priors(belief, terms)
    sigmas[len(belief.nuisances) :] *= wider
    values = np.concatenate([np.zeros(len(belief.nuisances)), *[term.values for term in terms]])
    if start is not None:
        count = min(len(start), len(belief.nuisances))
        values[:count] = start[:count]
    expectations = expect(models, values, terms)
    score, converged, damping = log_posterior(models, expectations, values, centres, sigmas), False, 0.0
    columns = derivatives(models, values, terms, expectations, sigmas)
    for _ in range(rounds):
        gradient, information = _posterior_scores(models, values, expectations, columns, centres, sigmas)
        better = _climb(models, terms, expectations, values, (gradient, information), score, centres, sigmas, damping)
        if better is None:
            converged = float(gradient @ np.linalg.solve(information, gradient)) < 1.0
            break
        gained = better[1] - score
        values, damping = better[0], better[2]
        expectations = expect(models, values, terms)
        score = log_posterior(models, expectations, values, centres, sigmas)
        columns = derivatives(models, values, terms, expectations, sigmas)
        if gained < _ENOUGH:
            converged = True
            break
    information = _posterior_scores(models, values, expectations, columns, centres, sigmas)[1]
    _, log_det = np.linalg.slogdet(information)
    return Fit(
        placed(belief, values, terms),
        values,
        centres,
        sigmas,
        np.asarray(np.linalg.inv(information), dtype=np.float64),
        log_likelihood(models, expectations),
        score - float(np.sum(np.log(sigmas))) - 0.5 * float(log_det),
        expectations,
        tuple(tuple(entry) for entry in columns),
        converged,
    )


def _posterior_scores(
    models: Sequence[FlightModel],
    values: Floats,
    expectations: Sequence[Expectation],
    columns: Sequence[Sequence[Column]],
    centres: Floats,
    sigmas: Floats,
) -> tuple[Floats, Floats]:
    gradient, information = joint_scores(models, expectations, columns)
    gradient -= (values - centres) / sigmas**2
    information[np.diag_indices(len(values))] += 1.0 / sigmas**2
    return gradient, information


def log_likelihood(models: Sequence[FlightModel], expectations: Sequence[Expectation]) -> float:
    """Log likelihood of all recordings together."""
    return sum(model.log_likelihood(expectation) for model, expectation in zip(models, expectations, strict=True))


def joint_scores(
    models: Sequence[FlightModel], expectations: Sequence[Expectation], columns: Sequence[Sequence[Column]]
) -> tuple[Floats, Floats]:
    """Gradient and information of all recordings together; ``columns`` by recording."""
    each = [scores(*entry) for entry in zip(models, expectations, columns, strict=True)]
    return np.sum([gradient for gradient, _ in each], axis=0), np.sum([matrix for _, matrix in each], axis=0)


def expect(
    models: Sequence[FlightModel],
    values: Floats,
    terms: Sequence[EffectTerm],
    near: Sequence[Expectation] | None = None,
) -> tuple[Expectation, ...]:
    """Hold a whole parameter vector against the recordings; ``near`` lends how well the toe is told."""
    belief = models[0].belief
    placed_terms = placed(belief, values, terms)
    lent = near if near else [None] * len(models)
    deviations = values[: len(belief.nuisances)]
    return tuple(
        model.expect(deviations, placed_terms, neighbour) for model, neighbour in zip(models, lent, strict=True)
    )


def placed(belief: Belief, values: Floats, terms: Sequence[EffectTerm]) -> tuple[EffectTerm, ...]:
    """The effects with the values of a parameter vector."""
    at, done = len(belief.nuisances), []
    for term in terms:
        names = [entry.name for entry in term.effect.parameters()]
        done.append(term.with_values(dict(zip(names, values[at : at + len(names)].tolist(), strict=True))))
        at += len(names)
    return tuple(done)


def priors(belief: Belief, terms: Sequence[EffectTerm]) -> tuple[Floats, Floats]:
    """Centres and sigmas of the whole parameter vector."""
    declared = [entry for term in terms for entry in term.effect.parameters()]
    centres = np.concatenate([np.zeros(len(belief.nuisances)), [entry.default for entry in declared]])
    return centres, np.concatenate([belief.sigmas, [entry.sigma for entry in declared]])


def log_posterior(
    models: Sequence[FlightModel], expectations: Sequence[Expectation], values: Floats, centres: Floats, sigmas: Floats
) -> float:
    """Log likelihood and prior, up to a constant."""
    return log_likelihood(models, expectations) - 0.5 * float(np.sum(((values - centres) / sigmas) ** 2))


def derivatives(
    models: Sequence[FlightModel],
    values: Floats,
    terms: Sequence[EffectTerm],
    expectations: Sequence[Expectation],
    sigmas: Floats,
    only: Sequence[int] | None = None,
) -> list[list[Column]]:
    """Columns by recording for all parameters, or for those of ``only``."""
    belief = models[0].belief
    keys = [entry.key for entry in belief.nuisances]
    owners: list[Effect | None] = [None] * len(keys)
    owners += [term.effect for term in terms for _ in term.effect.parameters()]
    columns: list[list[Column]] = [[] for _ in models]
    for i in range(len(values)) if only is None else only:
        owner = owners[i]
        # how well the accelerations tell the toe is taken as it is; what adds to its noise is not
        alone = keys[i].startswith("match") if owner is None else owner.only_toe_variance
        for model, expectation, recording_columns in zip(models, expectations, columns, strict=True):
            if i < len(keys) and not belief.concerns(i, model.recording):
                recording_columns.append(Column())
                continue
            other, step = _beside(model, expectation, values, i, float(sigmas[i]), terms)
            shift = model.time_shift(owner) if owner is not None else model.delay_shift(keys[i])
            warps = owner is not None and shift is not None and type(owner).response is Effect.response
            recording_columns.append(column(expectation, other, step, alone, shift, warps))
    return columns


def _beside(
    model: FlightModel, expectation: Expectation, values: Floats, i: int, sigma: float, terms: Sequence[EffectTerm]
) -> tuple[Expectation, float]:
    """An expectation with one parameter a little further on, or back where further on nothing is physical."""
    count = len(model.belief.nuisances)
    for step in (_STEP * sigma, -_STEP * sigma):
        perturbed = values.copy()
        perturbed[i] += step
        try:
            return model.expect(perturbed[:count], placed(model.belief, perturbed, terms), expectation), step
        except ValueError as error:
            edge = error
    raise edge


def _climb(
    models: Sequence[FlightModel],
    terms: Sequence[EffectTerm],
    near: Sequence[Expectation],
    values: Floats,
    slope: tuple[Floats, Floats],
    score: float,
    centres: Floats,
    sigmas: Floats,
    damping: float,
) -> tuple[Floats, float, float] | None:
    """One step up the posterior by its ``slope`` (gradient, information): where to, how high, and the damping there.

    Levenberg's: what the data hardly tell (a coherence near one) is held back by its prior, and the rest moves on.
    None if nothing grows.
    """
    gradient, information = slope
    for k in range(_TRIES):
        move = np.linalg.solve(information + damping * np.diag(1.0 / sigmas**2), gradient)
        move *= 0.4 ** max(0, k - _DAMPED_TRIES)
        move *= min(1.0, _FARTHEST / max(float(np.max(np.abs(move) / np.maximum(sigmas, 1e-12))), _FARTHEST))
        candidate: Floats = np.asarray(values + move, dtype=np.float64)
        try:
            reached = log_posterior(models, expect(models, candidate, terms, near), candidate, centres, sigmas)
        except (ValueError, FloatingPointError, np.linalg.LinAlgError):
            reached = -np.inf  # beyond what is physical
        if reached > score:
            softer = damping / _SOFTER if k == 0 else damping
            return candidate, reached, softer if softer >= _UNDAMPED else 0.0
        damping = max(_HARDER * damping, _DAMPING)
    return None
