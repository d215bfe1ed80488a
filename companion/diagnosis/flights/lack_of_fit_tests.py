"""Lack of fit without a name: generic directions of mean and spectrum, tested like named effects.

Spectra by band and channel, coherence and phase between the sides, peaks anywhere, forces and sensors by law, the toe
and its variance against regressors. Each is tested by its efficient score with all fitted parameters projected out, so
that its variance is that under this model. Each family is also tested as a whole, for errors spread over many members.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from companion.core.wing.effect import Effect
from companion.core.wing.effects import catalogue
from companion.diagnosis.flights.peak_scan import peaks
from companion.diagnosis.flights.simulated_scores import DRAWS, score_scatter
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, derivatives, joint_scores
from companion.diagnosis.model.generic_effects import (
    BOTH_LATE,
    GenericClockDrift,
    GenericClockStep,
    GenericForce,
    GenericRollOff,
    GenericSensorLaw,
    GenericStiffness,
    GenericToe,
    GenericToeVariance,
    generic_effects,
)
from companion.diagnosis.model.generic_sensing import GenericLeak
from companion.diagnosis.model.scores import Column
from companion.diagnosis.selection.normal_scores import (
    normal_score,
    normal_score_of_gamma,
    normal_score_of_products,
    normal_score_of_student,
    two_sided_log_tail,
)
from companion.diagnosis.selection.score_tests import efficient
from companion.records import Bools, Floats, Ints

_BANDS = 14  # chosen: bands of a spectrum, wide beside a mode
_INFORMATION_LEFT = 1e-3  # share of a direction's information that must be left once the fit is projected out (choice)
# of an eigenvalue of a family's correlation, below which the member is a combination of others (choice)
_ITS_OWN = 0.03
_STRAIGHT = 1e-3  # skewness below which a law counts as symmetric (numerical)
_LAPLACE, _EXPONENTIAL = 3.0, 6.0  # excess kurtosis of one product of two complex normals, and of a square (derived)


@dataclass(frozen=True, slots=True)
class _TestFamily:
    """Directions that belong together.

    ``columns`` by recording; ``skewness`` and excess ``kurtosis`` of each score by chance; ``wider`` is the ratio of
    its standard deviation to that by its column. A family with a ``title`` is also tested as a whole. A ``scanned`` one
    counts with its strongest member only, which pays for the number of members.
    """

    names: list[str]
    columns: list[list[Column]]
    title: str = ""
    skewness: Floats | None = None
    wider: Floats | None = None
    scanned: bool = False
    kurtosis: Floats | None = None


def lack_of_fit_tests(models: Sequence[FlightModel], fitted: FlightFit) -> dict[str, float]:
    """Standard deviations of every direction, and of each family as a whole."""
    families = [_spectral(models), _anywhere(models, fitted.state.expectations), *_laws(models, fitted)]
    families = [family for family in families if family.names]
    columns = [
        [*fitted_columns, *itertools.chain.from_iterable(family.columns[k] for family in families)]
        for k, fitted_columns in enumerate(fitted.state.columns)
    ]
    score, information = efficient(*joint_scores(models, fitted.state.expectations, columns), fitted)
    strengths: dict[str, float] = {}
    at = 0
    for family in families:
        block = slice(at, at + len(family.names))
        at = block.stop
        wider = np.ones(len(family.names)) if family.wider is None else family.wider
        strengths |= _strengths(family, score[block], information[block, block] * np.outer(wider, wider))
    return strengths


def _strengths(family: _TestFamily, score: Floats, information: Floats) -> dict[str, float]:
    spread = np.diag(information)
    positive = spread[spread > 0.0]
    telling = spread > _INFORMATION_LEFT * (float(np.median(positive)) if len(positive) else 0.0) * 1e-6
    telling &= spread > 0.0
    z = score / np.sqrt(np.where(telling, spread, 1.0))
    if family.skewness is not None:
        z = np.array(
            [
                normal_score_of_gamma(value, skew)
                for value, skew in zip(z.tolist(), family.skewness.tolist(), strict=True)
            ]
        )
    if family.kurtosis is not None:
        even = np.abs(family.skewness) < _STRAIGHT if family.skewness is not None else np.ones(len(z), dtype=bool)
        z[even] = [
            normal_score_of_products(value, bins)
            for value, bins in zip(z[even], _LAPLACE / family.kurtosis[even], strict=True)
        ]
    if family.wider is not None:
        z = np.array([normal_score_of_student(value, DRAWS - 1) for value in z.tolist()])
    index = np.flatnonzero(telling)
    if family.scanned:
        return _best(family, z, index)
    strengths = {family.names[i]: float(z[i]) for i in index}
    if family.title and len(index) > 1:
        longer = 0.0 if family.kurtosis is None else float(np.sum(family.kurtosis[index]))
        strengths[family.title] = _together(score[index], information[np.ix_(index, index)], longer)
    return strengths


def _best(family: _TestFamily, z: Floats, index: Ints) -> dict[str, float]:
    if not len(index):
        return {}
    best = int(index[np.argmax(np.abs(z[index]))])
    paid = normal_score(min(two_sided_log_tail(abs(float(z[best]))) + math.log(len(index)), 0.0))
    return {family.names[best]: math.copysign(paid, float(z[best]))}


def _together(score: Floats, information: Floats, kurtosis: float) -> float:
    """Normal score of a family's sum of squares; the sum of excess kurtoses widens its variance by chance."""
    unit = 1.0 / np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    independent = values > _ITS_OWN
    along = vectors[:, independent].T @ (score * unit)
    count = int(independent.sum())
    beyond = float(np.sum(along**2 / values[independent])) - count
    return normal_score(float(chi2.logsf(count + beyond / math.sqrt(1.0 + 0.5 * kurtosis / count), count)))


