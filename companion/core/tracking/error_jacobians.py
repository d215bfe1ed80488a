"""Jacobian of the measurement rows with respect to the sensors' errors: the filter's sensitivity columns.

A sensor with scale errors ``k`` (per axis), misalignment ``m`` (small rotation vector) and stamp error ``tau`` reads
``(1 + k) (f - m x f)(t - tau)``, and likewise for the rate. The biases of the root's rates change the rest wing's
centripetal force ``w x (w x r)``: in a roll of 0.6 rad/s a milliradian per second is a tenth of a milliradian of slope.

The measured values stand in for the true ones (errors in variables). The bias that this regression on the measurement's
own noise would have is removed by :class:`companion.core.tracking.filter.SeparatedBiasFilter`, which takes the
innovation out again wherever :func:`measured_regressors` says that it is in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.states import P_LEFT, P_ROOT, ROOT_ERRORS, ROWS, SENSOR_ERRORS, Y_LEFT, Z_LEFT, StateLayout
from companion.records import Bools, Floats, Ints

_PLACES = ("root", "left", "right")
_ERRORS = (*SENSOR_ERRORS, *ROOT_ERRORS)
_KZ, _KY, _KP, _MX, _MY, _MZ, _TAU, _BP, _BR = range(len(_ERRORS))
EARLIER = 3  # chosen, epochs: past the root's smoothing over three, and most of what the roll rate's estimate remembers
_Z, _Y, _P, _P0 = Z_LEFT, Y_LEFT, P_LEFT, P_ROOT


class SensedMotion(NamedTuple):
    """Epoch averages of everything sensed, body axes; ``d_`` their time derivatives.

    Attributes
    ----------
    tip, d_tip : (n, 2, 6) float64
        Specific force (m/s^2) and rate (rad/s) as the tips sense them.
    moment : (n, 2) float64
        First moment of the tips' vertical axis.
    rigid : (n, 2, 3) float64
        Specific force of the rest wing at the tips, without the lift of the roll acceleration.
    d_rigid_z : (n, 2) float64
    f_root, d_root, omega, omega_dot : (n, 3) float64
        Root specific force and its derivative, body rate and its derivative.
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
    omega_dot: Floats
    levers_m: Floats


@compiled
def central_difference(values: Floats, step_s: float, present: Bools) -> Floats:
    """Central difference along the first axis; zero at the ends of the run and beside absent epochs."""
    out = np.zeros_like(values)
    for k in range(1, len(values) - 1):
        if present[k - 1] and present[k + 1]:
            out[k] = (values[k + 1] - values[k - 1]) / (2.0 * step_s)
    return out


def error_columns(layout: StateLayout) -> Ints:
    """Column of each error (``SENSOR_ERRORS``, ``ROOT_ERRORS``) of root, left and right, (3, 9); -1 where absent."""
    index = {name: at for at, name in enumerate(layout.bias_parameters)}
    return np.array([[index.get(f"{place}.{error}", -1) for error in _ERRORS] for place in _PLACES], np.int64)


@compiled
def sensitivities(motion: SensedMotion, gains: Floats, present: Bools, columns: Ints, count: int) -> Floats:
    """Jacobian of the rows with respect to the bias parameters.

    Parameters
    ----------
    motion : SensedMotion
        Averages and derivatives.
    gains : (n, 2) float64
        ``Epochs.lateral_gain``.
    present : (n, 9) bool
        Rows that were measured.
    columns : (3, 9) int64
        From :func:`error_columns`.
    count : int
        Number of bias parameters c.

    Returns
    -------
    (n, 9, c) float64
        Zero for absent rows.
    """
    out = np.zeros((len(present), ROWS, count))
    for side in range(2):
        _tip_errors(out, motion, side, gains[:, side], columns[1 + side])
        _root_errors(out, motion, side, gains[:, side], columns[0])
    _roll_errors(out, motion, columns[0])
    for k in range(len(present)):
        for row in range(ROWS):
            if not present[k, row]:
                out[k, row] = 0.0
    return out


def measured_regressors(layout: StateLayout) -> list[tuple[int, int, int, float]]:
    """Row, column, source row and sign of the sensitivities that contain the measurement of a source row.

    A tip's roll rate contains the rigid one, measured by the root: see ``_earlier_less_present_roll``.
    """
    regressors: list[tuple[int, int, int, float]] = []
    for side, place in ((0, "left"), (1, "right")):
        z, y, p = _Z + side, _Y + side, _P + side
        for error, row, source, sign in (
            ("kz", z, z, 1.0),
            ("kz", y, y, -1.0),
            ("ky", y, y, 1.0),
            ("kp", p, p, 1.0),
            ("kp", p, _P0, -1.0),
        ):
            column = layout.column(f"{place}.{error}")
            if column is not None:
                regressors.append((row, column, source, sign))
    column = layout.column("root.kp")
    return [*regressors, (_P0, column, _P0, 1.0)] if column is not None else regressors


@compiled
def _set_column(out: Floats, row: int, column: int, values: Floats) -> None:
    """Set one sensitivity over all epochs, if the parameter exists."""
    if column >= 0:
        out[:, row, column] = values


