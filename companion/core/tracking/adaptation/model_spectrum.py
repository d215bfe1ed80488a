"""The one-sided spectrum that the averaged vertical acceleration of one family must have, given its parameters.

The formulas are of one frequency or of an array of them: what is compiled takes one after the other, numpy takes all.
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

_COARSE = 24
_TURNS = (-2, -1, 1, 2)


class Points(NamedTuple):
    """Frequencies squared, (n,), and ``sinc^2`` of the cell that averages there."""

    square: Floats
    cell: Floats


class Grid(NamedTuple):
    """Frequencies at which the model is worked out, in rising order, and those that alias to a few points of them.

    ``before`` (n,) and ``share`` (n,) say between which of the few each frequency lies.
    """

    own: Points
    aliases: Points
    before: Ints
    share: Floats


def make_grid(frequency_hz: Floats, step_s: float) -> Grid:
    """Prepare frequencies (n,) for an acceleration averaged over cells of ``step_s``."""
    coarse = np.linspace(frequency_hz[0], frequency_hz[-1], _COARSE)
    place = (frequency_hz - coarse[0]) / (coarse[1] - coarse[0])
    before = np.minimum(place, _COARSE - 2.0).astype(np.int64)
    folded = np.concatenate([coarse + turns / step_s for turns in _TURNS])
    return Grid(_points(frequency_hz, step_s), _points(folded, step_s), before, place - before)


def _points(frequency_hz: Floats, step_s: float) -> Points:
    turn = np.pi * step_s * frequency_hz
    return Points(frequency_hz**2, (np.sin(turn) / turn) ** 2)


@compiled
def load_density(values: Floats, square: float, reference_hz: float) -> float:
    """Density of the gust load, (m/s^2)^2/Hz, at a squared frequency; ``values`` as in ``core.mode.parameters``."""
    inverse_1, inverse_2 = 1.0 / values[CORNER_1] ** 2, 1.0 / values[CORNER_2] ** 2
    at_reference = (1.0 + reference_hz**2 * inverse_1) * (1.0 + reference_hz**2 * inverse_2)
    density: float = values[LOAD] * at_reference / ((1.0 + square * inverse_1) * (1.0 + square * inverse_2))
    return density


@compiled
def acceleration_density(logs: Floats, grid: Grid, reference_hz: float) -> Floats:
    """Density of the tip's acceleration on a grid, aliases included, (n,).

    ``H = f^2 / (f0^2 - f^2 + 2 i zeta f0 f)`` of both modes under their loads, ``L1 |H1|^2 + L2 |H2|^2 +
    2 c sqrt(L1 L2) Re(H1 H2*)`` with coherence c, times the cell's ``sinc^2``. Far above the modes the tip is a free
    mass: that part comes back by aliasing, and is smooth, so it is worked out on few points.
    """
    values = np.exp(logs)
    aliased = _summed(_densities(values, grid.aliases, reference_hz).reshape(1, -1))
    density: Floats = _added(_densities(values, grid.own, reference_hz).reshape(1, -1), aliased, grid)[0]
    return density


@compiled
def acceleration_slopes(logs: Floats, grid: Grid, reference_hz: float) -> Floats:
    """:func:`acceleration_density` and its derivatives by the nine logarithms: (10, n)."""
    values = np.exp(logs)
    return _added(_slopes(values, grid.own, reference_hz), _summed(_slopes(values, grid.aliases, reference_hz)), grid)


@compiled
def _summed(aliases: Floats) -> Floats:
    """What all aliases bring to the few points, (r, few)."""
    summed = np.zeros((len(aliases), _COARSE))
    for k in range(len(_TURNS)):
        summed += aliases[:, k * _COARSE : (k + 1) * _COARSE]
    return summed


_Parts = tuple[float, float, float, float]


@compiled
def _parts(values: Floats, square: float, cell: float, reference_hz: float) -> _Parts:
    """Density by the first mode, by the second, what comes with it where both loads are one, and this over ``N``.

    ``N = a1 a2 + b1 b2`` where ``a = f0^2 - f^2`` and ``b = 2 zeta f0 f``.
    """
    first, ratio = cell * load_density(values, square, reference_hz), _ratio(values, reference_hz)
    other = first * ratio
    apart, apart_2 = values[FREQUENCY] ** 2 - square, values[FREQUENCY_2] ** 2 - square
    size = square / (apart**2 + _resisted(values, DAMPING, DAMPING, square))
    size_2 = square / (apart_2**2 + _resisted(values, DAMPING_2, DAMPING_2, square))
    common = 2.0 * first * np.sqrt(ratio) * size * size_2
    joint = common * (apart * apart_2 + _resisted(values, DAMPING, DAMPING_2, square))
    return first * size * square, other * size_2 * square, joint, common


@compiled
def _ratio(values: Floats, reference_hz: float) -> float:
    """Second load over the first: both have one colour, and each is told at its own frequency."""
    at_first, at_second = reference_hz**2, values[FREQUENCY_2] ** 2
    ratio: float = values[LOAD_2] / values[LOAD]
    for which in (CORNER_1, CORNER_2):
        corner = values[which] ** 2
        ratio *= (corner + at_second) / (corner + at_first)
    return ratio


@compiled
def _coherence(values: Floats) -> float:
    square = values[COHERENCE] ** 2
    return float((square - 1.0) / (square + 1.0))


@compiled
def _resisted(values: Floats, one: int, other: int, square: float) -> float:
    """``b1 b2`` of two modes, told by where their dampings are: each frequency is the entry before."""
    resisted: float = 4.0 * values[one] * values[other] * values[one - 1] * values[other - 1] * square
    return resisted


@compiled
def _density_at(values: Floats, square: float, cell: float, reference_hz: float) -> float:
    own, second, joint, _ = _parts(values, square, cell, reference_hz)
    return own + second + _coherence(values) * joint


_Slopes = tuple[float, float, float, float, float, float, float, float, float, float]


@compiled
def _slopes_at(values: Floats, square: float, cell: float, reference_hz: float) -> _Slopes:
    """Density and its derivatives, in the parameters' order."""
    coherence = _coherence(values)
    own, second, joint, common = _parts(values, square, cell, reference_hz)
    shared, common = coherence * joint, coherence * common
    at_first, at_own, at_second = reference_hz**2, values[FREQUENCY] ** 2, values[FREQUENCY_2] ** 2
    apart, apart_2 = at_own - square, at_second - square
    resisted = common * _resisted(values, DAMPING, DAMPING_2, square)
    by_frequency, by_damping = _response_slopes(apart, _resisted(values, DAMPING, DAMPING, square), at_own)
    by_frequency_2, by_damping_2 = _response_slopes(apart_2, _resisted(values, DAMPING_2, DAMPING_2, square), at_second)
    falls, falls_first, falls_second = _falls(values[CORNER_1] ** 2, square, at_first, at_second)
    falls_2, falls_2_first, falls_2_second = _falls(values[CORNER_2] ** 2, square, at_first, at_second)
    moved = (own + shared) * by_frequency + 2.0 * common * at_own * apart_2 + resisted
    moved_2 = (second + shared) * by_frequency_2 + 2.0 * common * at_second * apart + resisted
    total, half = own + second + shared, 0.5 * shared
    return (
        total,
        moved,
        (own + shared) * by_damping + resisted,
        own + half,
        total * falls - (own + half) * falls_first - (second + half) * falls_second,
        total * falls_2 - (own + half) * falls_2_first - (second + half) * falls_2_second,
        moved_2 + (second + half) * (falls_second + falls_2_second),
        (second + shared) * by_damping_2 + resisted,
        second + half,
        (1.0 - coherence**2) * joint,
    )


