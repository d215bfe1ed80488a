"""Most probable parameters of any likelihood: Fisher scoring with priors, and Laplace's approximation of the evidence.

A model of recordings offers its parameters with their priors, its log likelihood, and its scores (gradient and Fisher
information). With prior N(c, diag(s^2)), and g and J those of the posterior, a step is (J + d diag(s^-2))^-1 g; d grows
until the posterior rises (Levenberg). At the maximum log evidence = log posterior - sum log s - log det J / 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from companion.records import Floats

_ENOUGH = 0.02  # nats gained by a step, below which it is the last (choice)
_NEGLIGIBLE = 0.1 * _ENOUGH  # nats predicted by a step, below which it is not made: 0.06 sigma at most (derived)
_AS_PREDICTED, _SLIGHT = 0.3, 2.0
"""Derivatives are used again if a step gains what they predict within this ratio, or if that is fewer nats (choice)."""
_NEARLY = 0.5  # nats still predicted where no step rises: with less the maximum is reached (choice)
_TRIES = 9  # of one step, each more damped than the last (choice)
_DAMPED_TRIES = 2  # then the step is shortened as well (choice)
# chosen: factors on a step: below the first it gains nothing, beyond the second the parabola is not trusted
_LEAST_LONGER, _LONGEST = 1.2, 3.0
# numerical: Levenberg's first damping, factors by which it grows and falls, and the value below which it is 0
_DAMPING, _HARDER, _SOFTER, _UNDAMPED = 0.5, 4.0, 4.0, 0.1
_FARTHEST = 3.0  # chosen: prior sigmas in one step: no step leaves what is believed possible
State = TypeVar("State")


@dataclass(frozen=True, slots=True)
class Parameter:
    """One entry of a parameter vector with its normal prior."""

    key: str
    centre: float
    sigma: float


@dataclass(frozen=True, slots=True)
class Scores(Generic[State]):
    """Log likelihood at a vector (p,), its gradient (p,), Fisher information (p, p), and the model's state there."""

    log_likelihood: float
    gradient: Floats
    information: Floats
    state: State


class LikelihoodModel(Protocol[State]):
    """Recordings under a model, as every fit asks them."""

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Entries of the vector, with their priors."""

    def scores(self, values: Floats) -> Scores[State]:
        """Log likelihood, gradient and information at a vector (p,)."""

    def log_likelihood(self, values: Floats, near: State) -> float:
        """Log likelihood at a vector (p,) near one whose scores are known; ``near`` may lend what is slow to compute.

        Raises
        ------
        ValueError, FloatingPointError, LinAlgError
            The values are not physical.
        """


@dataclass(frozen=True, slots=True)
class Maximum(Generic[State]):
    """Most probable values (p,) with posterior covariance (p, p); ``state`` is the model's there."""

    values: Floats
    covariance: Floats
    log_likelihood: float
    log_evidence: float
    converged: bool
    state: State


def maximise(
    model: LikelihoodModel[State],
    start: Floats,
    rounds: int,
    neighbour_scores: Callable[[Floats, State], Scores[State]] | None = None,
    values_alone: bool = False,
    begun: Scores[State] | None = None,
) -> Maximum[State]:
    """Climb from ``start`` (p,) to the most probable values in at most ``rounds`` scoring steps.

    ``neighbour_scores`` gives scores with the derivatives of a neighbouring vector, which cost little. They are used as
    long as the posterior rises as they predict. The maximum is judged with exact scores, unless only the values are
    wanted (``values_alone``). ``begun`` are inexact scores at the start.
    """
    prior, approximate = NormalPrior(model.parameters), neighbour_scores or (lambda at, _state: model.scores(at))
    values, scores, exact, converged, damping = start.copy(), begun or model.scores(start), begun is None, False, 0.0
    for _ in range(rounds):
        predicted = _predicted_gain(prior, values, scores)
        step = None if predicted < _NEGLIGIBLE else _climb(model, prior, values, scores, damping)
        if step is None:
            converged = predicted < (_NEARLY if exact else _NEGLIGIBLE)
            if exact or (values_alone and converged):
                break
            scores, exact = model.scores(values), True
            continue
        values, gained, damping = step
        converged = gained < _ENOUGH and (exact or values_alone)
        serves = values_alone if converged else damping == 0.0 and _derivatives_hold(predicted, gained)
        exact = not (neighbour_scores and serves)
        scores = model.scores(values) if exact else approximate(values, scores.state)
        if converged:
            break
    if not (exact or values_alone):
        scores = model.scores(values)
    information = prior.added(values, scores)[1]
    log_posterior = scores.log_likelihood + prior.log_density(values)
    log_determinant, covariance = prior.posterior(information)
    evidence = log_posterior - 0.5 * log_determinant
    return Maximum(values, covariance, scores.log_likelihood, evidence, converged, scores.state)


