"""Jacobian of the rows by sensor errors in plain numpy: ``native/epochs.c``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.tracking.error_jacobians import AVERAGED, EARLIER
from companion.core.tracking.sensor_errors import ROOT_ERRORS, SENSOR_ERRORS
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT
from companion.records import Bools, Floats, Ints

_PLACES = {name: at for at, name in enumerate((*SENSOR_ERRORS, *ROOT_ERRORS))}
_KZ, _KY, _KP, _MX, _MY, _MZ, _TAU, _HEIGHT, _BP, _BR = (
    _PLACES[name] for name in ("kz", "ky", "kp", "mx", "my", "mz", "tau", "height", "bp", "br")
)


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
    root_present : (n,) bool
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
    root_present: Bools


def central_difference(values: Floats, step_s: float, present: Bools) -> Floats:
    """Central difference along the first axis; zero at the ends of the run and beside absent epochs."""
    out = np.zeros_like(values)
    for k in range(1, len(values) - 1):
        if present[k - 1] and present[k + 1]:
            out[k] = (values[k + 1] - values[k - 1]) / (2.0 * step_s)
    return out


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
    columns : (3, e) int64
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


def _set_column(out: Floats, row: int, column: int, values: Floats) -> None:
    """Set one sensitivity over all epochs, if the parameter exists."""
    if column >= 0:
        out[:, row, column] = values


def _tip_errors(out: Floats, motion: SensedMotion, side: int, gain: Floats, columns: Ints) -> None:
    """Columns of a tip's scale, misalignment and stamp errors."""
    tip, rate = motion.tip[:, side], motion.d_tip[:, side]
    y, z, p = tip[:, 1], tip[:, 2], tip[:, 3]
    dy, dz, dp = rate[:, 1], rate[:, 2], rate[:, 3]
    rigid, omega, omega_dot = (
        mean_before(each, motion.root_present) for each in (motion.rigid[:, side], motion.omega, motion.omega_dot)
    )
    vertical, lateral, roll = Z_LEFT + side, Y_LEFT + side, P_LEFT + side
    scaled_y, scaled_z = with_earlier_rigid(motion, side, 1), with_earlier_rigid(motion, side, 2)
    lean = y - motion.rigid[:, side, 1]
    _set_column(out, vertical, columns[_KZ], scaled_z)
    _set_column(out, M_LEFT + side, columns[_KZ], motion.moment[:, side])
    _set_column(out, lateral, columns[_KZ], -lean * gain)
    _set_column(out, lateral, columns[_KY], scaled_y * gain)
    _set_column(out, roll, columns[_KP], p + _earlier_less_present_roll(motion))
    _set_column(out, vertical, columns[_MX], -rigid[:, 1])
    _set_column(out, lateral, columns[_MX], z * gain)
    _set_column(out, vertical, columns[_MY], rigid[:, 0])
    _set_column(out, roll, columns[_MY], -omega[:, 2])
    _set_column(out, lateral, columns[_MZ], -rigid[:, 0] * gain)
    _set_column(out, roll, columns[_MZ], omega[:, 1])
    _set_column(out, vertical, columns[_HEIGHT], omega[:, 0] ** 2 + omega[:, 1] ** 2)
    _set_column(out, lateral, columns[_HEIGHT], (omega_dot[:, 0] - omega[:, 1] * omega[:, 2]) * gain)
    _set_column(out, vertical, columns[_TAU], -dz)
    _set_column(out, lateral, columns[_TAU], -(dy - lean * dz * np.abs(gain) * np.sign(z)) * gain)
    _set_column(out, roll, columns[_TAU], -dp)


def with_earlier_rigid(motion: SensedMotion, side: int, axis: int) -> Floats:
    """Specific force of a tip whose rigid part is the mean of some epochs before, (n,).

    The filter takes the innovation of the row, tip less rigid force, out of the regressor. The root's noise, which is
    in that innovation, must then be in the regressor too, or the innovation is regressed on its own root noise: slope
    factors grew and lateral and roll rate scales shrank by 2 % together.
    """
    tip, rigid = motion.tip[:, side, axis], motion.rigid[:, side, axis]
    return np.asarray(tip + mean_before(rigid[:, None], motion.root_present)[:, 0] - rigid)


