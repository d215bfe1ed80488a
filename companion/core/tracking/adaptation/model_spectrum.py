"""One-sided spectrum of the averaged vertical acceleration of one family, given its parameters.

The formulas hold for one frequency or for an array of them: compiled, one after the other; in numpy, all at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import COMPILED, compiled
from companion.core.tracking.parameters import (
    COHERENCE,
    CORNER_1,
    CORNER_2,
    DAMPING,
    DAMPING_2,
    FREQUENCY,
    FREQUENCY_2,
    LOAD,
    LOAD_2,
    PARAMETERS,
)
from companion.records import Floats, Ints

_COARSE_POINTS = 24  # numerical: the aliased part is smooth
_ALIAS_ORDERS = (-2, -1, 1, 2)  # numerical: higher ones fall with the epoch's sinc


class GridPoints(NamedTuple):
    """Squared frequencies, (n,) Hz^2, and ``sinc^2`` of the averaging epoch there."""

    square: Floats
    epoch_gain: Floats


class SpectralGrid(NamedTuple):
    """Frequencies at which the model is evaluated, in rising order, and those that alias to a few points of them.

    ``before`` (n,) and ``fraction`` (n,) say between which of the coarse points each frequency lies.
    """

    exact: GridPoints
    aliases: GridPoints
    before: Ints
    fraction: Floats


def make_grid(frequency_hz: Floats, step_s: float) -> SpectralGrid:
    """Grid of frequencies (n,) for an acceleration averaged over epochs of ``step_s``."""
    coarse = np.linspace(frequency_hz[0], frequency_hz[-1], _COARSE_POINTS)
    place = (frequency_hz - coarse[0]) / (coarse[1] - coarse[0])
    before = np.minimum(place, _COARSE_POINTS - 2.0).astype(np.int64)
    aliased = np.concatenate([coarse + order / step_s for order in _ALIAS_ORDERS])
    return SpectralGrid(_points(frequency_hz, step_s), _points(aliased, step_s), before, place - before)


def _points(frequency_hz: Floats, step_s: float) -> GridPoints:
    """Squared frequencies and epoch gains."""
    angle = np.pi * step_s * frequency_hz
    return GridPoints(frequency_hz**2, (np.sin(angle) / angle) ** 2)


@compiled
def load_density(values: Floats, square: float, reference_hz: float) -> float:
    """Density of the gust load, (m/s^2)^2/Hz, at a squared frequency; ``values`` as in ``parameters``."""
    inverse_1, inverse_2 = 1.0 / values[CORNER_1] ** 2, 1.0 / values[CORNER_2] ** 2
    at_reference = (1.0 + reference_hz**2 * inverse_1) * (1.0 + reference_hz**2 * inverse_2)
    density: float = values[LOAD] * at_reference / ((1.0 + square * inverse_1) * (1.0 + square * inverse_2))
    return density


@compiled
def acceleration_density(log_params: Floats, grid: SpectralGrid, reference_hz: float) -> Floats:
    """Density of the tip's acceleration on a grid, aliases included.

    ``H = f^2 / (f0^2 - f^2 + 2 i zeta f0 f)`` of both modes under their loads, ``L1 |H1|^2 + L2 |H2|^2 + 2 c sqrt(L1
    L2) Re(H1 H2*)`` with coherence c, times the epoch's ``sinc^2``. Far above the modes the tip is a free mass: that
    part comes back by aliasing, and is smooth, so it is evaluated on few points.

    Parameters
    ----------
    log_params : (9,) float64
        Logarithms of the parameters.
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
    aliased = _sum_aliases(_densities(values, grid.aliases, reference_hz).reshape(1, -1))
    density: Floats = _add_coarse(_densities(values, grid.exact, reference_hz).reshape(1, -1), aliased, grid)[0]
    return density


