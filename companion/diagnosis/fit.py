"""Fits the super-model with given effects: Fisher scoring on nuisances and effect parameters, with their priors.

Scores and information are those of a complex Gaussian with mean and covariance that both depend on the parameters
(accelerations), and of a real one (toe, rest); derivatives are differences of :meth:`SuperModel.expect`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from companion.core.wing.effect import Effect
from companion.diagnosis.belief import Belief
from companion.diagnosis.supermodel import Expectation, Part, SuperModel, with_values
from companion.records import Floats

Complexes = npt.NDArray[np.complex128]
_STEP = 1e-4
_ENOUGH = 0.02
_HALVINGS = 7


@dataclass(frozen=True, slots=True)
class Column:
    """Derivative of an expectation with respect to one parameter, whitened where it is dear to do twice."""

    relative: Complexes  # (b, c, c): inverse times spectrum's derivative
    residual: Complexes  # (b, c)
    toe: Floats  # (k,)
    toe_variance: Floats | None
    rest: Floats  # (c,)
    shift_s: Floats | None = None  # (c, m) how the parameter shifts time, for warps


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted model.

    Attributes
    ----------
    parts : tuple of Part
        The effects at their fitted values.
    values : (p,)
        Nuisance deviations, then effect parameters in order.
    centres, sigmas : (p,)
        Their priors.
    covariance : (p, p)
        Posterior covariance.
    log_likelihood, log_evidence : float
    found : tuple of Expectation
        At the fitted values, by recording.
    converged : bool
    """

    parts: tuple[Part, ...]
    values: Floats
    centres: Floats
    sigmas: Floats
    covariance: Floats
    log_likelihood: float
    log_evidence: float
    found: tuple[Expectation, ...]
    converged: bool


def fit(models: Sequence[SuperModel], parts: Sequence[Part], start: Floats | None = None, rounds: int = 12) -> Fit:
    """Find the most probable parameters in at most ``rounds`` scoring steps.

    Effects begin at the values of ``parts``, nuisances at those of ``start`` or at the belief.
    """
    belief = models[0].belief
    centres, sigmas = priors(belief, parts)
    values = np.concatenate([np.zeros(len(belief.nuisances)), *[_values(part) for part in parts]])
    if start is not None:
        count = min(len(start), len(belief.nuisances))
        values[:count] = start[:count]
    found = expect(models, values, parts)
    score, converged = log_posterior(models, found, values, centres, sigmas), False
    for _ in range(rounds):
        gradient, information = _posterior_scores(models, values, parts, found, centres, sigmas)
        move: Floats = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
        better = _climb(models, parts, found, values, move, score, centres, sigmas)
        if better is None:
            converged = float(gradient @ move) < 1.0
            break
        gained = better[2] - score
        values = better[0]
        found = expect(models, values, parts)
        score = log_posterior(models, found, values, centres, sigmas)
        if gained < _ENOUGH:
            converged = True
            break
    information = _posterior_scores(models, values, parts, found, centres, sigmas)[1]
    _, log_det = np.linalg.slogdet(information)
    return Fit(
        placed(belief, values, parts),
        values,
        centres,
        sigmas,
        np.asarray(np.linalg.inv(information), dtype=np.float64),
        log_likelihood(models, found),
        score - float(np.sum(np.log(sigmas))) - 0.5 * float(log_det),
        found,
        converged,
    )


def _posterior_scores(
    models: Sequence[SuperModel],
    values: Floats,
    parts: Sequence[Part],
    found: Sequence[Expectation],
    centres: Floats,
    sigmas: Floats,
) -> tuple[Floats, Floats]:
    columns = derivatives(models, values, parts, found, sigmas)
    gradient, information = joint_scores(models, found, columns)
    gradient -= (values - centres) / sigmas**2
    information[np.diag_indices(len(values))] += 1.0 / sigmas**2
    return gradient, information


def log_likelihood(models: Sequence[SuperModel], found: Sequence[Expectation]) -> float:
    """Log likelihood of all recordings together."""
    return sum(model.log_likelihood(one) for model, one in zip(models, found, strict=True))


