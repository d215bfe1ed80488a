"""The filter's inner loop, compiled where that is possible: see :mod:`companion.core.mode.kalman` for its equations.

All nine rows take part in every step; those that were not measured have no gain and unit variance, which leaves the
others as if they were not there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.compiled import compiled
from companion.core.mode.layout import M_LEFT, P_LEFT, ROWS, Y_LEFT, Z_LEFT
from companion.records import Bools, Floats, Ints

LOAD_TIME_S = 0.1
_VERTICAL, _MOMENT, _LATERAL, _ROLL = Z_LEFT, M_LEFT, Y_LEFT, P_LEFT


class Fixed(NamedTuple):
    """What never changes of a wing.

    Attributes
    ----------
    step_s, trim_m, bend_per_g_m, root_z, root_y : float
    trim, bend : int
        Columns of these constants, 0 where they are certain.
    own : (9,) float64
        Sensor noise variances.
    lateral_bias : (2,) int64
        States that hold the lateral biases; -1 where there is none.
    factor_rows, factor_columns : (f,) int64
        Where the slope factors show.
    own_rows, own_columns : (s,) int64
    own_signs : (s,) float64
        Sensitivities that are to be taken at the prediction instead of at the measurement, which holds the innovation.
    """

    step_s: float
    trim_m: float
    bend_per_g_m: float
    root_z: float
    root_y: float
    trim: int
    bend: int
    own: Floats
    lateral_bias: Ints
    factor_rows: Ints
    factor_columns: Ints
    own_rows: Ints
    own_columns: Ints
    own_signs: Floats


class Step(NamedTuple):
    """The model of one step as plain arrays: see :class:`companion.core.mode.model.StepModel`.

    ``watch`` (4 + f, n + 1) gives tip slopes, tip slope rates and what multiplies the slope factors.
    """

    transition: Floats
    motion: Floats
    sense: Floats
    noise: Floats
    cross: Floats
    measured: Floats
    watch: Floats
    cut: float
    rough: bool


class Data(NamedTuple):
    """A run of cells as plain arrays: see :class:`companion.core.mode.rigid.Cells`."""

    rows: Floats
    present: Bools
    vertical: Floats
    lateral: Floats
    tilted: Floats
    lateral_gain: Floats
    load: Floats
    sensitivity: Floats
    cut: Floats


class Memory(NamedTuple):
    """What one step leaves for the next: see :class:`companion.core.mode.kalman.Kalman`.

    Attributes
    ----------
    columns : (n + 1, 1 + c) float64
    covariance : (n, n) float64
    information : (1 + c, 1 + c) float64
    weights : (1 + c,) float64
        One and the constants.
    surprise : (2,) float64
        Fading sums of squared normalised innovations and of their number.
    """

    columns: Floats
    covariance: Floats
    information: Floats
    weights: Floats
    surprise: Floats


class History(NamedTuple):
    """What the smoother needs of each step, in rings; slot ``k % size`` is step ``k``.

    Attributes
    ----------
    state : (size, n, 1 + c) float64
        At the start of the step.
    covariance, transition : (size, n, n) float64
    closed : (size, n, n) float64
        Transpose of ``A - K G``.
    push : (size, n, 1 + c) float64
        ``G^T S^-1`` times the innovation.
    gather : (size, n, n) float64
        ``G^T S^-1 G``.
    static_m : (size, 1 + c) float64
    """

    state: Floats
    covariance: Floats
    transition: Floats
    closed: Floats
    push: Floats
    gather: Floats
    static_m: Floats


@compiled
def run_cells(
    fixed: Fixed, step: Step, data: Data, memory: Memory, history: History, first: int, last: int, steps: int
) -> bool:
    """Take the cells ``first:last``; False where the numbers have run away."""
    size = history.state.shape[0]
    for k in range(first, last):
        fine = _one(fixed, step, data, memory, history, k, (steps + k - first) % size)
        if not fine:
            return False
    return True


@compiled
def _one(fixed: Fixed, step: Step, data: Data, memory: Memory, history: History, k: int, at: int) -> bool:
    columns, covariance, weights = memory.columns, memory.covariance, memory.weights
    n = covariance.shape[0]
    _static_bend(fixed, columns[n], data.load[k])
    measured = np.empty((ROWS, columns.shape[1]))
    measured[:, 0] = data.rows[k]
    measured[:, 1:] = -data.sensitivity[k]
    sense = step.sense.copy()
    _turn(fixed, step, data, k, columns @ weights, measured, sense)
    history.state[at] = columns[:n]
    history.covariance[at] = covariance
    history.transition[at] = step.motion
    history.static_m[at] = columns[n]
    use = _used(data.present[k], step.rough)
    cross = step.cross.copy()
    for row in range(ROWS):
        if not use[row]:
            sense[row] = 0.0
            cross[:, row] = 0.0
    g = np.ascontiguousarray(sense[:, :n])
    spread = g @ covariance
    c = step.motion @ np.ascontiguousarray(spread.T) + cross
    s = spread @ np.ascontiguousarray(g.T) + _sensor(fixed, step, data.lateral_gain[k], data.cut[k])
    for row in range(ROWS):
        if not use[row]:
            s[row, :] = 0.0
            s[:, row] = 0.0
            s[row, row] = 1.0
    if not np.isfinite(s.sum()):
        return False
    inverse = np.linalg.inv(s)
    gain = c @ inverse
    innovation = measured - sense @ columns
    for row in range(ROWS):
        if not use[row]:
            innovation[row] = 0.0
    plain = innovation @ weights
    for j in range(len(fixed.own_rows)):
        row = fixed.own_rows[j]
        innovation[row, fixed.own_columns[j]] += fixed.own_signs[j] * plain[row]
    weighted = inverse @ innovation
    _surprise(fixed, memory, innovation @ weights, np.asarray(inverse), use)
    sense_t = np.ascontiguousarray(g.T)
    history.push[at] = sense_t @ weighted
    history.gather[at] = sense_t @ (inverse @ g)
    history.closed[at] = (step.motion - gain @ g).T
    memory.information[:] += np.ascontiguousarray(innovation.T) @ weighted
    columns[:n] = step.transition @ columns + gain @ innovation
    grown = step.motion @ covariance @ np.ascontiguousarray(step.motion.T) + step.noise
    grown -= gain @ np.ascontiguousarray(c.T)
    covariance[:] = 0.5 * (grown + grown.T)
    return True


@compiled
def _static_bend(fixed: Fixed, last: Floats, load: float) -> None:
    last[0] = fixed.trim_m + fixed.bend_per_g_m * load
    if fixed.trim:
        last[fixed.trim] = 1.0
    if fixed.bend:
        # smoothed, because the noise of the load is in the innovations too
        last[fixed.bend] += fixed.step_s / LOAD_TIME_S * (load - last[fixed.bend])


@compiled
def _turn(fixed: Fixed, step: Step, data: Data, k: int, state: Floats, measured: Floats, sense: Floats) -> None:
    """Fill in what depends on the state: the tip's own tilt, and the columns of the slope factors.

    The tilt is linearised where the state is believed to be, for through it gravity shows slow bending.
    """
    seen = step.watch @ state
    n = sense.shape[1] - 1
    for side in range(2):
        slope, rate = seen[side], seen[2 + side]
        vertical = data.vertical[k, side]
        tilt = -(vertical * slope + data.lateral[k, side])
        measured[_VERTICAL + side, 0] -= 0.5 * vertical * slope * slope
        measured[_LATERAL + side, 0] += data.tilted[k, side] * rate
        for j in range(n + 1):
            sense[_VERTICAL + side, j] += tilt * step.watch[side, j]
        bias = fixed.lateral_bias[side]
        if bias >= 0:
            sense[_LATERAL + side, bias] = data.lateral_gain[k, side]
    for j in range(len(fixed.factor_rows)):
        measured[fixed.factor_rows[j], fixed.factor_columns[j]] = seen[4 + j]


@compiled
def _used(present: Bools, rough: bool) -> Bools:
    """The rows to use: moments are left out where they would tell nothing beside a gyro."""
    use = present.copy()
    for side in range(2):
        if not rough and present[_ROLL + side]:
            use[_MOMENT + side] = False
    return use


@compiled
def _sensor(fixed: Fixed, step: Step, gain: Floats, cut: Floats) -> Floats:
    """Covariance of the rows by process noise in the step and by the sensors."""
    out = step.measured.copy()
    for row in range(ROWS):
        out[row, row] += fixed.own[row] * (gain[row - _LATERAL] ** 2 if _LATERAL <= row < _ROLL else 1.0)
    for i in range(2):
        out[_VERTICAL + i, _VERTICAL + i] += step.cut * cut[i]
        for j in range(2):
            out[_VERTICAL + i, _VERTICAL + j] += fixed.root_z
            out[_LATERAL + i, _LATERAL + j] += fixed.root_y * gain[i] * gain[j]
    return out


@compiled
def _surprise(fixed: Fixed, memory: Memory, innovation: Floats, inverse: Floats, use: Bools) -> None:
    square = innovation @ (inverse @ innovation)
    fade = 1.0 - fixed.step_s
    memory.surprise[0] = fade * memory.surprise[0] + square
    memory.surprise[1] = fade * memory.surprise[1] + use.sum()


@compiled
def adjoint(history: History, first: int, count: int) -> tuple[Floats, Floats, Floats]:
    """Run the smoother's recursion back over ``count`` steps to ``first``: see :mod:`companion.core.mode.smoother`.

    Returns
    -------
    push, later : (n, 1 + c) float64
        ``l`` at ``first`` and at the step after it.
    weight : (n, n) float64
        ``W`` at ``first``.
    """
    size = history.state.shape[0]
    at = (first + count - 1) % size
    push, weight = history.push[at].copy(), history.gather[at].copy()
    later = np.zeros_like(push)
    for back in range(2, count + 1):
        at = (first + count - back) % size
        closed = history.closed[at]
        later = push
        push = closed @ push + history.push[at]
        weight = closed @ weight @ np.ascontiguousarray(closed.T) + history.gather[at]
    return push, later, weight
