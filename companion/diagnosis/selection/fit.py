"""A fitted model, whatever was recorded: values with their priors and covariance, and its evidence."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from companion.diagnosis.selection.fisher_scoring import LikelihoodModel, NormalPrior, Scores, State, maximise
from companion.records import Floats

TermT = TypeVar("TermT")


@dataclass(frozen=True, slots=True)
class Fit(Generic[TermT, State]):
    """A fitted model.

    Attributes
    ----------
    terms : tuple
        What was added to the believed model, at its fitted values where a term holds values.
    keys : tuple of str
        Names of the parameters.
    blocks : tuple of tuple of int
        Places of each term's parameters.
    values, centres, sigmas : (p,)
        Fitted, and their priors.
    covariance : (p, p)
        Posterior.
    log_likelihood, log_evidence : float
    converged : bool
    state
        What the model keeps at the fitted values.
    """

    terms: tuple[TermT, ...]
    keys: tuple[str, ...]
    blocks: tuple[tuple[int, ...], ...]
    values: Floats
    centres: Floats
    sigmas: Floats
    covariance: Floats
    log_likelihood: float
    log_evidence: float
    converged: bool
    state: State

    @property
    def spread(self) -> Floats:
        """Posterior standard deviations, (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def nuisances(self) -> list[int]:
        """Places of what belongs to no term."""
        of_terms = {place for block in self.blocks for place in block}
        return [place for place in range(len(self.values)) if place not in of_terms]

    def value(self, key: str) -> tuple[float, float]:
        """A parameter and its posterior sigma."""
        at = self.keys.index(key)
        return float(self.values[at]), float(self.spread[at])

    def neg_log_prior(self, places: Collection[int]) -> float:
        """Minus the log prior of some parameters, up to a constant."""
        index = list(places)
        return 0.5 * float(np.sum(((self.values[index] - self.centres[index]) / self.sigmas[index]) ** 2))


def climb(
    model: LikelihoodModel[State],
    terms: Sequence[TermT],
    blocks: Sequence[Sequence[int]],
    start: Floats,
    rounds: int,
    neighbour_scores: Callable[[Floats, State], Scores[State]] | None = None,
    values_alone: bool = False,
    begun: Scores[State] | None = None,
) -> Fit[TermT, State]:
    """The most probable values of a model from ``start`` (p,), in at most ``rounds`` steps of :func:`maximise`."""
    best = maximise(model, start, rounds, neighbour_scores, values_alone, begun)
    prior = NormalPrior(model.parameters)
    return Fit(
        tuple(terms),
        tuple(entry.key for entry in model.parameters),
        tuple(tuple(block) for block in blocks),
        best.values,
        prior.centres,
        prior.sigmas,
        best.covariance,
        best.log_likelihood,
        best.log_evidence,
        best.converged,
        best.state,
    )