def joint_scores(
    models: Sequence[SuperModel], found: Sequence[Expectation], columns: Sequence[Sequence[Column]]
) -> tuple[Floats, Floats]:
    """Gradient and information of all recordings together; ``columns`` by recording."""
    each = [scores(*entry) for entry in zip(models, found, columns, strict=True)]
    return np.sum([gradient for gradient, _ in each], axis=0), np.sum([matrix for _, matrix in each], axis=0)


def expect(
    models: Sequence[SuperModel], values: Floats, parts: Sequence[Part], near: Sequence[Expectation] | None = None
) -> tuple[Expectation, ...]:
    """Hold a whole parameter vector against the recordings; ``near`` lends how well the toe is told."""
    belief = models[0].belief
    there = placed(belief, values, parts)
    lent = [one.toe_posterior for one in near] if near else [None] * len(models)
    deviations = values[: len(belief.nuisances)]
    return tuple(model.expect(deviations, there, own) for model, own in zip(models, lent, strict=True))


def placed(belief: Belief, values: Floats, parts: Sequence[Part]) -> tuple[Part, ...]:
    """The effects with the values of a parameter vector."""
    at, done = len(belief.nuisances), []
    for part in parts:
        names = [entry.name for entry in part.effect.parameters()]
        done.append(with_values(part, dict(zip(names, values[at : at + len(names)].tolist(), strict=True))))
        at += len(names)
    return tuple(done)


def priors(belief: Belief, parts: Sequence[Part]) -> tuple[Floats, Floats]:
    """Centres and sigmas of the whole parameter vector."""
    declared = [entry for part in parts for entry in part.effect.parameters()]
    centres = np.concatenate([np.zeros(len(belief.nuisances)), [entry.default for entry in declared]])
    return centres, np.concatenate([belief.sigmas, [entry.sigma for entry in declared]])


def log_posterior(
    models: Sequence[SuperModel], found: Sequence[Expectation], values: Floats, centres: Floats, sigmas: Floats
) -> float:
    """Log likelihood and prior, up to a constant."""
    return log_likelihood(models, found) - 0.5 * float(np.sum(((values - centres) / sigmas) ** 2))


def derivatives(
    models: Sequence[SuperModel],
    values: Floats,
    parts: Sequence[Part],
    found: Sequence[Expectation],
    sigmas: Floats,
    only: Sequence[int] | None = None,
) -> list[list[Column]]:
    """Columns by recording for all parameters, or for those of ``only``."""
    belief = models[0].belief
    keys = [entry.key for entry in belief.nuisances]
    owners: list[Effect | None] = [None] * len(keys)
    owners += [part.effect for part in parts for _ in part.effect.parameters()]
    columns: list[list[Column]] = [[] for _ in models]
    for i in range(len(values)) if only is None else only:
        owner = owners[i]
        # how well the accelerations tell the toe is taken as it is; what adds to its noise is not
        alone = (i < len(keys) and keys[i] == "match") or (owner is not None and owner.name == "exposure-jitter")
        there = values.copy()
        there[i] += _STEP * sigmas[i]
        moved = placed(belief, there, parts)
        for model, one, mine in zip(models, found, columns, strict=True):
            other = model.expect(there[: len(keys)], moved, one.toe_posterior)
            mine.append(_column(model, one, other, _STEP * float(sigmas[i]), alone, owner))
    return columns