def _earlier_less_present_roll(motion: SensedMotion) -> Floats:
    """Rigid roll rate as the root measured it some epochs earlier, less the present measurement, (n,).

    The innovations of tip and root are taken out of the regressor: bending rate and earlier roll rate are left. The
    state's roll rate is as noisy as the density of the roll jerk allows, which few aircraft have: on that noise,
    which the innovations are full of, no scale may be regressed.
    """
    p = motion.omega[:, :1]
    return np.asarray((mean_before(p, motion.root_present) - p)[:, 0])


def _root_errors(out: Floats, motion: SensedMotion, side: int, gain: Floats, columns: Ints) -> None:
    """Columns of the root's scale, misalignment and stamp errors in one tip's rows."""
    force = _one_epoch_earlier(motion.f_root)
    x, y, z = force[:, 0], force[:, 1], force[:, 2]
    p, lever = motion.omega[:, 0], motion.levers_m[side, 1]
    vertical, lateral = Z_LEFT + side, Y_LEFT + side
    _set_column(out, vertical, columns[_KZ], -z)
    _set_column(out, lateral, columns[_KY], -y * gain)
    _set_column(out, lateral, columns[_KP], 2.0 * lever * p**2 * gain)
    _set_column(out, vertical, columns[_MX], y)
    _set_column(out, lateral, columns[_MX], -z * gain)
    _set_column(out, vertical, columns[_MY], -x)
    _set_column(out, lateral, columns[_MZ], x * gain)
    q, r = motion.omega[:, 1], motion.omega[:, 2]
    _set_column(out, vertical, columns[_HEIGHT], -(p**2) - q**2)
    _set_column(out, lateral, columns[_HEIGHT], (q * r - motion.omega_dot[:, 0]) * gain)
    _set_column(out, vertical, columns[_TAU], motion.d_root[:, 2])
    _set_column(out, lateral, columns[_TAU], motion.d_root[:, 1] * gain)
    _root_biases(out, motion, side, gain, columns)


def _root_biases(out: Floats, motion: SensedMotion, side: int, gain: Floats, columns: Ints) -> None:
    """Columns of the biases of the root's rates, through the centripetal force."""
    p, q, r = motion.omega[:, 0], motion.omega[:, 1], motion.omega[:, 2]
    ahead, aside, below = motion.levers_m[side]
    vertical, lateral = Z_LEFT + side, Y_LEFT + side
    _set_column(out, vertical, columns[_BP], 2.0 * below * p - ahead * r)
    _set_column(out, lateral, columns[_BP], (2.0 * aside * p - ahead * q) * gain)
    _set_column(out, vertical, columns[_BR], -(ahead * p + aside * q))
    _set_column(out, lateral, columns[_BR], (2.0 * aside * r - below * q) * gain)


def mean_before(values: Floats, root_present: Bools) -> Floats:
    """Mean of values (n, c) over :data:`AVERAGED` epochs that end :data:`EARLIER` before each, those with a root.

    The values themselves where the root was in none of them.
    """
    out = values.copy()
    for k in range(len(values)):
        past = slice(max(k - EARLIER - AVERAGED + 1, 0), max(k - EARLIER + 1, 0))
        if root_present[past].any():
            out[k] = values[past][root_present[past]].mean(axis=0)
    return out


def _one_epoch_earlier(values: Floats) -> Floats:
    """Values one epoch earlier, so that the root's noise is uncorrelated with the innovations they multiply."""
    out = values.copy()
    out[1:] = values[:-1]
    return out


def _roll_errors(out: Floats, motion: SensedMotion, columns: Ints) -> None:
    """Columns of the root's errors in its roll-rate row."""
    p, q, r = motion.omega[:, 0], motion.omega[:, 1], motion.omega[:, 2]
    _set_column(out, P_ROOT, columns[_KP], p)
    _set_column(out, P_ROOT, columns[_MY], -r)
    _set_column(out, P_ROOT, columns[_MZ], q)
    _set_column(out, P_ROOT, columns[_TAU], -motion.omega_dot[:, 0])
