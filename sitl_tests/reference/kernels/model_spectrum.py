"""Spectrum of a family in plain numpy: ``native/whittle.c``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.tracking.adaptation.model_spectrum import (
    _ALIAS_ORDERS,
    _COARSE_POINTS,
    GridPoints,
    SpectralGrid,
    load_density,
)
from companion.core.tracking.parameters import (
    COHERENCE,
    CORNER_1,
    CORNER_2,
    DAMPING,
    FIRST_PARAMETERS,
    FREQUENCY,
    FURTHER_PARAMETERS,
    LOAD,
)
from companion.records import Floats


def acceleration_density(log_params: Floats, grid: SpectralGrid, reference_hz: float) -> Floats:
    """Density of the tip's acceleration on a grid, aliases included.

    The sum over modes and pairs of modes of the module's text, times the epoch's ``sinc^2``. Far above the modes the
    tip is a free mass: that part comes back by aliasing, and is smooth, so it is evaluated on few points.

    Parameters
    ----------
    log_params : (5 + 4 (m - 1),) float64
        Logarithms of the parameters of m modes.
    grid : SpectralGrid
        n points.
    reference_hz : float
        Frequency at which the first load is stated.

    Returns
    -------
    (n,) float64
        (m/s^2)^2/Hz.
    """
    values = np.exp(log_params)
    aliased = _sum_aliases(_densities(values, grid.aliases, reference_hz))
    density: Floats = _add_coarse(_densities(values, grid.exact, reference_hz), aliased, grid)[0]
    return density


def acceleration_gradient(log_params: Floats, grid: SpectralGrid, reference_hz: float) -> Floats:
    """:func:`acceleration_density` and its derivatives by the p log parameters: (1 + p, n)."""
    values = np.exp(log_params)
    return _add_coarse(
        _gradients(values, grid.exact, reference_hz), _sum_aliases(_gradients(values, grid.aliases, reference_hz)), grid
    )


def _sum_aliases(aliases: Floats) -> Floats:
    """Sum over the alias orders on the coarse points, (r, coarse)."""
    summed = np.zeros((len(aliases), _COARSE_POINTS))
    for k in range(len(_ALIAS_ORDERS)):
        summed += aliases[:, k * _COARSE_POINTS : (k + 1) * _COARSE_POINTS]
    return summed


def _mode_count(values: Floats) -> int:
    """Number of modes m of a family with so many parameters."""
    return 1 + (len(values) - FIRST_PARAMETERS) // FURTHER_PARAMETERS


def _frequency_of(mode: int) -> int:
    """Place of a mode's frequency; its damping and load follow."""
    return FREQUENCY if mode == 0 else FIRST_PARAMETERS + FURTHER_PARAMETERS * (mode - 1)


def _coherences(values: Floats) -> Floats:
    """Correlation of each load with the first, (m,)."""
    coherences = np.ones(_mode_count(values))
    for k in range(1, len(coherences)):
        square = values[_frequency_of(k) + COHERENCE] ** 2
        coherences[k] = (square - 1.0) / (square + 1.0)
    return coherences


def _load_ratios(values: Floats, reference_hz: float) -> Floats:
    """Each load over the first, (m,): all have one shape, and each is stated at a frequency of its own."""
    ratios = np.ones(_mode_count(values))
    for k in range(1, len(ratios)):
        at_first, at_own = reference_hz**2, values[_frequency_of(k)] ** 2
        ratios[k] = values[_frequency_of(k) + LOAD] / values[LOAD]
        for which in (CORNER_1, CORNER_2):
            corner = values[which] ** 2
            ratios[k] *= (corner + at_own) / (corner + at_first)
    return ratios


def _resisted(values: Floats, at: int, other: int) -> float:
    """``b_j b_k / f^2`` of two modes, given by the places of their frequencies."""
    resisted: float = 4.0 * values[at + DAMPING] * values[other + DAMPING] * values[at] * values[other]
    return resisted


class _Terms(NamedTuple):
    """Density by each mode alone, (m, n); by each pair (j, k) under fully coherent loads, and this over ``a_j a_k + b_j
    b_k``, (m (m - 1) / 2, n); and ``a_k``, (m, n).
    """

    alone: Floats
    joint: Floats
    common: Floats
    apart: Floats


def _terms(values: Floats, points: GridPoints, reference_hz: float) -> _Terms:
    """Contributions of modes and pairs to the density."""
    modes, square, ratios = _mode_count(values), points.square, _load_ratios(values, reference_hz)
    pairs = modes * (modes - 1) // 2
    alone, apart, size = np.empty((modes, len(square))), np.empty((modes, len(square))), np.empty((modes, len(square)))
    joint, common = np.empty((pairs, len(square))), np.empty((pairs, len(square)))
    load = points.epoch_gain * load_density(values, square, reference_hz)
    pair = 0
    for k in range(modes):
        at = _frequency_of(k)
        apart[k] = values[at] ** 2 - square
        size[k] = square / (apart[k] * apart[k] + _resisted(values, at, at) * square)
        alone[k] = load * ratios[k] * size[k] * square
        for j in range(k):
            common[pair] = 2.0 * load * np.sqrt(ratios[j] * ratios[k]) * size[j] * size[k]
            joint[pair] = common[pair] * (apart[j] * apart[k] + _resisted(values, _frequency_of(j), at) * square)
            pair += 1
    return _Terms(alone, joint, common, apart)


