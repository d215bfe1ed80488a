"""How each constant sensor error shows in each row: the columns that the filter carries beside the state.

A sensor with scale errors ``k`` (per axis), misalignment ``m`` (small rotation vector) and stamp error ``tau`` reads
``(1 + k) (f - m x f)(t - tau)``, and likewise for the rate. What the root's rates have as bias turns the rest wing's
centripetal force ``w x (w x r)``: in a roll of 0.6 rad/s a milliradian per second is a tenth of a milliradian of slope.

The measured values stand in for the true ones; what that would do to the estimate (a regression on its own noise
shrinks everything) is undone by :class:`companion.core.tracking.filter.Kalman`, which takes the innovation out again
wherever :func:`own_scales` says that it is in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.states import P_LEFT, P_ROOT, ROOT_ERRORS, ROWS, SENSOR_ERRORS, Y_LEFT, Z_LEFT, Layout
from companion.records import Bools, Floats, Ints

_PLACES = ("root", "left", "right")
_ERRORS = (*SENSOR_ERRORS, *ROOT_ERRORS)
_KZ, _KY, _KP, _MX, _MY, _MZ, _TAU, _BP, _BR = range(len(_ERRORS))
_Z, _Y, _P, _P0 = Z_LEFT, Y_LEFT, P_LEFT, P_ROOT


class Motion(NamedTuple):
    """Cell averages of everything sensed, body axes; ``d_`` their time derivatives.

    Attributes
    ----------
    tip, d_tip : (n, 2, 6) float64
        Specific force and rate as the tips sense them.
    moment : (n, 2) float64
        First moment of the tips' vertical axis.
    rigid : (n, 2, 3) float64
        Specific force of the rest wing at the tips, without the lift of the roll acceleration.
    d_rigid_z : (n, 2) float64
    f_root, d_root, omega, turn : (n, 3) float64
        Root specific force, body rate and its time derivative.
    levers_m : (2, 3) float64
        From root to tips.
    """

    step_s: float
    tip: Floats
    moment: Floats
    d_tip: Floats
    rigid: Floats
    d_rigid_z: Floats
    f_root: Floats
    d_root: Floats
    omega: Floats
    turn: Floats
    levers_m: Floats


@compiled
def rate_of_change(values: Floats, step_s: float, there: Bools) -> Floats:
    """Central difference along the first axis; zero at the ends of the run and beside what is not there."""
    out = np.zeros_like(values)
    for k in range(1, len(values) - 1):
        if there[k - 1] and there[k + 1]:
            out[k] = (values[k + 1] - values[k - 1]) / (2.0 * step_s)
    return out


def columns_of(layout: Layout) -> Ints:
    """Column of each error (``SENSOR_ERRORS``, ``ROOT_ERRORS``) of root, left and right; -1 where there is none."""
    index = {name: at for at, name in enumerate(layout.constants)}
    return np.array([[index.get(f"{place}.{error}", -1) for error in _ERRORS] for place in _PLACES], np.int64)


@compiled
def sensitivities(motion: Motion, gains: Floats, there: Bools, where: Ints, count: int) -> Floats:
    """Derivative of the rows by the ``count`` constants, (n, 9, count).

    ``gains`` as ``Cells.lateral_gain``, ``where`` from :func:`columns_of`.
    """
    out = np.zeros((len(there), ROWS, count))
    for side in range(2):
        _tip_errors(out, motion, side, gains[:, side], where[1 + side])
        _root_errors(out, motion, side, gains[:, side], where[0])
    _roll_errors(out, motion, where[0])
    for k in range(len(there)):
        for row in range(ROWS):
            if not there[k, row]:
                out[k, row] = 0.0
    return out


def own_scales(layout: Layout) -> list[tuple[int, int, float]]:
    """Rows and columns in which a sensitivity holds the row's own measurement, with its sign."""
    found = []
    for side, place in ((0, "left"), (1, "right")):
        for error, row, sign in (("kz", Z_LEFT, 1.0), ("kz", Y_LEFT, -1.0), ("ky", Y_LEFT, 1.0), ("kp", P_LEFT, 1.0)):
            column = layout.column(f"{place}.{error}")
            if column is not None:
                found.append((row + side, column, sign))
    column = layout.column("root.kp")
    return [*found, (P_ROOT, column, 1.0)] if column is not None else found


