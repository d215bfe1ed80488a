"""Adequacy tests of a fitted model of flights: whether it leaves nothing but noise.

Directions without a name are tested by efficient scores (:mod:`.lack_of_fit_tests`). Statistics that are no direction
of mean or spectrum (outliers, unsteadiness, single lines, size of range residuals) are compared with draws of the
model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import kurtosistest

from companion.diagnosis.flights.lack_of_fit_tests import lack_of_fit_tests
from companion.diagnosis.flights.prior_tension import prior_tension
from companion.diagnosis.flights.proposals import strongest_line, strongest_parametric_excitation
from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.normal_scores import normal_score, strength
from companion.records import Bools, Complexes, Floats, Ints

_SIMULATED = 400  # draws: the spread of a statistic is then known to 4 % (choice)
_BLOCKS = 12  # of a recording, for a change of its noise (choice)
_NARROW = 50  # chosen: bands of a spectrum, narrow enough that a missed line stands out
_FEWEST = 10  # chosen: least bins of a band, for a mean whose law is known
_MANY = 24  # bins from which a mean is near normal (choice)
_FEWEST_EXPOSURES = 20  # for a test of the measured toe
_AROUND = 1.35  # chosen: factor on the first frequencies that bounds the band about the first modes
_SWINGS = 3  # periods per recording, at most, of the slow changes that are tested (choice)
LIMIT = 5.0
"""Standard deviations beyond which a test is not chance: safe with a hundred tests in hundreds of flights (choice)."""
LIMIT_OF_NAMES = 4.2
"""The same where names were given: something is wrong then, and what remains speaks against the names (choice)."""


def check(models: Sequence[FlightModel], fitted: FlightFit, seed: int = 20250101) -> list[Check]:
    """All checks of a fitted model, the worst first."""
    rng = np.random.default_rng(seed)
    checks = lack_of_fit_tests(models, fitted)
    for model, expectation in zip(models, fitted.state.expectations, strict=True):
        tests = {
            **_unsteady(model, expectation, rng),
            **_changing(model, expectation, rng),
            **_lines(model, expectation),
        }
        for name, z in {**tests, **_toe(model, expectation, rng)}.items():
            if abs(z) > abs(checks.get(name, 0.0)) or name not in checks:
                checks[name] = z
    checks |= prior_tension(models[0].belief, fitted)
    limit = LIMIT_OF_NAMES if fitted.terms else LIMIT
    return sorted((Check(name, z, limit) for name, z in checks.items()), key=lambda entry: -abs(entry.z))


def _lines(model: FlightModel, expectation: Expectation) -> dict[str, float]:
    """The strongest single frequency of the residual, and of the stiffness, all places paid for."""
    strengths = {}
    for name, line in (
        ("single line", strongest_line(model, expectation)),
        ("swing", strongest_parametric_excitation(model, expectation)),
    ):
        if line is not None:
            strengths[f"{name} in the residual"] = normal_score(min(line.log_tail, 0.0))
    return strengths


def _unsteady(model: FlightModel, expectation: Expectation, rng: np.random.Generator) -> dict[str, float]:
    """Outliers and swelling of the whitened residual in time, against as much white noise."""
    white = expectation.white_residual
    in_time = np.fft.ifft(white, axis=1, norm="ortho")
    middle = in_time[:, in_time.shape[1] // 16 : -in_time.shape[1] // 16]  # clear of the taper
    names = [
        f"{side.name.lower()} {what}" for what in ("outliers", "unsteadiness") for side in model.observations.sides
    ]
    real = _of_envelope(np.abs(middle) ** 2)
    drawn = np.stack([_of_envelope(rng.standard_exponential(middle.shape)) for _ in range(_SIMULATED)])
    return dict(zip(names, [strength(*entry) for entry in zip(real, drawn.T, strict=True)], strict=True))


def _changing(model: FlightModel, expectation: Expectation, rng: np.random.Generator) -> dict[str, float]:
    """Whether the spectrum changes in time, by narrow bands, against as much tapered white noise.

    The swing of the power in a band with period T/m is the sum over the band of one bin times the conjugate of the m-th
    after it. It tells one line that moved from two modes that are there all the time.
    """
    white = expectation.white_residual
    count = white.shape[1]
    edges = np.unique(
        np.searchsorted(model.band_hz, np.geomspace(model.band_hz[0], model.band_hz[-1], _NARROW + 1)[:-1])
    )
    edges = edges[np.append(np.diff(edges) >= _FEWEST, True)]
    if count - edges[-1] < _FEWEST + _SWINGS:
        edges = edges[:-1]
    if not len(edges):  # a segment of a few seconds has too few bins for any band
        return {}
    taper = np.interp(
        np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(model.transforms.taper)), model.transforms.taper
    )
    taper = taper / np.sqrt(np.mean(taper**2))
    drawn = []
    for _ in range(_SIMULATED // 2):
        noise = rng.standard_normal(white.shape) + 1j * rng.standard_normal(white.shape)
        drawn.append(_swings(np.fft.fft(np.sqrt(0.5) * taper * noise, axis=1, norm="ortho"), edges))
    table, real = np.stack(drawn), _swings(white, edges)
    centre_hz = model.band_hz[edges + np.diff(np.append(edges, count)) // 2]
    mean = np.mean(table, axis=(0, 1))
    # the tail of a single band is exponential only where many bins are in it
    worst = (real / mean).max(axis=(0, 1)) * (np.diff(np.append(edges, count)) >= _MANY)
    best, log_trials = int(np.argmax(worst)), math.log(real.size)
    tests = {
        f"power changing in time near {centre_hz[best]:.1f} Hz": normal_score(min(log_trials - float(worst[best]), 0.0))
    }
    for name, inside in (("spectra", centre_hz > 0.0), ("first modes", _near_modes(model, centre_hz))):
        if inside.any():
            total = np.sum(table[..., inside], axis=(1, 2, 3))
            tests[f"{name} changing in time"] = strength(float(np.sum(real[..., inside])), total)
    return tests


def _near_modes(model: FlightModel, f_hz: Floats) -> Bools:
    wing = model.belief.airframe.wing
    first_hz = [mode.frequency_hz.value for mode in (wing.symmetric, wing.antisymmetric) if mode is not None]
    return np.asarray((f_hz > min(first_hz) / _AROUND) & (f_hz < max(first_hz) * _AROUND))


def _swings(white: Complexes, edges: Ints) -> Floats:
    """Strength of the m-th swing of the power in each band, (c, swings, bands), about 1 by chance."""
    strengths = []
    for m in range(1, _SWINGS + 1):
        products = white[:, :-m] * white[:, m:].conj()
        counts = np.diff(np.append(edges, products.shape[1]))
        strengths.append(np.abs(np.add.reduceat(products, edges, axis=1)) ** 2 / counts)
    return np.stack(strengths, 1)


def _of_envelope(power: Floats) -> Floats:
    """Logarithm of kurtosis, and the relative variance between blocks (nearly a gamma's), by channel."""
    kurtosis = np.mean(power**2, axis=1) / np.mean(power, axis=1) ** 2
    blocks = power[:, : power.shape[1] // _BLOCKS * _BLOCKS].reshape(len(power), _BLOCKS, -1).mean(2)
    return np.concatenate([np.log(kurtosis), blocks.var(1) / blocks.mean(1) ** 2])


def _toe(model: FlightModel, expectation: Expectation, rng: np.random.Generator) -> dict[str, float]:
    """Size, neighbours and outliers of the whitened toe residual, against as much white noise."""
    if model.observations.toe is None:
        return {}
    root = np.linalg.cholesky(expectation.toe_errors.covariance)
    white = solve_triangular(root, expectation.toe_residual_rad, lower=True)
    drawn = np.stack([_of_residual(rng.standard_normal(len(root))) for _ in range(_SIMULATED)])
    names = ("range residual size", "range residual neighbours")
    tests = {name: strength(*entry) for name, *entry in zip(names, _of_residual(white), drawn.T, strict=True)}
    if len(white) >= _FEWEST_EXPOSURES:
        tests["range residual outliers"] = float(outliers(white))
    return tests


def outliers(white: Floats) -> Floats:
    """Standard normal equivalent (...,) of the kurtosis of white noise (..., m), along the last axis.

    The tail of a kurtosis is longer than a gamma law with the skewness of some hundred draws: 4 sigma would count as
    4.6. After Anscombe and Glynn, Biometrika 70 (1983) 227.
    """
    return np.asarray(kurtosistest(white, axis=-1).statistic)


def _of_residual(white: Floats) -> Floats:
    power = float(np.mean(white**2))
    return np.array([math.log(power), np.mean(white[1:] * white[:-1]) / power])