def _densities(values: Floats, points: GridPoints, reference_hz: float) -> Floats:
    """Densities at all points, (1, n)."""
    return _summed(_terms(values, points, reference_hz), _coherences(values)).reshape(1, -1)


def _summed(terms: _Terms, coherence: Floats) -> Floats:
    """Density of all modes and pairs, (n,)."""
    density: Floats = terms.alone[0].copy()
    pair = 0
    for k in range(1, len(coherence)):
        density += terms.alone[k]
    for k in range(len(coherence)):
        for j in range(k):
            density += coherence[j] * coherence[k] * terms.joint[pair]
            pair += 1
    return density


def _gradients(values: Floats, points: GridPoints, reference_hz: float) -> Floats:
    """Densities and derivatives by the p log parameters at all points, (1 + p, n)."""
    terms, coherence = _terms(values, points, reference_hz), _coherences(values)
    out = np.zeros((1 + len(values), len(points.square)))
    out[0] = _summed(terms, coherence)
    by = out[1:]
    for which in (CORNER_1, CORNER_2):
        by[which] = out[0] * _roll_off_slope(values[which], points.square)
    _add_mode_slopes(by, values, terms, _shared(terms, coherence), points.square)
    _add_pair_slopes(by, values, terms, coherence, points.square)
    for k in range(len(coherence)):
        at = _frequency_of(k)
        stated = (reference_hz if k == 0 else values[at]) ** 2
        slopes = 2.0 * stated / (values[CORNER_1] ** 2 + stated), 2.0 * stated / (values[CORNER_2] ** 2 + stated)
        by[CORNER_1] -= by[at + LOAD] * slopes[0]
        by[CORNER_2] -= by[at + LOAD] * slopes[1]
        if k > 0:  # its load is stated where its frequency is
            by[at] += by[at + LOAD] * (slopes[0] + slopes[1])
    return out


def _shared(terms: _Terms, coherence: Floats) -> Floats:
    """Sum of the joint densities of each mode with all others, (m, n)."""
    shared, pair = np.zeros_like(terms.alone), 0
    for k in range(len(coherence)):
        for j in range(k):
            joint = coherence[j] * coherence[k] * terms.joint[pair]
            shared[j] += joint
            shared[k] += joint
            pair += 1
    return shared


def _add_mode_slopes(by: Floats, values: Floats, terms: _Terms, shared: Floats, square: Floats) -> None:
    """Write derivatives by each mode's frequency, damping and load, as far as they scale ``|H_k|`` and ``L_k``."""
    for k in range(len(shared)):
        at, apart, response = _frequency_of(k), terms.apart[k], terms.alone[k] + shared[k]
        resisted = _resisted(values, at, at) * square
        size = apart * apart + resisted
        by[at + FREQUENCY] = response * (-(4.0 * values[at] ** 2 * apart + 2.0 * resisted) / size)
        by[at + DAMPING] = response * (-2.0 * resisted / size)
        by[at + LOAD] = terms.alone[k] + 0.5 * shared[k]


def _add_pair_slopes(by: Floats, values: Floats, terms: _Terms, coherence: Floats, square: Floats) -> None:
    """Add derivatives through ``a_j a_k + b_j b_k`` of each pair, and by the coherences."""
    pair = 0
    for k in range(len(coherence)):
        for j in range(k):
            at, other = _frequency_of(k), _frequency_of(j)
            common = coherence[j] * coherence[k] * terms.common[pair]
            resisted = common * (_resisted(values, other, at) * square)
            by[at] = by[at] + 2.0 * common * values[at] ** 2 * terms.apart[j] + resisted
            by[other] = by[other] + 2.0 * common * values[other] ** 2 * terms.apart[k] + resisted
            by[at + DAMPING] += resisted
            by[other + DAMPING] += resisted
            by[at + COHERENCE] += (1.0 - coherence[k] ** 2) * coherence[j] * terms.joint[pair]
            if j > 0:
                by[other + COHERENCE] += (1.0 - coherence[j] ** 2) * coherence[k] * terms.joint[pair]
            pair += 1


def _roll_off_slope(corner_hz: float, square: Floats) -> Floats:
    """Negative derivative of ``ln(1 + f^2/c^2)`` by ``ln c``, over the squared frequencies."""
    return np.asarray(2.0 * square / (corner_hz**2 + square))


def _add_coarse(rows: Floats, coarse: Floats, grid: SpectralGrid) -> Floats:
    """Add to every row its coarse points, interpolated."""
    rows += (1.0 - grid.fraction) * coarse[:, grid.before] + grid.fraction * coarse[:, grid.before + 1]
    return rows