@compiled
def _put(out: Floats, row: int, column: int, values: Floats) -> None:
    if column >= 0:
        out[:, row, column] = values


@compiled
def _tip_errors(out: Floats, motion: Motion, side: int, gain: Floats, where: Ints) -> None:
    own, rate = motion.tip[:, side], motion.d_tip[:, side]
    x, y, z, p, q, r = own[:, 0], own[:, 1], own[:, 2], own[:, 3], own[:, 4], own[:, 5]
    dy, dz, dp = rate[:, 1], rate[:, 2], rate[:, 3]
    vertical, lateral, roll = _Z + side, _Y + side, _P + side
    _put(out, vertical, where[_KZ], z)
    _put(out, lateral, where[_KZ], -y * gain)
    _put(out, lateral, where[_KY], y * gain)
    _put(out, roll, where[_KP], p)
    _put(out, vertical, where[_MX], -y)
    _put(out, lateral, where[_MX], z * gain)
    _put(out, vertical, where[_MY], x)
    _put(out, roll, where[_MY], -r)
    _put(out, lateral, where[_MZ], -x * gain)
    _put(out, roll, where[_MZ], q)
    _put(out, vertical, where[_TAU], -dz)
    _put(out, lateral, where[_TAU], -(dy - y * dz * np.abs(gain) * np.sign(z)) * gain)
    _put(out, roll, where[_TAU], -dp)


@compiled
def _root_errors(out: Floats, motion: Motion, side: int, gain: Floats, where: Ints) -> None:
    force = _before(motion.f_root)
    x, y, z = force[:, 0], force[:, 1], force[:, 2]
    p, lever = motion.omega[:, 0], motion.levers_m[side, 1]
    vertical, lateral = _Z + side, _Y + side
    _put(out, vertical, where[_KZ], -z)
    _put(out, lateral, where[_KY], -y * gain)
    _put(out, lateral, where[_KP], 2.0 * lever * p**2 * gain)
    _put(out, vertical, where[_MX], y)
    _put(out, lateral, where[_MX], -z * gain)
    _put(out, vertical, where[_MY], -x)
    _put(out, lateral, where[_MZ], x * gain)
    _put(out, vertical, where[_TAU], motion.d_root[:, 2])
    _put(out, lateral, where[_TAU], motion.d_root[:, 1] * gain)
    _root_biases(out, motion, side, gain, where)


@compiled
def _root_biases(out: Floats, motion: Motion, side: int, gain: Floats, where: Ints) -> None:
    p, q, r = motion.omega[:, 0], motion.omega[:, 1], motion.omega[:, 2]
    ahead, aside, below = motion.levers_m[side]
    vertical, lateral = _Z + side, _Y + side
    _put(out, vertical, where[_BP], 2.0 * below * p - ahead * r)
    _put(out, lateral, where[_BP], (2.0 * aside * p - ahead * q) * gain)
    _put(out, vertical, where[_BR], -(ahead * p + aside * q))
    _put(out, lateral, where[_BR], (2.0 * aside * r - below * q) * gain)


@compiled
def _before(values: Floats) -> Floats:
    """The same one cell earlier: noise of the root must not meet itself in the innovations that it is held against."""
    out = values.copy()
    out[1:] = values[:-1]
    return out


@compiled
def _roll_errors(out: Floats, motion: Motion, where: Ints) -> None:
    p, q, r = motion.omega[:, 0], motion.omega[:, 1], motion.omega[:, 2]
    _put(out, _P0, where[_KP], p)
    _put(out, _P0, where[_MY], -r)
    _put(out, _P0, where[_MZ], q)
    _put(out, _P0, where[_TAU], -motion.turn[:, 0])
