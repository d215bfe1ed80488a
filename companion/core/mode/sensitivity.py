"""How each constant sensor error shows in each row: the columns that the filter carries beside the state.

A sensor with scale errors ``k`` (per axis), misalignment ``m`` (small rotation vector) and stamp error ``tau`` reads
``(1 + k) (f - m x f)(t - tau)``, and likewise for the rate.

The measured values stand in for the true ones; what that would do to the estimate (a regression on its own noise
shrinks everything) is undone by :class:`companion.core.mode.kalman.Kalman`, which takes the innovation out again
wherever :func:`own_scales` says that it is in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.mode.layout import P_LEFT, P_ROOT, ROWS, SENSOR_ERRORS, Y_LEFT, Z_LEFT, Layout
from companion.records import Bools, Floats

_Entries = dict[str, tuple[tuple[int, Floats], ...]]


@dataclass(frozen=True, slots=True)
class Motion:
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
    load : (n,) float64
        Load factor less one.
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
    load: Floats
    levers_m: Floats


def rate_of_change(values: Floats, step_s: float, there: Bools) -> Floats:
    """Central difference; zero at the ends of the run and beside what is not there."""
    out = np.zeros_like(values)
    out[1:-1] = (values[2:] - values[:-2]) / (2.0 * step_s)
    if not there.all():
        out[1:-1][~(there[2:] & there[:-2])] = 0.0
    return out


def sensitivities(layout: Layout, motion: Motion, gains: Floats, there: Bools) -> Floats:
    """Derivative of the rows by the constants, (n, 9, c); ``gains`` as :attr:`Cells.lateral_gain`."""
    out = np.zeros((len(there), ROWS, len(layout.constants)))
    if not any("." in name for name in layout.constants):
        return out
    index = {name: at for at, name in enumerate(layout.constants)}
    for side, place in ((0, "left"), (1, "right")):
        _fill(out, index, place, side, _tip_entries(motion, side, gains))
        _fill(out, index, "root", side, _root_entries(motion, side, gains))
    _fill(out, index, "root", 0, _roll_entries(motion))
    out[~there] = 0.0
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


def _fill(out: Floats, index: dict[str, int], place: str, side: int, entries: _Entries) -> None:
    for error in SENSOR_ERRORS:
        at = index.get(f"{place}.{error}")
        if at is not None:
            for row, value in entries.get(error, ()):
                out[:, row + side, at] = value


def _tip_entries(motion: Motion, side: int, gains: Floats) -> _Entries:
    x, y, z, p, q, r = motion.tip[:, side].T
    gain = gains[:, side]
    _, dy, dz, dp, _, _ = motion.d_tip[:, side].T
    return {
        "kz": ((Z_LEFT, z), (Y_LEFT, -y * gain)),
        "ky": ((Y_LEFT, y * gain),),
        "kp": ((P_LEFT, p),),
        "mx": ((Z_LEFT, -y), (Y_LEFT, z * gain)),
        "my": ((Z_LEFT, x), (P_LEFT, -r)),
        "mz": ((Y_LEFT, -x * gain), (P_LEFT, q)),
        "tau": ((Z_LEFT, -dz), (Y_LEFT, -(dy - y * dz * np.abs(gain) * np.sign(z)) * gain), (P_LEFT, -dp)),
    }


def _root_entries(motion: Motion, side: int, gains: Floats) -> _Entries:
    x, y, z = _before(motion.f_root).T
    p, gain, lever = motion.omega[:, 0], gains[:, side], motion.levers_m[side, 1]
    return {
        "kz": ((Z_LEFT, -z),),
        "ky": ((Y_LEFT, -y * gain),),
        "kp": ((Y_LEFT, 2.0 * lever * p**2 * gain),),
        "mx": ((Z_LEFT, y), (Y_LEFT, -z * gain)),
        "my": ((Z_LEFT, -x),),
        "mz": ((Y_LEFT, x * gain),),
        "tau": ((Z_LEFT, motion.d_root[:, 2]), (Y_LEFT, motion.d_root[:, 1] * gain)),
    }


def _before(values: Floats) -> Floats:
    """The same one cell earlier: noise of the root must not meet itself in the innovations that it is held against."""
    return np.concatenate([values[:1], values[:-1]])


def _roll_entries(motion: Motion) -> _Entries:
    p, q, r = motion.omega.T
    return {
        "kp": ((P_ROOT, p),),
        "my": ((P_ROOT, -r),),
        "mz": ((P_ROOT, q),),
        "tau": ((P_ROOT, -motion.turn[:, 0]),),
    }
