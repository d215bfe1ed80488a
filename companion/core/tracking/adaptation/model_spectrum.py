"""One-sided spectrum of the averaged vertical acceleration of one family, given its parameters.

With ``a_k = f_k^2 - f^2``, ``b_k = 2 zeta_k f_k f`` and ``|H_k|^2 = f^4 / (a_k^2 + b_k^2)``, mode k under its load
``L_k`` gives ``L_k |H_k|^2``, and a pair of modes whose loads have correlation ``c_j c_k`` (``c`` of the first is 1)

    2 c_j c_k sqrt(L_j L_k) Re(H_j H_k*),    Re(H_j H_k*) = f^4 (a_j a_k + b_j b_k) / ((a_j^2 + b_j^2) (a_k^2 + b_k^2))
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

from companion.core.tracking.parameters import CORNER_1, CORNER_2, LOAD
from companion.records import Floats, Ints

_Real = TypeVar("_Real", float, Floats)
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


def load_density(values: Floats, square: _Real, reference_hz: float) -> _Real:
    """Density of the first mode's load, (m/s^2)^2/Hz, at squared frequencies (n,) or one; ``values`` (5 or more,).

    The values are those of ``parameters``; two real poles, scaled to the load at the reference frequency.
    """
    inverse_1, inverse_2 = 1.0 / values[CORNER_1] ** 2, 1.0 / values[CORNER_2] ** 2
    at_reference = (1.0 + reference_hz**2 * inverse_1) * (1.0 + reference_hz**2 * inverse_2)
    density: _Real = values[LOAD] * at_reference / ((1.0 + square * inverse_1) * (1.0 + square * inverse_2))
    return density