def _laws(models: Sequence[FlightModel], fitted: FlightFit) -> list[_TestFamily]:
    """Forces, sensors and ranges by law."""
    # beside a name, its own law differs only by how its column was made
    own_laws = {term.effect.own_law for term in fitted.terms}
    kinds = [kind for kind in generic_effects() if kind.name not in own_laws]
    forces = [kind for kind in kinds if issubclass(kind, (GenericForce, GenericStiffness))]
    stepped = any(
        catalogue()[entry.name].discretises for model in models for entry in model.observations.sample_defects
    )
    # readings in coarse steps have no slope, by which a smooth law could be tested
    sensors = [kind for kind in kinds if issubclass(kind, GenericSensorLaw) and not stepped]
    set_clocks = [kind for kind in kinds if issubclass(kind, GenericClockStep) and len(models) == 1]
    timed = BOTH_LATE if any(model.observations.recoil is not None for model in models) else ""
    bases = (GenericRollOff, GenericLeak, GenericClockDrift)
    timing = [kind for kind in kinds if issubclass(kind, bases) or kind.name == timed]
    toe = [kind for kind in kinds if issubclass(kind, GenericToe)]
    spread = [kind for kind in kinds if issubclass(kind, GenericToeVariance)]
    slight = [kind.from_values({"strength": 1e-3}) for kind in sensors]
    wider = score_scatter(models, fitted.state.expectations, slight) if slight else np.zeros(0)
    families = [
        _family(models, fitted, forces, "all forces together"),
        dataclasses.replace(_family(models, fitted, sensors, "all sensors together"), wider=wider),
        _family(models, fitted, timing),
        dataclasses.replace(_family(models, fitted, set_clocks), scanned=True),
    ]
    if any(model.observations.toe is not None for model in models):
        families.append(_family(models, fitted, toe, "all range residuals together"))
        variances = _family(models, fitted, spread)
        families.append(dataclasses.replace(variances, skewness=_skewness(variances, fitted.state.expectations)))
    return families


def _family(
    models: Sequence[FlightModel], fitted: FlightFit, kinds: Sequence[type[Effect]], title: str = ""
) -> _TestFamily:
    columns: list[list[Column]] = [[] for _ in models]
    for kind in kinds:
        effect = kind()
        values = np.append(fitted.values, 0.0)
        sigmas = np.append(fitted.sigmas, effect.parameters()[0].sigma)
        new_columns = derivatives(
            models, values, (*fitted.terms, EffectTerm(effect)), fitted.state.expectations, sigmas, [len(fitted.values)]
        )
        columns = [[*before, *new] for before, new in zip(columns, new_columns, strict=True)]
    return _TestFamily([kind.name for kind in kinds], columns, title)


def _skewness(family: _TestFamily, expectations: Sequence[Expectation]) -> Floats:
    """Skewness of the scores of the toe's variance."""
    cubes, squares = np.zeros(len(family.names)), np.zeros(len(family.names))
    for recording_columns, expectation in zip(family.columns, expectations, strict=True):
        for i, entry in enumerate(recording_columns):
            if entry.toe_variance is not None and len(entry.toe_variance):
                relative = entry.toe_variance / np.diag(expectation.toe_errors.covariance)
                relative = relative - np.mean(relative)  # how large it is as a whole is fitted
                cubes[i] += np.sum(relative**3)
                squares[i] += 0.5 * np.sum(relative**2)
    return np.asarray(cubes / np.maximum(squares, 1e-100) ** 1.5)


def _anywhere(models: Sequence[FlightModel], expectations: Sequence[Expectation]) -> _TestFamily:
    names, columns, skewness = peaks(models, expectations)
    return _TestFamily(names, columns, "", skewness, None, True)


def _spectral(models: Sequence[FlightModel]) -> _TestFamily:
    """Indicator of a band in each entry of the whitened spectral matrix."""
    names: list[str] = []
    skewness: list[float] = []
    kurtosis: list[float] = []
    columns: list[list[Column]] = [[] for _ in models]
    top_hz = max(float(model.band_hz[-1]) for model in models)
    edges = np.geomspace(float(models[0].band_hz[0]), top_hz * 1.0001, _BANDS + 1)
    # one recording may have a side that another lacks
    entries = list(dict.fromkeys(entry for model in models for entry in _entries(model)))
    for low, high in itertools.pairwise(edges.tolist()):
        for what in entries:
            showing = [model for model in models if what in _entries(model)]
            if not any(_inside(model, low, high).sum() > 4 for model in showing):
                continue
            bins = sum(model.weight * float(_inside(model, low, high).sum()) for model in showing)
            names.append(f"{what} near {np.sqrt(low * high):.1f} Hz")
            is_power = what.endswith("spectrum")
            skewness.append(2.0 / math.sqrt(bins) if is_power else 0.0)
            kurtosis.append((_EXPONENTIAL if is_power else _LAPLACE) / bins)
            for model, recording_columns in zip(models, columns, strict=True):
                packed = np.zeros((len(_entries(model)), len(model.band_hz)))
                if what in _entries(model):
                    packed[_entries(model).index(what)] = _inside(model, low, high)
                recording_columns.append(Column(power=packed.ravel()))
    return _TestFamily(names, columns, "all spectra together", np.array(skewness), kurtosis=np.array(kurtosis))


def _inside(model: FlightModel, low: float, high: float) -> Bools:
    return np.asarray((model.band_hz >= low) & (model.band_hz < high))


def _entries(model: FlightModel) -> list[str]:
    sides = [side.name.lower() for side in model.observations.sides]
    return [f"{side} spectrum" for side in sides] + (
        ["left with right", "left before right"] if len(sides) == 2 else []
    )
