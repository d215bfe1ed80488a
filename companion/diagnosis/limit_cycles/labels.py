"""Airspeeds that recordings say against those that their own limit cycles tell: one that disagrees is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.limit_cycles.tracks import VibrationTrack
from companion.records import Floats

_FEWEST = 5  # limit cycles that can judge one of them
_FAR = 6.0  # times the scatter of the others
_LEAST = 0.06  # of the airspeed: less is drift of the rig between days
_DEGREE = 2  # of the airspeed over the logarithm of the amplitude
_REWEIGHTED = 30  # steps to the least absolute deviation


@dataclass(frozen=True, slots=True)
class LabelDoubt:
    """A recording whose limit cycle is that of another airspeed than it says; ``scatter_mps`` is that of the others."""

    recording: int
    name: str
    says_mps: float
    tells_mps: float
    scatter_mps: float


def doubtful_labels(tracks: Sequence[VibrationTrack]) -> tuple[LabelDoubt, ...]:
    """Each limit cycle's airspeed by its amplitude as the others have it, robust against other wrong labels."""
    steady = [i for i, entry in enumerate(tracks) if entry.steady.any() and entry.airspeed_mps is not None]
    if len(steady) < _FEWEST:
        return ()
    says = np.array([float(tracks[i].airspeed_mps or 0.0) for i in steady])
    tells = np.array([_features(tracks[i]) for i in steady])
    doubts = []
    for k, i in enumerate(steady):
        others = np.arange(len(steady)) != k
        coefficients = _least_absolute(_design(tells[others], tells[others]), says[others])
        expected = float((_design(tells[k : k + 1], tells[others]) @ coefficients)[0])
        residual = says[others] - _design(tells[others], tells[others]) @ coefficients
        scatter = 1.4826 * float(np.median(np.abs(residual)))  # of a normal distribution, from its median
        if abs(says[k] - expected) > max(_FAR * scatter, _LEAST * abs(expected)):
            doubts.append(LabelDoubt(i, tracks[i].name, float(says[k]), expected, scatter))
    return tuple(doubts)


def _features(entry: VibrationTrack) -> float:
    first = next(iter(entry.amplitude.values()))
    return float(np.log(first[entry.steady].mean()))


def _design(values: Floats, about: Floats) -> Floats:
    return np.asarray(np.vander((values - about.mean()) / (float(about.std()) or 1.0), _DEGREE + 1))


def _least_absolute(design: Floats, values: Floats) -> Floats:
    weight = np.ones(len(values))
    for _ in range(_REWEIGHTED):
        root = np.sqrt(weight)
        coefficients = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        weight = 1.0 / np.maximum(np.abs(values - design @ coefficients), 1e-3 * float(np.median(np.abs(values))))
    return np.asarray(coefficients)