@compiled
def _response_slopes(apart: float, resisted: float, own: float) -> tuple[float, float]:
    """Derivatives of the logarithm of ``|H|^2`` by those of frequency and damping."""
    size = apart**2 + resisted
    return -(4.0 * own * apart + 2.0 * resisted) / size, -2.0 * resisted / size


@compiled
def _falls(corner: float, square: float, at_first: float, at_second: float) -> tuple[float, float, float]:
    """Derivative of ``ln(1 / (1 + f^2/c^2))`` by ``ln c``: here, and where the two loads are told."""
    return (
        2.0 * square / (corner + square),
        2.0 * at_first / (corner + at_first),
        2.0 * at_second / (corner + at_second),
    )


if COMPILED:

    @compiled
    def _added(rows: Floats, few: Floats, grid: Grid) -> Floats:
        """Add to every row what its few points say of all others."""
        for row in range(len(rows)):
            for k in range(len(grid.before)):
                at, share = grid.before[k], grid.share[k]
                rows[row, k] += (1.0 - share) * few[row, at] + share * few[row, at + 1]
        return rows

    @compiled
    def _densities(values: Floats, points: Points, reference_hz: float) -> Floats:
        out = np.empty(len(points.square))
        for k in range(len(out)):
            out[k] = _density_at(values, points.square[k], points.cell[k], reference_hz)
        return out

    @compiled
    def _slopes(values: Floats, points: Points, reference_hz: float) -> Floats:
        out = np.empty((1 + PARAMETERS, len(points.square)))
        for k in range(len(points.square)):
            column = _slopes_at(values, points.square[k], points.cell[k], reference_hz)
            for row in range(1 + PARAMETERS):
                out[row, k] = column[row]
        return out

else:

    def _added(rows: Floats, few: Floats, grid: Grid) -> Floats:
        rows += (1.0 - grid.share) * few[:, grid.before] + grid.share * few[:, grid.before + 1]
        return rows

    def _densities(values: Floats, points: Points, reference_hz: float) -> Floats:
        return np.asarray(_density_at(values, points.square, points.cell, reference_hz))  # type: ignore[arg-type]

    def _slopes(values: Floats, points: Points, reference_hz: float) -> Floats:
        rows = _slopes_at(values, points.square, points.cell, reference_hz)  # type: ignore[arg-type]
        return np.stack(np.broadcast_arrays(*rows))
