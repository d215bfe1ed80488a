"""Likeliest deflection of an oscillator of given coefficients, by its force and its noisy response together.

It minimises sum (y - H q)^2/var e + sum (u + u_0 - m q'' - c q' - k q - sum theta_j f_j)^2/var n over the samples of q
and a constant u_0 (the sensor's zero), by Gauss and Newton. Derivatives are central differences of fourth order, so
that the normal matrix has nine diagonals. Where the force has no noise, q is the solution of the equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.linalg import solveh_banded

from companion.diagnosis.forced.equation_rows import LAWS, law_slopes
from companion.records import Floats

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
    at: npt.NDArray[np.int64]
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
        count = len(start)
        self._inner, self._rate = _stencil(_PLACE, count), _stencil(_SLOPE / observed.step_s, count)
        bent = _stencil(_BEND / observed.step_s**2, count)
        within = (observed.at >= _REACH) & (observed.at < count - _REACH)
        self._observe = (self._inner, self._rate, bent)[observed.kind][observed.at[within] - _REACH]
        self._y, self._force = observed.response[within], observed.force[_REACH:-_REACH]
        self._linear = linear[0] * bent + linear[1] * self._rate + linear[2] * self._inner
        ends = np.zeros(count)  # the first and last samples, which few differences reach, stay near their start
        ends[: 2 * _REACH] = ends[-2 * _REACH :] = 1.0 / float(np.var(start))
        self._start, self._ends, self._laws, self._var_e = start, ends, laws, var_e
        self._ordinary = (self._observe.T @ self._observe) / var_e + sp.diags_array(ends)

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
        motion = q[_REACH:-_REACH], self._rate @ q
        stiff, damp = np.tensordot(self._laws, law_slopes(*motion), (0, 1))
        bends = self._laws @ np.stack([law(*motion) for _, law in LAWS.values()])
        left = self._force - self._linear @ q - bends
        slope = self._linear + self._inner.multiply(stiff[:, None]) + self._rate.multiply(damp[:, None])
        normal = (slope.T @ slope) / var_n + self._ordinary
        upper = np.zeros((2 * _REACH + 1, len(q)))
        for offset in range(2 * _REACH + 1):
            upper[2 * _REACH - offset, offset:] = normal.diagonal(offset)
        to_start = self._ends * (self._start - q)
        gradient = (slope.T @ left) / var_n + self._observe.T @ (self._y - self._observe @ q) / self._var_e + to_start
        beside = -np.asarray(slope.sum(axis=0)).ravel() / var_n
        moved, by_zero = solveh_banded(upper, np.stack([gradient, beside], 1)).T
        zero = -(left.sum() / var_n + beside @ moved) / (len(left) / var_n - beside @ by_zero)
        return np.asarray(moved - zero * by_zero)


def _stencil(row: Floats, count: int) -> sp.csr_array:
    inner = count - 2 * _REACH
    return sp.diags_array(
        np.repeat(row[:, None], inner, axis=1), offsets=list(range(2 * _REACH + 1)), shape=(inner, count)
    ).tocsr()
