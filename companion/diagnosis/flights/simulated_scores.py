"""Scatter by chance of the scores of nonlinear sensors, by simulation.

A change that is made of the data themselves has a score whose variance is not that of its column: it is twice as much
for a gain that grows in time, and 0 for a delay. The ratio is measured on recordings drawn from the fitted spectra.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from companion.core.wing.effect import Effect
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.nonlinear_correction import SensorLineariser
from companion.records import Complexes, Floats

DRAWS = 40
"""Simulated recordings: a standard deviation is then known to 11 % (choice)."""
_SEED = 20250102  # convention: any fixed number


def is_sample_nonlinearity(effect: Effect) -> bool:
    """Whether an effect's score is made of the samples themselves."""
    kind = type(effect)
    return kind.sense is not Effect.sense and kind.response is Effect.response


def score_scatter(
    models: Sequence[FlightModel], expectations: Sequence[Expectation], effects: Sequence[Effect]
) -> Floats:
    """Standard deviation of each effect's score over that by its column, (e,), at least 1; for effects not at 0."""
    squares, products = np.zeros(len(effects)), np.zeros(len(effects))
    for model, expectation in zip(models, expectations, strict=True):
        scores, naive = _drawn(model, expectation, effects)
        squares += np.var(scores, axis=0)
        products += np.mean(naive, axis=0)
    ratio = np.divide(squares, products, out=np.ones(len(effects)), where=products > 0.0)
    return np.asarray(np.sqrt(np.maximum(ratio, 1.0)))


def _drawn(model: FlightModel, expectation: Expectation, effects: Sequence[Effect]) -> tuple[Floats, Floats]:
    """Scores and products of columns in simulated recordings, (draws, e)."""
    rng = np.random.default_rng(_SEED)
    scores, naive = np.zeros((DRAWS, len(effects))), np.zeros((DRAWS, len(effects)))
    for k in range(DRAWS):
        recording = model.draw(expectation, rng)
        simulated = dataclasses.replace(model.observations, up_mps2=np.ascontiguousarray(recording.T), fine_mps2=None)
        lineariser = SensorLineariser(simulated, model.transforms)
        residual = _white(model, expectation, recording)
        for i, effect in enumerate(effects):
            change = _white(model, expectation, _change(lineariser, effect))
            scores[k, i] = 2.0 * model.weight * float(np.sum(residual.conj() * change).real)
            naive[k, i] = 2.0 * model.weight * float(np.sum(np.abs(change) ** 2))
    return scores, naive


def _change(lineariser: SensorLineariser, effect: Effect) -> Floats:
    """Change of a recording by an effect, (c, m): by far most of the time goes into this."""
    if type(effect).sample_time is not Effect.sample_time:
        return lineariser.recorded_mps2 - lineariser.corrected_mps2([effect])[0]
    return lineariser.nonlinear_part_mps2(effect)


def _white(model: FlightModel, expectation: Expectation, values: Floats) -> Complexes:
    return expectation.whitened(model.in_band(values))