@compiled
def _tip_errors(out: Floats, motion: SensedMotion, side: int, gain: Floats, columns: Ints) -> None:
    """Columns of a tip's scale, misalignment and stamp errors."""
    tip, rate = motion.tip[:, side], motion.d_tip[:, side]
    x, y, z, p, q, r = tip[:, 0], tip[:, 1], tip[:, 2], tip[:, 3], tip[:, 4], tip[:, 5]
    dy, dz, dp = rate[:, 1], rate[:, 2], rate[:, 3]
    vertical, lateral, roll = _Z + side, _Y + side, _P + side
    scaled_y, scaled_z = _with_earlier_rigid(motion, side, 1), _with_earlier_rigid(motion, side, 2)
    _set_column(out, vertical, columns[_KZ], scaled_z)
    _set_column(out, lateral, columns[_KZ], -scaled_y * gain)
    _set_column(out, lateral, columns[_KY], scaled_y * gain)
    _set_column(out, roll, columns[_KP], p + _earlier_less_present_roll(motion))
    _set_column(out, vertical, columns[_MX], -y)
    _set_column(out, lateral, columns[_MX], z * gain)
    _set_column(out, vertical, columns[_MY], x)
    _set_column(out, roll, columns[_MY], -r)
    _set_column(out, lateral, columns[_MZ], -x * gain)
    _set_column(out, roll, columns[_MZ], q)
    _set_column(out, vertical, columns[_TAU], -dz)
    _set_column(out, lateral, columns[_TAU], -(dy - y * dz * np.abs(gain) * np.sign(z)) * gain)
    _set_column(out, roll, columns[_TAU], -dp)


@compiled
def _with_earlier_rigid(motion: SensedMotion, side: int, axis: int) -> Floats:
    """Specific force of a tip whose rigid part is that of some epochs earlier, (n,).

    The filter takes the innovation of the row, tip less rigid force, out of the regressor. The root's noise, which is
    in that innovation, must then be in the regressor too, or the innovation is regressed on its own root noise: slope
    factors grew and lateral and roll rate scales shrank by 2 % together.
    """
    tip, rigid = motion.tip[:, side, axis], motion.rigid[:, side, axis]
    out = tip.copy()
    out[EARLIER:] += rigid[:-EARLIER] - rigid[EARLIER:]
    return out


@compiled
def _earlier_less_present_roll(motion: SensedMotion) -> Floats:
    """Rigid roll rate as the root measured it some epochs earlier, less the present measurement, (n,).

    The innovations of tip and root are taken out of the regressor: bending rate and earlier roll rate are left. The
    state's roll rate is as noisy as 3 rad/s^2 of roll acceleration allow, which few aircraft have: on that noise,
    which the innovations are full of, no scale may be regressed.
    """
    p = motion.omega[:, 0]
    out = np.zeros(len(p))
    out[EARLIER:] = p[:-EARLIER] - p[EARLIER:]
    return out


@compiled
def _root_errors(out: Floats, motion: SensedMotion, side: int, gain: Floats, columns: Ints) -> None:
    """Columns of the root's scale, misalignment and stamp errors in one tip's rows."""
    force = _one_epoch_earlier(motion.f_root)
    x, y, z = force[:, 0], force[:, 1], force[:, 2]
    p, lever = motion.omega[:, 0], motion.levers_m[side, 1]
    vertical, lateral = _Z + side, _Y + side
    _set_column(out, vertical, columns[_KZ], -z)
    _set_column(out, lateral, columns[_KY], -y * gain)
    _set_column(out, lateral, columns[_KP], 2.0 * lever * p**2 * gain)
    _set_column(out, vertical, columns[_MX], y)
    _set_column(out, lateral, columns[_MX], -z * gain)
    _set_column(out, vertical, columns[_MY], -x)
    _set_column(out, lateral, columns[_MZ], x * gain)
    _set_column(out, vertical, columns[_TAU], motion.d_root[:, 2])
    _set_column(out, lateral, columns[_TAU], motion.d_root[:, 1] * gain)
    _root_biases(out, motion, side, gain, columns)


@compiled
def _root_biases(out: Floats, motion: SensedMotion, side: int, gain: Floats, columns: Ints) -> None:
    """Columns of the biases of the root's rates, through the centripetal force."""
    p, q, r = motion.omega[:, 0], motion.omega[:, 1], motion.omega[:, 2]
    ahead, aside, below = motion.levers_m[side]
    vertical, lateral = _Z + side, _Y + side
    _set_column(out, vertical, columns[_BP], 2.0 * below * p - ahead * r)
    _set_column(out, lateral, columns[_BP], (2.0 * aside * p - ahead * q) * gain)
    _set_column(out, vertical, columns[_BR], -(ahead * p + aside * q))
    _set_column(out, lateral, columns[_BR], (2.0 * aside * r - below * q) * gain)


@compiled
def _one_epoch_earlier(values: Floats) -> Floats:
    """Values one epoch earlier, so that the root's noise is uncorrelated with the innovations they multiply."""
    out = values.copy()
    out[1:] = values[:-1]
    return out


@compiled
def _roll_errors(out: Floats, motion: SensedMotion, columns: Ints) -> None:
    """Columns of the root's errors in its roll-rate row."""
    p, q, r = motion.omega[:, 0], motion.omega[:, 1], motion.omega[:, 2]
    _set_column(out, _P0, columns[_KP], p)
    _set_column(out, _P0, columns[_MY], -r)
    _set_column(out, _P0, columns[_MZ], q)
    _set_column(out, _P0, columns[_TAU], -motion.omega_dot[:, 0])
