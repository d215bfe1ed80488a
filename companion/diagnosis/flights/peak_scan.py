"""A further mode at any frequency: directions of the spectral matrix, one for each place.

A further mode adds a peak that both sides show alike, or against each other. Its strength at the best of all places is
paid for by the number of places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.scores import Column, packed
from companion.records import Floats

_APART = 1.05  # chosen: ratio of neighbouring trial frequencies, about the width of a trial peak
_DAMPING = 0.02  # chosen: ratio of the trial resonance: an airframe's usual lightly damped part


def peaks(
    models: Sequence[FlightModel], expectations: Sequence[Expectation]
) -> tuple[list[str], list[list[Column]], Floats]:
    """Names of n peaks, columns by recording, and the skewness (n,) of each score by chance."""
    low_hz = max(float(model.band_hz[0]) for model in models)
    top_hz = max(float(model.band_hz[-1]) for model in models)
    places = np.exp(np.arange(np.log(_APART * low_hz), np.log(top_hz), np.log(_APART))).tolist()
    sides = len(models[0].observations.sides)
    signs = ((1.0, "both sides together"), (-1.0, "side against side")) if sides == 2 else ((1.0, "the side"),)
    names = [f"{what} near {place:.1f} Hz" for _, what in signs for place in places]
    columns: list[list[Column]] = [[] for _ in models]
    cubes, squares = np.zeros(len(names)), np.zeros(len(names))
    for model, expectation, recording_columns in zip(models, expectations, columns, strict=True):
        vectors = [np.array([sign, 1.0][-sides:])[:, None] * np.ones_like(model.band_hz) for sign, _ in signs]
        whitened = [expectation.whitened(vector.astype(np.complex128)) for vector in vectors]
        for i, (white, place) in enumerate((white, place) for white in whitened for place in places):
            shape = _peak(model.band_hz, place)
            recording_columns.append(Column(power=packed((white[:, None] * white.conj()[None]) * shape)))
            power = shape * np.sum(np.abs(white) ** 2, axis=0)
            cubes[i] += model.weight * np.sum(power**3)
            squares[i] += model.weight * np.sum(power**2)
    return names, columns, 2.0 * cubes / np.maximum(squares, 1e-100) ** 1.5


def _peak(f_hz: Floats, place_hz: float) -> Floats:
    """Power of the acceleration of an oscillator that is driven by noise, 1 at its top."""
    ratio2 = (f_hz / place_hz) ** 2
    return np.asarray((2.0 * _DAMPING * ratio2) ** 2 / ((1.0 - ratio2) ** 2 + (2.0 * _DAMPING) ** 2 * ratio2))