class NormalPrior:
    """Independent normal priors of a parameter vector."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self.centres: Floats = np.array([entry.centre for entry in parameters])
        self.sigmas: Floats = np.array([entry.sigma for entry in parameters])

    def log_density(self, values: Floats) -> float:
        """Log density of a vector (p,), up to a constant."""
        return -0.5 * float(np.sum(((values - self.centres) / self.sigmas) ** 2))

    def added(self, values: Floats, scores: Scores[State]) -> tuple[Floats, Floats]:
        """Gradient (p,) and information (p, p) of the posterior."""
        gradient = scores.gradient - (values - self.centres) / self.sigmas**2
        return gradient, scores.information + np.diag(1.0 / self.sigmas**2)

    def posterior(self, information: Floats) -> tuple[float, Floats]:
        """Log determinant of the posterior's information (p, p) in units of the prior's, and its covariance (p, p).

        No direction holds less than the prior: rounding may leave a sum of large terms indefinite.
        """
        values, vectors = np.linalg.eigh(information * np.outer(self.sigmas, self.sigmas))
        values, along = np.maximum(values, 1.0), self.sigmas[:, None] * vectors
        return float(np.sum(np.log(values))), np.asarray((along / values) @ along.T)


def _derivatives_hold(predicted: float, gained: float) -> bool:
    """Whether derivatives are much the same after a step that gained and predicted so many nats."""
    return gained >= _ENOUGH and (predicted < _SLIGHT or abs(gained - predicted) < _AS_PREDICTED * predicted)


def _predicted_gain(prior: NormalPrior, values: Floats, scores: Scores[State]) -> float:
    """Gain of a whole step if the posterior is normal, nat."""
    gradient, information = prior.added(values, scores)
    return 0.5 * float(gradient @ np.linalg.solve(information, gradient))


def _climb(
    model: LikelihoodModel[State], prior: NormalPrior, values: Floats, scores: Scores[State], damping: float
) -> tuple[Floats, float, float] | None:
    """One step up the posterior: new values (p,), gain in nat, and the damping there; None if no step rises.

    Damping in units of the priors holds back parameters that the data hardly determine (a coherence near one).
    """
    gradient, information = prior.added(values, scores)
    height = scores.log_likelihood + prior.log_density(values)
    for k in range(_TRIES):
        move = np.linalg.solve(information + damping * np.diag(1.0 / prior.sigmas**2), gradient)
        move *= 0.4 ** max(0, k - _DAMPED_TRIES)
        move *= min(1.0, _FARTHEST / max(float(np.max(np.abs(move) / np.maximum(prior.sigmas, 1e-12))), _FARTHEST))
        candidate: Floats = np.asarray(values + move, dtype=np.float64)
        reached = _height(model, prior, candidate, scores.state)
        if reached > height:
            if damping == 0.0:
                longer = _longer(float(gradient @ move), reached - height)
                further: Floats = np.asarray(values + longer * move, dtype=np.float64)
                beyond = _height(model, prior, further, scores.state) if longer > _LEAST_LONGER else -np.inf
                candidate, reached = (further, beyond) if beyond > reached else (candidate, reached)
            softer = damping / _SOFTER if k == 0 else damping
            return candidate, reached - height, softer if softer >= _UNDAMPED else 0.0
        damping = max(_HARDER * damping, _DAMPING)
    return None


def _longer(slope: float, gained: float) -> float:
    """Factor on a step that leads to the top of the parabola with this initial slope and this gain after the step.

    Fisher information may be twice the curvature of the posterior (a coherence, a level): steps then go half the way.
    """
    bend = 2.0 * (slope - gained)
    return slope / bend if bend > slope / _LONGEST else _LONGEST


def _height(model: LikelihoodModel[State], prior: NormalPrior, values: Floats, near: State) -> float:
    try:
        return model.log_likelihood(values, near) + prior.log_density(values)
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return -np.inf  # not physical
