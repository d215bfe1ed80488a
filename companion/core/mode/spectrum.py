"""The one-sided spectrum that the averaged vertical acceleration of one family must have, given its parameters."""

from __future__ import annotations

import numpy as np

from companion.core.compiled import compiled
from companion.core.mode.parameters import SECOND_CORNER
from companion.records import Floats

_COARSE = 24


@compiled
def load_density(values: Floats, square: Floats, reference_hz: float) -> Floats:
    """Density of the gust load, (m/s^2)^2/Hz, at squared frequencies; ``values`` as in ``core.mode.parameters``."""
    load, corner_1, corner_2 = values[2], values[3], values[4]
    shape_at = (1.0 + (reference_hz / corner_1) ** 2) * (1.0 + (reference_hz / corner_2) ** 2)
    density: Floats = load * shape_at / ((1.0 + square / corner_1**2) * (1.0 + square / corner_2**2))
    return density


@compiled
def acceleration_density(logs: Floats, frequency_hz: Floats, reference_hz: float, step_s: float) -> Floats:
    """Density of the tip's acceleration as averaged over cells of ``step_s``, aliases included.

    ``|f^2 / (f0^2 - f^2 + 2 i zeta f0 f)|^2`` of each mode times its load, times the cell's ``sinc^2``. Far above the
    modes the tip is a free mass: that part comes back by aliasing, and is smooth, so it is worked out on few points.
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
    square = at**2
    own = _response(values[0], values[1], square) * load_density(values, square, reference_hz)
    corner = (SECOND_CORNER * values[5]) ** 2
    second = _response(values[5], values[6], square) * values[7] * (values[5] ** 2 + corner) / (square + corner)
    turn = np.pi * step_s * at
    density: Floats = (own + second) * (np.sin(turn) / turn) ** 2
    return density


@compiled
def acceleration_slopes(logs: Floats, frequency_hz: Floats, reference_hz: float, step_s: float) -> Floats:
    """:func:`acceleration_density` and its derivatives by the eight logarithms: (9, n)."""
    values = np.exp(logs)
    total = _folded_slopes(values, frequency_hz, reference_hz, step_s)
    coarse = np.linspace(frequency_hz[0], frequency_hz[-1], _COARSE)
    aliased = np.zeros((9, _COARSE))
    for turns in (-2, -1, 1, 2):
        aliased += _folded_slopes(values, coarse + turns / step_s, reference_hz, step_s)
    place = (frequency_hz - coarse[0]) / (coarse[1] - coarse[0])
    before = np.minimum(place, _COARSE - 2.0).astype(np.int64)
    share = place - before
    for row in range(9):
        total[row] += (1.0 - share) * aliased[row][before] + share * aliased[row][before + 1]
    return total


@compiled
def _folded_slopes(values: Floats, at: Floats, reference_hz: float, step_s: float) -> Floats:
    square = at**2
    turn = np.pi * step_s * at
    cell = (np.sin(turn) / turn) ** 2
    corner = (SECOND_CORNER * values[5]) ** 2
    own = cell * _response(values[0], values[1], square) * load_density(values, square, reference_hz)
    second = cell * _response(values[5], values[6], square) * values[7] * (values[5] ** 2 + corner) / (square + corner)
    out = np.empty((9, len(at)))
    out[0] = own + second
    by_frequency, by_damping = _response_slopes(values[0], values[1], square)
    out[1], out[2], out[3] = own * by_frequency, own * by_damping, own
    for row, corner_hz in ((4, values[3]), (5, values[4])):
        here, there = square / corner_hz**2, (reference_hz / corner_hz) ** 2
        out[row] = own * 2.0 * (here / (1.0 + here) - there / (1.0 + there))
    by_frequency, by_damping = _response_slopes(values[5], values[6], square)
    out[6] = second * (by_frequency + 2.0 * square / (square + corner))
    out[7], out[8] = second * by_damping, second
    return out


@compiled
def _response_slopes(frequency_hz: float, damping: float, square: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the logarithm of :func:`_response` by those of frequency and damping."""
    own = frequency_hz**2
    apart, resisted = own - square, 4.0 * damping**2 * own * square
    size = apart**2 + resisted
    by_frequency: Floats = -(4.0 * own * apart + 2.0 * resisted) / size
    by_damping: Floats = -2.0 * resisted / size
    return by_frequency, by_damping


@compiled
def _response(frequency_hz: float, damping: float, square: Floats) -> Floats:
    own = frequency_hz**2
    response: Floats = square**2 / ((own - square) ** 2 + 4.0 * damping**2 * own * square)
    return response
