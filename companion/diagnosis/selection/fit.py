"""Flights fitted with given effects: nuisances and effect parameters with their priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightsLikelihood, placed
from companion.diagnosis.model.scores import Column
from companion.diagnosis.selection.fisher_scoring import NormalPrior, maximise
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class FlightFit:
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
) -> FlightFit:
    """Find the most probable parameters in at most ``rounds`` scoring steps.

    Effects begin at the values of ``terms``, nuisances at those of ``start`` or at the belief. The priors of the
    effects are made ``wider`` times as wide: for values and intervals that are the data's own.
    """
    likelihood = FlightsLikelihood(models, terms, wider)
    best = maximise(likelihood, likelihood.start(start), rounds)
    prior = NormalPrior(likelihood.parameters)
    return FlightFit(
        placed(models[0].belief, best.values, terms),
        best.values,
        prior.centres,
        prior.sigmas,
        best.covariance,
        best.log_likelihood,
        best.log_evidence,
        best.state.expectations,
        best.state.columns,
        best.converged,
    )
