"""Modes of a whole aircraft that nothing holds: a tapered beam through the fuselage, by Hermite elements.

Nodes have deflection (up) and slope (positive where the right side rises); the fuselage is mass and roll inertia at the
middle node, a pod of camera and sensor node sits near each tip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

Array = NDArray[np.float64]
SEMISPAN_M = 1.25
CAMERA_M = 1.17
ELEMENTS = 12  # of a wing half
FAMILY = 4  # elastic modes of each symmetry
_FIRST_HZ = 4.6
_MASS_KGPM, _STIFFNESS_TAPER, _MASS_TAPER = 0.45, 0.6, 0.55
_POD_KG, _FUSELAGE_KG, _ROLL_INERTIA_KGM2 = 0.09, 5.2, 2.2


@dataclass(frozen=True)
class Modes:
    """Elastic modes, symmetric and antisymmetric in turn, per metre of the right tip against the turned fuselage.

    Attributes
    ----------
    frequency_hz, mass_kg : (n,)
    symmetric : (n,)
        True for a mode that lifts both tips.
    tip : (2, n)
        Left and right tip against the fuselage: 1 and 1, or -1 and 1.
    tip_free : (2, n)
        The same against the ground.
    slope_radpm : (2, n)
        Up-bend slope of either camera's station against the fuselage.
    heave, roll_radpm : (n,)
        What the fuselage moves.
    gust : (2, n)
        Share of a load that is spread over the left or right half.
    crosswise : (n, n)
        Stiffness that a right half stiffer by 1 and a left half softer by 1 adds, (rad/s)^2.
    """

    frequency_hz: Array
    mass_kg: Array
    symmetric: NDArray[np.bool_]
    tip: Array
    tip_free: Array
    slope_radpm: Array
    heave: Array
    roll_radpm: Array
    gust: Array
    crosswise: Array


def modes() -> Modes:
    """The aircraft as it is designed; its first symmetric mode is at 4.6 Hz."""
    y = np.linspace(-SEMISPAN_M, SEMISPAN_M, 2 * ELEMENTS + 1)
    left, right, mass = _assembled(y)
    stiffness = left + right
    squares, shapes = eigh(stiffness, mass)
    elastic = slice(2, 2 + 2 * FAMILY)
    squares, shapes = squares[elastic], shapes[:, elastic]
    w, slope, middle = shapes[0::2], shapes[1::2], ELEMENTS
    heave, roll = w[middle], slope[middle]
    relative = w - heave - np.outer(y, roll)
    unit = relative[-1]
    against = np.sign(relative[0]) != np.sign(unit)
    order = np.argsort(2 * _rank(against) + against)
    camera = [np.interp(sign * CAMERA_M, y, np.arange(len(y))) for sign in (-1.0, 1.0)]
    slopes = np.stack([-_between(slope, camera[0]) + roll, _between(slope, camera[1]) - roll])
    spread = np.gradient(y) * np.sqrt(np.maximum(1.0 - (y / SEMISPAN_M) ** 2, 0.0))
    gust = np.stack([(spread * (y < 0.0)) @ w, (spread * (y > 0.0)) @ w])
    scale = squares[0] / (2.0 * np.pi * _FIRST_HZ) ** 2
    masses = 1.0 / unit**2
    crosswise = shapes.T @ (right - left) @ shapes / np.outer(unit, unit) / scale / masses[:, None]
    return Modes(
        (np.sqrt(squares / scale) / (2.0 * np.pi))[order],
        masses[order],
        np.logical_not(against)[order],
        (relative[[0, -1]] / unit)[:, order],
        (w[[0, -1]] / unit)[:, order],
        (slopes / unit)[:, order],
        (heave / unit)[order],
        (roll / unit)[order],
        (gust / unit / masses)[:, order],
        crosswise[np.ix_(order, order)],
    )


def _rank(family: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Place of each mode in its family, by frequency."""
    return np.array([np.sum(family[:k] == family[k]) for k in range(len(family))])


def _between(values: Array, at: float) -> Array:
    below = int(at)
    return np.asarray(values[below] + (at - below) * (values[below + 1] - values[below]))


def _assembled(y: Array) -> tuple[Array, Array, Array]:
    """Stiffness of the left and of the right half, and mass; the bending stiffness is 1 N m^2 at the root."""
    size = 2 * len(y)
    left, right, mass = (np.zeros((size, size)) for _ in range(3))
    for i, length in enumerate(np.diff(y).tolist()):
        out = abs(0.5 * (y[i] + y[i + 1])) / SEMISPAN_M
        at = np.ix_(range(2 * i, 2 * i + 4), range(2 * i, 2 * i + 4))
        half = right if y[i] + y[i + 1] > 0.0 else left
        half[at] += (1.0 - _STIFFNESS_TAPER * out) ** 3 * _element_stiffness(length)
        mass[at] += _MASS_KGPM * (1.0 - _MASS_TAPER * out) * _element_mass(length)
    middle, pod = len(y) // 2, 1
    mass[2 * middle, 2 * middle] += _FUSELAGE_KG
    mass[2 * middle + 1, 2 * middle + 1] += _ROLL_INERTIA_KGM2
    for node in (pod, len(y) - 1 - pod):
        mass[2 * node, 2 * node] += _POD_KG
    return left, right, mass


def _element_stiffness(length: float) -> Array:
    a, b = 6.0 * length, length**2
    rows = [[12.0, a, -12.0, a], [a, 4.0 * b, -a, 2.0 * b], [-12.0, -a, 12.0, -a], [a, 2.0 * b, -a, 4.0 * b]]
    return np.array(rows) / length**3


def _element_mass(length: float) -> Array:
    a, b = length, length**2
    rows = [
        [156.0, 22.0 * a, 54.0, -13.0 * a],
        [22.0 * a, 4.0 * b, 13.0 * a, -3.0 * b],
        [54.0, 13.0 * a, 156.0, -22.0 * a],
        [-13.0 * a, -3.0 * b, -22.0 * a, 4.0 * b],
    ]
    return np.array(rows) * length / 420.0