def scores(model: SuperModel, found: Expectation, columns: Sequence[Column]) -> tuple[Floats, Floats]:
    """Gradient of the log likelihood and its Fisher information, (p,) and (p, p)."""
    p, weight = len(columns), model.weight
    relative = np.stack([column.relative.reshape(-1) for column in columns])
    turned = np.stack([column.relative.swapaxes(-1, -2).reshape(-1) for column in columns])
    information = weight * (relative @ turned.T).real
    white = np.einsum("fij,fj->fi", found.inverse, found.residual)
    moved = np.stack([column.residual for column in columns])
    weighed = np.einsum("fij,pfj->pfi", found.inverse, moved)
    information += 2.0 * weight * (moved.reshape(p, -1).conj() @ weighed.reshape(p, -1).T).real
    trace = np.einsum("pfii->p", np.stack([column.relative for column in columns])).real
    outer = np.einsum("fi,pfij,fj->p", found.residual.conj(), np.stack([c.relative for c in columns]), white).real
    gradient = weight * (outer - trace - 2.0 * np.einsum("pfi,fi->p", moved.conj(), white).real)
    _add_warps(model, columns, information)
    _add_toe(found, columns, gradient, information)
    rest = np.stack([column.rest for column in columns])
    gradient -= rest @ (found.rest_residual / found.rest_variance)
    information += (rest / found.rest_variance) @ rest.T
    return gradient, information


def _add_warps(model: SuperModel, columns: Sequence[Column], information: Floats) -> None:
    """A shift in time can only be seen where both sides agree: take out what the naive product counts too much."""
    warped = [i for i, column in enumerate(columns) if column.shift_s is not None]
    power = 2.0 * model.weight * float(np.sum((2.0 * np.pi * model.band_hz) ** 2))
    for i in warped:
        for j in warped:
            first, second = columns[i].shift_s, columns[j].shift_s
            assert first is not None
            assert second is not None
            information[i, j] -= power * float(np.sum(np.mean(first * second, axis=1)))


def _add_toe(found: Expectation, columns: Sequence[Column], gradient: Floats, information: Floats) -> None:
    if not len(found.toe_residual_rad):
        return
    factor = cho_factor(found.toe_covariance, lower=True)
    toe = np.stack([column.toe for column in columns], 1)
    weighed = cho_solve(factor, toe)
    gradient -= weighed.T @ found.toe_residual_rad
    information += toe.T @ weighed
    random = [(i, np.diag(column.toe_variance)) for i, column in enumerate(columns) if column.toe_variance is not None]
    if not random:
        return
    white = cho_solve(factor, found.toe_residual_rad)
    ratios = [(i, cho_solve(factor, changed)) for i, changed in random]
    for (i, changed), (_, ratio) in zip(random, ratios, strict=True):
        gradient[i] += 0.5 * float(white @ changed @ white - np.trace(ratio))
        for j, other in ratios:
            information[i, j] += 0.5 * float(np.sum(ratio * other.T))


def _column(
    model: SuperModel,
    found: Expectation,
    there: Expectation,
    step: float,
    alone: bool,
    owner: Effect | None,
) -> Column:
    return Column(
        np.asarray(found.inverse @ (there.spectrum - found.spectrum)) / step,
        (there.residual - found.residual) / step,
        (there.toe_residual_rad - found.toe_residual_rad) / step,
        (there.toe_variance - found.toe_variance) / step if alone else None,
        (there.rest_residual - found.rest_residual) / step,
        model.time_shift(owner) if owner is not None else None,
    )


def _climb(
    models: Sequence[SuperModel],
    parts: Sequence[Part],
    near: Sequence[Expectation],
    values: Floats,
    move: Floats,
    score: float,
    centres: Floats,
    sigmas: Floats,
) -> tuple[Floats, tuple[Expectation, ...], float] | None:
    """Go along ``move`` as far as the posterior grows; None if it does not."""
    share = min(1.0, 3.0 / max(float(np.max(np.abs(move) / np.maximum(sigmas, 1e-12))), 3.0))
    for _ in range(_HALVINGS):
        there = values + share * move
        try:
            found = expect(models, there, parts, near)
            gained = log_posterior(models, found, there, centres, sigmas)
        except (ValueError, FloatingPointError, np.linalg.LinAlgError):
            gained = -np.inf  # beyond what is physical
        if gained > score:
            return there, found, gained
        share *= 0.4
    return None


def _values(part: Part) -> list[float]:
    return [float(getattr(part.effect, entry.name)) for entry in part.effect.parameters()]
