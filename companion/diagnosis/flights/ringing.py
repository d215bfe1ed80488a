"""Screening of effects that ring: by the likelihood of their best trial value, where their score at 0 misleads.

To first order a soft mount is a gain that grows with frequency. A mount that rings sharply is not: beyond its resonance
it moves against the wing. It is sought only where residuals of neighbouring exposures are correlated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from companion.diagnosis.flights.proposals import best_trial
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit
from companion.diagnosis.selection.normal_scores import normal_score
from companion.diagnosis.selection.score_tests import Candidate, Screening

_TOGETHER = 3.5  # chosen: sigmas of a correlation of neighbours: one in 700 by chance, with three lags
_LAGS = 3  # chosen: exposures apart: a ringing that lasts shows in the first ones
_FEWEST = 20  # chosen: exposures: of fewer a correlation has no known law


def with_best_trials(
    models: Sequence[FlightModel], fitted: FlightFit, screening: Screening[EffectTerm]
) -> Screening[EffectTerm]:
    """The screening with effects that ring at their best trial value, where that says more than their score."""
    rings = any(map(neighbours_go_together, fitted.state.expectations))
    tried = [_tried(models, fitted, candidate) if rings else candidate for candidate in screening.candidates]
    order = sorted(range(len(tried)), key=lambda i: -tried[i].z)
    at = np.ix_(order, order)
    return Screening(tuple(tried[i] for i in order), screening.correlation[at], screening.imitation[at])


def neighbours_go_together(expectation: Expectation) -> bool:
    """Whether whitened residuals of the toe are correlated over some exposures beyond chance."""
    count = len(expectation.toe_residual_rad)
    if count < _FEWEST:
        return False
    root = np.linalg.cholesky(expectation.toe_errors.covariance)
    white = solve_triangular(root, expectation.toe_residual_rad, lower=True)
    power = float(np.mean(white**2))
    z = [float(np.sum(white[lag:] * white[:-lag]) / np.sqrt(count - lag)) / power for lag in range(1, _LAGS + 1)]
    return max(abs(entry) for entry in z) > _TOGETHER


def _tried(models: Sequence[FlightModel], fitted: FlightFit, candidate: Candidate[EffectTerm]) -> Candidate[EffectTerm]:
    trial = best_trial(models, fitted, candidate.term)
    if trial is None:
        return candidate
    z = normal_score(min(-trial.gain + trial.term.log_trials, 0.0))
    if z <= candidate.z:
        return candidate
    return dataclasses.replace(candidate, term=trial.term, z=z, log_odds=trial.gain - trial.term.log_trials)