@compiled
def acceleration_gradient(log_params: Floats, grid: SpectralGrid, reference_hz: float) -> Floats:
    """:func:`acceleration_density` and its derivatives by the nine log parameters: (10, n)."""
    values = np.exp(log_params)
    return _add_coarse(
        _gradients(values, grid.exact, reference_hz), _sum_aliases(_gradients(values, grid.aliases, reference_hz)), grid
    )


@compiled
def _sum_aliases(aliases: Floats) -> Floats:
    """Sum over the alias orders on the coarse points, (r, coarse)."""
    summed = np.zeros((len(aliases), _COARSE_POINTS))
    for k in range(len(_ALIAS_ORDERS)):
        summed += aliases[:, k * _COARSE_POINTS : (k + 1) * _COARSE_POINTS]
    return summed


_DensityTerms = tuple[float, float, float, float]


@compiled
def _density_terms(values: Floats, square: float, epoch_gain: float, reference_hz: float) -> _DensityTerms:
    """Density by the first mode, by the second, their joint term for fully coherent loads, and this over ``N``.

    ``N = a1 a2 + b1 b2`` where ``a = f0^2 - f^2`` and ``b = 2 zeta f0 f``.
    """
    first, ratio = epoch_gain * load_density(values, square, reference_hz), _ratio(values, reference_hz)
    damping_2 = first * ratio
    apart, apart_2 = values[FREQUENCY] ** 2 - square, values[FREQUENCY_2] ** 2 - square
    size = square / (apart**2 + _resisted(values, DAMPING, DAMPING, square))
    size_2 = square / (apart_2**2 + _resisted(values, DAMPING_2, DAMPING_2, square))
    common = 2.0 * first * np.sqrt(ratio) * size * size_2
    joint = common * (apart * apart_2 + _resisted(values, DAMPING, DAMPING_2, square))
    return first * size * square, damping_2 * size_2 * square, joint, common


@compiled
def _ratio(values: Floats, reference_hz: float) -> float:
    """Second load over the first: both have one shape, and each is stated at its own frequency."""
    at_first, at_second = reference_hz**2, values[FREQUENCY_2] ** 2
    ratio: float = values[LOAD_2] / values[LOAD]
    for which in (CORNER_1, CORNER_2):
        corner = values[which] ** 2
        ratio *= (corner + at_second) / (corner + at_first)
    return ratio


@compiled
def _coherence(values: Floats) -> float:
    """Coherence from its log parameter."""
    square = values[COHERENCE] ** 2
    return float((square - 1.0) / (square + 1.0))


@compiled
def _resisted(values: Floats, damping_1: int, damping_2: int, square: float) -> float:
    """``b1 b2`` of two modes, given by the indices of their dampings: each frequency is the entry before."""
    resisted: float = (
        4.0 * values[damping_1] * values[damping_2] * values[damping_1 - 1] * values[damping_2 - 1] * square
    )
    return resisted


@compiled
def _density_at(values: Floats, square: float, epoch_gain: float, reference_hz: float) -> float:
    """Density at one frequency."""
    exact, second, joint, _ = _density_terms(values, square, epoch_gain, reference_hz)
    return exact + second + _coherence(values) * joint


_Gradient = tuple[float, float, float, float, float, float, float, float, float, float]


