"""The one-sided spectrum that the averaged vertical acceleration of one family must have, given its parameters."""

from __future__ import annotations

import numpy as np

from companion.core.compiled import compiled
from companion.core.mode.parameters import (
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
from companion.records import Floats

_COARSE = 24


@compiled
def load_density(values: Floats, square: Floats, reference_hz: float) -> Floats:
    """Density of the gust load, (m/s^2)^2/Hz, at squared frequencies; ``values`` as in ``core.mode.parameters``."""
    density: Floats = values[LOAD] * _colour(values, square, reference_hz)
    return density


@compiled
def _colour(values: Floats, square: Floats, reference_hz: float) -> Floats:
    """Density of the gust as a multiple of what it is at ``reference_hz``."""
    corner_1, corner_2 = values[CORNER_1], values[CORNER_2]
    shape_at = (1.0 + (reference_hz / corner_1) ** 2) * (1.0 + (reference_hz / corner_2) ** 2)
    colour: Floats = shape_at / ((1.0 + square / corner_1**2) * (1.0 + square / corner_2**2))
    return colour


@compiled
def acceleration_density(logs: Floats, frequency_hz: Floats, reference_hz: float, step_s: float) -> Floats:
    """Density of the tip's acceleration as averaged over cells of ``step_s``, aliases included.

    ``H = f^2 / (f0^2 - f^2 + 2 i zeta f0 f)`` of both modes under their loads, ``L1 |H1|^2 + L2 |H2|^2 +
    2 c sqrt(L1 L2) Re(H1 H2*)`` with coherence c, times the cell's ``sinc^2``. Far above the modes the tip is a free
    mass: that part comes back by aliasing, and is smooth, so it is worked out on few points.
    """
    values = np.exp(logs)
    total = _folded(values, frequency_hz, reference_hz, step_s)
    coarse = np.linspace(frequency_hz[0], frequency_hz[-1], _COARSE)
    aliased = np.zeros(_COARSE)
    for turns in (-2, -1, 1, 2):
        aliased += _folded(values, coarse + turns / step_s, reference_hz, step_s)
    both: Floats = total + np.interp(frequency_hz, coarse, aliased)
    return both


@compiled
def _folded(values: Floats, at: Floats, reference_hz: float, step_s: float) -> Floats:
    own, second, joint, _ = _parts(values, at, reference_hz, step_s)
    density: Floats = own + second + _coherence(values) * joint
    return density


@compiled
def _parts(values: Floats, at: Floats, reference_hz: float, step_s: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Density by the first mode, by the second, what comes with it where both loads are one, and this over ``N``.

    ``N = a1 a2 + b1 b2`` where ``a = f0^2 - f^2`` and ``b = 2 zeta f0 f``.
    """
    square = at**2
    turn = np.pi * step_s * at
    cell = (np.sin(turn) / turn) ** 2
    first = cell * _colour(values, square, reference_hz) * values[LOAD]
    other = cell * _colour(values, square, values[FREQUENCY_2]) * values[LOAD_2]
    size = square / _size(values[FREQUENCY], values[DAMPING], square)
    size_2 = square / _size(values[FREQUENCY_2], values[DAMPING_2], square)
    common = 2.0 * np.sqrt(first * other) * size * size_2
    apart = (values[FREQUENCY] ** 2 - square) * (values[FREQUENCY_2] ** 2 - square)
    joint = common * (apart + _resisted(values, square))
    return first * size * square, other * size_2 * square, joint, common


@compiled
def _coherence(values: Floats) -> float:
    square = values[COHERENCE] ** 2
    return float((square - 1.0) / (square + 1.0))


@compiled
def _resisted(values: Floats, square: Floats) -> Floats:
    resisted: Floats = 4.0 * values[DAMPING] * values[DAMPING_2] * values[FREQUENCY] * values[FREQUENCY_2] * square
    return resisted


@compiled
def acceleration_slopes(logs: Floats, frequency_hz: Floats, reference_hz: float, step_s: float) -> Floats:
    """:func:`acceleration_density` and its derivatives by the nine logarithms: (10, n)."""
    values = np.exp(logs)
    total = _folded_slopes(values, frequency_hz, reference_hz, step_s)
    coarse = np.linspace(frequency_hz[0], frequency_hz[-1], _COARSE)
    aliased = np.zeros((1 + PARAMETERS, _COARSE))
    for turns in (-2, -1, 1, 2):
        aliased += _folded_slopes(values, coarse + turns / step_s, reference_hz, step_s)
    place = (frequency_hz - coarse[0]) / (coarse[1] - coarse[0])
    before = np.minimum(place, _COARSE - 2.0).astype(np.int64)
    share = place - before
    for row in range(1 + PARAMETERS):
        total[row] += (1.0 - share) * aliased[row][before] + share * aliased[row][before + 1]
    return total


@compiled
def _folded_slopes(values: Floats, at: Floats, reference_hz: float, step_s: float) -> Floats:
    square = at**2
    coherence = _coherence(values)
    own, second, joint, common = _parts(values, at, reference_hz, step_s)
    shared, common = coherence * joint, coherence * common
    resisted = common * _resisted(values, square)
    squares = values[FREQUENCY] ** 2, values[FREQUENCY_2] ** 2
    out = np.empty((1 + PARAMETERS, len(at)))
    out[0] = own + second + shared
    for k, (density, frequency, damping, load) in enumerate(
        ((own, FREQUENCY, DAMPING, LOAD), (second, FREQUENCY_2, DAMPING_2, LOAD_2))
    ):
        by_frequency, by_damping = _response_slopes(values[frequency], values[damping], square)
        turned = 2.0 * common * squares[k] * (squares[1 - k] - square)
        out[1 + frequency] = (density + shared) * by_frequency + turned + resisted
        out[1 + damping] = (density + shared) * by_damping + resisted
        out[1 + load] = density + 0.5 * shared
    at_first, at_second = reference_hz**2, squares[1]
    for which in (CORNER_1, CORNER_2):
        corner = values[which] ** 2
        falls = 2.0 * square / (corner + square)
        first, other = 2.0 * at_first / (corner + at_first), 2.0 * at_second / (corner + at_second)
        out[1 + which] = own * (falls - first) + second * (falls - other) + shared * (falls - 0.5 * (first + other))
        out[1 + FREQUENCY_2] += (second + 0.5 * shared) * other
    out[1 + COHERENCE] = (1.0 - coherence**2) * joint
    return out


@compiled
def _response_slopes(frequency_hz: float, damping: float, square: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the logarithm of ``|H|^2`` by those of frequency and damping."""
    own = frequency_hz**2
    apart, resisted = own - square, 4.0 * damping**2 * own * square
    size = apart**2 + resisted
    by_frequency: Floats = -(4.0 * own * apart + 2.0 * resisted) / size
    by_damping: Floats = -2.0 * resisted / size
    return by_frequency, by_damping


@compiled
def _size(frequency_hz: float, damping: float, square: Floats) -> Floats:
    """``|f0^2 - f^2 + 2 i zeta f0 f|^2``."""
    own = frequency_hz**2
    size: Floats = (own - square) ** 2 + 4.0 * damping**2 * own * square
    return size
