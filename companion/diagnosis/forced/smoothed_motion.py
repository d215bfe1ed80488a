"""Likeliest deflection of an oscillator of given coefficients, by its force and its noisy response together.

It minimises sum (y - H q)^2/var e + sum (u + u_0 - m q'' - c q' - k q - sum theta_j f_j)^2/var n over the samples of q
and a constant u_0 (the sensor's zero), by Gauss and Newton. Derivatives are central differences of fourth order, so
that the normal matrix has nine diagonals. Where the force has no noise, q is the solution of the equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from companion.diagnosis.forced.equation_rows import LAWS, law_slopes
from companion.records import Floats, Ints

_STEPS = 12  # chosen, at most at one variance: two to five settle
_SETTLED = 1e-4  # chosen: last step over the deflection, both rms: the next is its square
_WILD = 2.0  # chosen: a step over the deflection, both rms, from which a start is too far away
_CALMER = 0.1  # chosen: of the variance of the force's noise from one settled deflection to the next
_REACH = 2  # derived: neighbours on either side of a central difference of fourth order
_PLACE = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
_SLOPE = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0  # derived: first and second difference of fourth order
_BEND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0


@dataclass(frozen=True, slots=True)
class Observed:
    """Force (n,) at steps of ``step_s``; response (o,), a derivative of order ``kind`` at the places ``at`` (o,)."""

    force: Floats
    step_s: float
    response: Floats
    at: Ints
    kind: int


@dataclass(frozen=True, slots=True)
class Smoothed:
    """Deflection (n,), and the variance of the force's noise down to which it settles."""

    deflection: Floats
    var_n: float


def smoothed(observed: Observed, start: Smoothed, linear: Floats, laws: Floats, var_e: float, var_n: float) -> Smoothed:
    """Likeliest deflection (n,) of mass, damping and stiffness (3,) and laws' coefficients (laws,).

    ``var_e`` and ``var_n`` are the variances of a sample of response and force. The latter falls step by step from that
    of the start. Where coefficients are wrong, small ones do not settle, and the last deflection that did is returned.

    Raises
    ------
    LinAlgError
        The normal matrix is singular.
    """
    smoother = _Smoother(observed, start.deflection, linear, laws, var_e)
    settled, assumed = start, max(start.var_n, var_n)
    while True:
        q = smoother.settle(settled.deflection, assumed)
        if q is None:
            return settled
        settled = Smoothed(q, assumed)
        if assumed <= var_n:
            return settled
        assumed = max(_CALMER * assumed, var_n)


class _Smoother:
    """Steps of Gauss and Newton at any variance of the force's noise."""

    def __init__(self, observed: Observed, start: Floats, linear: Floats, laws: Floats, var_e: float) -> None:
        self._rate, bend = _SLOPE / observed.step_s, _BEND / observed.step_s**2
        self._observe = (_PLACE, self._rate, bend)[observed.kind]
        self._y, self._weight = np.zeros((2, len(start)))
        self._y[observed.at], self._weight[observed.at] = observed.response, 1.0 / var_e
        self._y, self._weight = self._y[_REACH:-_REACH], self._weight[_REACH:-_REACH]
        self._force = observed.force[_REACH:-_REACH]
        self._linear = linear[0] * bend + linear[1] * self._rate + linear[2] * _PLACE
        ends = np.zeros(len(start))  # the first and last samples, which few differences reach, stay near their start
        ends[: 2 * _REACH] = ends[-2 * _REACH :] = 1.0 / float(np.var(start))
        self._start, self._ends, self._laws = start, ends, laws
        self._ordinary = _normal(self._observe, self._weight)
        self._ordinary[-1] += ends

    def settle(self, q: Floats, var_n: float) -> Floats | None:
        """Deflection (n,) after as many steps as it moves, None: it moves on."""
        usual = float(np.std(q))
        for _ in range(_STEPS):
            moved = self._step(q, var_n)
            size = float(np.std(moved))
            if not size < _WILD * usual:
                return None
            q = q + moved
            if size < _SETTLED * usual:
                return q
        return None

    def _step(self, q: Floats, var_n: float) -> Floats:
        """Change (n,) of a deflection, with the sensor's zero at its best."""
        motion = q[_REACH:-_REACH], _differenced(self._rate, q)
        stiff, damp = np.tensordot(self._laws, law_slopes(*motion), (0, 1))
        bends = self._laws @ np.stack([law(*motion) for _, law in LAWS.values()])
        left = self._force - _differenced(self._linear, q) - bends
        slope = self._linear[:, None] + np.outer(_PLACE, stiff) + np.outer(self._rate, damp)
        weight = np.full(len(left), 1.0 / var_n)
        upper = _normal(slope, weight) + self._ordinary
        missed = self._weight * (self._y - _differenced(self._observe, q))
        gradient = _transposed(slope, weight * left) + _transposed(self._observe, missed)
        gradient += self._ends * (self._start - q)
        beside = -_transposed(slope, weight)
        moved, by_zero = solveh_banded(upper, np.stack([gradient, beside], 1)).T
        zero = -(left.sum() / var_n + beside @ moved) / (len(left) / var_n - beside @ by_zero)
        return np.asarray(moved - zero * by_zero)


def _differenced(stencil: Floats, q: Floats) -> Floats:
    """Differences (n - 4,) of series (n,) by one stencil (5,) or by one for each of them (5, n - 4)."""
    inner = len(q) - 2 * _REACH
    return np.asarray(sum(factor * q[place : place + inner] for place, factor in enumerate(stencil)))


def _transposed(stencil: Floats, values: Floats) -> Floats:
    """Product (n,) of the transpose of such differences and values (n - 4,)."""
    product = np.zeros(len(values) + 2 * _REACH)
    for place, factor in enumerate(stencil):
        product[place : place + len(values)] += factor * values
    return product


def _normal(stencil: Floats, weight: Floats) -> Floats:
    """Upper diagonals (5, n), as LAPACK wants them, of D^T W D for differences D and weights (n - 4,)."""
    upper = np.zeros((2 * _REACH + 1, len(weight) + 2 * _REACH))
    for column, factor in enumerate(stencil):
        weighted = factor * weight
        for row in range(column + 1):
            upper[2 * _REACH - column + row, column : column + len(weight)] += stencil[row] * weighted
    return upper