@compiled
def _gradient_at(values: Floats, square: float, epoch_gain: float, reference_hz: float) -> _Gradient:
    """Density and its derivatives, in the parameters' order."""
    coherence = _coherence(values)
    exact, second, joint, common = _density_terms(values, square, epoch_gain, reference_hz)
    shared, common = coherence * joint, coherence * common
    at_first, at_own, at_second = reference_hz**2, values[FREQUENCY] ** 2, values[FREQUENCY_2] ** 2
    apart, apart_2 = at_own - square, at_second - square
    resisted = common * _resisted(values, DAMPING, DAMPING_2, square)
    by_frequency, by_damping = _response_gradient(apart, _resisted(values, DAMPING, DAMPING, square), at_own)
    by_frequency_2, by_damping_2 = _response_gradient(
        apart_2, _resisted(values, DAMPING_2, DAMPING_2, square), at_second
    )
    by_corner, by_corner_first, by_corner_second = _roll_off_gradient(
        values[CORNER_1] ** 2, square, at_first, at_second
    )
    by_corner_2, by_corner_2_first, by_corner_2_second = _roll_off_gradient(
        values[CORNER_2] ** 2, square, at_first, at_second
    )
    moved = (exact + shared) * by_frequency + 2.0 * common * at_own * apart_2 + resisted
    moved_2 = (second + shared) * by_frequency_2 + 2.0 * common * at_second * apart + resisted
    total, half = exact + second + shared, 0.5 * shared
    return (
        total,
        moved,
        (exact + shared) * by_damping + resisted,
        exact + half,
        total * by_corner - (exact + half) * by_corner_first - (second + half) * by_corner_second,
        total * by_corner_2 - (exact + half) * by_corner_2_first - (second + half) * by_corner_2_second,
        moved_2 + (second + half) * (by_corner_second + by_corner_2_second),
        (second + shared) * by_damping_2 + resisted,
        second + half,
        (1.0 - coherence**2) * joint,
    )


@compiled
def _response_gradient(apart: float, resisted: float, exact: float) -> tuple[float, float]:
    """Derivatives of the logarithm of ``|H|^2`` by those of frequency and damping."""
    size = apart**2 + resisted
    return -(4.0 * exact * apart + 2.0 * resisted) / size, -2.0 * resisted / size


@compiled
def _roll_off_gradient(corner: float, square: float, at_first: float, at_second: float) -> tuple[float, float, float]:
    """Derivative of ``ln(1 / (1 + f^2/c^2))`` by ``ln c``: here, and where the two loads are stated."""
    return (
        2.0 * square / (corner + square),
        2.0 * at_first / (corner + at_first),
        2.0 * at_second / (corner + at_second),
    )


if COMPILED:

    @compiled
    def _add_coarse(rows: Floats, coarse: Floats, grid: SpectralGrid) -> Floats:
        """Add to every row its coarse points, interpolated."""
        for row in range(len(rows)):
            for k in range(len(grid.before)):
                at, fraction = grid.before[k], grid.fraction[k]
                rows[row, k] += (1.0 - fraction) * coarse[row, at] + fraction * coarse[row, at + 1]
        return rows

    @compiled
    def _densities(values: Floats, points: GridPoints, reference_hz: float) -> Floats:
        """Densities at all points."""
        out = np.empty(len(points.square))
        for k in range(len(out)):
            out[k] = _density_at(values, points.square[k], points.epoch_gain[k], reference_hz)
        return out

    @compiled
    def _gradients(values: Floats, points: GridPoints, reference_hz: float) -> Floats:
        """Densities and derivatives at all points, (10, n)."""
        out = np.empty((1 + PARAMETERS, len(points.square)))
        for k in range(len(points.square)):
            column = _gradient_at(values, points.square[k], points.epoch_gain[k], reference_hz)
            for row in range(1 + PARAMETERS):
                out[row, k] = column[row]
        return out

else:

    def _add_coarse(rows: Floats, coarse: Floats, grid: SpectralGrid) -> Floats:
        rows += (1.0 - grid.fraction) * coarse[:, grid.before] + grid.fraction * coarse[:, grid.before + 1]
        return rows

    def _densities(values: Floats, points: GridPoints, reference_hz: float) -> Floats:
        return np.asarray(_density_at(values, points.square, points.epoch_gain, reference_hz))  # type: ignore[arg-type]

    def _gradients(values: Floats, points: GridPoints, reference_hz: float) -> Floats:
        rows = _gradient_at(values, points.square, points.epoch_gain, reference_hz)  # type: ignore[arg-type]
        return np.stack(np.broadcast_arrays(*rows))
