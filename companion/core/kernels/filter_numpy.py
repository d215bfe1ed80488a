"""The filter's inner loop by numpy's own products, for where nothing can be compiled; see its compiled twin."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from companion.core.kernels.arrays import (
    GATE,
    LIFTED,
    LOAD_TIME_S,
    MOST_STIR,
    MOST_SURPRISE,
    Data,
    Fixed,
    History,
    Memory,
    Step,
)
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT
from companion.records import Bools, Floats, Ints


def run_cells(
    fixed: Fixed, step: Step, data: Data, memory: Memory, history: History, first: int, last: int, steps: int
) -> bool:
    """See :func:`companion.core.kernels.filter_loops.run_cells`."""
    size = len(history.state)
    with np.errstate(over="ignore", invalid="ignore"):  # what has run away is found, and said
        return all(_one(fixed, step, data, memory, history, k, (steps + k - first) % size) for k in range(first, last))


def _one(fixed: Fixed, step: Step, data: Data, memory: Memory, history: History, k: int, at: int) -> bool:
    columns, covariance, weights = memory.columns, memory.covariance, memory.weights
    n = len(covariance)
    _static_bend(fixed, columns[n], data.load[k])
    history.state[at], history.covariance[at] = columns[:n], covariance
    history.by[at], history.static_m[at] = step.number, columns[n]
    measured = np.concatenate([data.rows[k][:, None], -data.sensitivity[k]], axis=1)
    sense = step.sense.copy()
    _turn(fixed, step, data, k, columns @ weights, measured, sense)
    use = _used(step, data, k)
    g = sense[use, :n]
    spread = g @ covariance
    innovation = measured[use] - sense[use] @ columns
    _at_prediction(fixed, use, innovation, innovation @ weights)
    plain, swept = innovation @ weights, spread @ g.T
    stir = min(1.0 + LIFTED * float(data.shaken[k, 0]) / float(step.measured[Z_LEFT, Z_LEFT]), MOST_STIR)
    variance = swept + _sensor(fixed, step, data, k, stir)[np.ix_(use, use)]
    root = _cholesky(variance)
    if root is None:
        return False
    surprise = _solved(root, plain)
    beyond = np.abs(surprise) > GATE
    excess, expected = np.zeros(len(use)), np.diag(variance)
    if beyond.any():
        stir = _stir(step, use, beyond, plain, expected, stir)
        excess = _excess(beyond, plain, expected)
        variance = swept + _sensor(fixed, step, data, k, stir)[np.ix_(use, use)]
        root = _doubting_root(variance, plain)
        if root is None:
            return False
    shaken = np.zeros(ROWS)
    shaken[Z_LEFT:M_LEFT], shaken[P_ROOT] = (1.0 + LIFTED) * data.shaken[k, 0], data.shaken[k, 2]
    excess = np.where(shaken[use] > 0.5 * expected, plain, excess)
    drawn = spread @ step.motion.T + stir * step.cross[use]
    g, innovation, drawn = (_solved(root, rows) for rows in (g, innovation, drawn))
    _remember(history, at, g, innovation, drawn)
    history.excess[at] = 0.0
    history.excess[at, use] = excess
    fade = 1.0 - fixed.step_s
    memory.surprise[0] = fade * memory.surprise[0] + min(float(np.sum(surprise**2)), MOST_SURPRISE)
    memory.surprise[1] = fade * memory.surprise[1] + len(use)
    if not beyond.any():
        memory.information[:] += innovation.T @ innovation
    columns[:n] = step.motion @ columns[:n] + np.outer(step.static, columns[n]) + drawn.T @ innovation
    grown = step.motion @ covariance @ step.motion.T + stir * step.noise - drawn.T @ drawn
    covariance[:] = 0.5 * (grown + grown.T)
    return True


def _cholesky(variance: Floats) -> Floats | None:
    """Lower root; None where there is none."""
    if not np.isfinite(variance.sum()):
        return None
    root, failed = lapack.dpotrf(variance, lower=1)
    return None if failed else root


def _solved(root: Floats, rows: Floats) -> Floats:
    """``L^-1`` times the rows; LAPACK complains aloud of a system without any."""
    return np.asarray(lapack.dtrtrs(root, rows, lower=1)[0]).reshape(rows.shape) if len(rows) else rows


def _stir(step: Step, use: Ints, beyond: Bools, plain: Floats, variance: Floats, before: float) -> float:
    """By what the process noise must be raised so that what the vertical rows say lies inside the gate."""
    vertical = beyond & (use < M_LEFT)
    missing = plain**2 - GATE**2 * variance
    needed = missing[vertical] / np.diag(step.measured)[use[vertical]]
    return min(before + float(np.max(needed, initial=0.0)), MOST_STIR)


def _excess(lapsed: Bools, plain: Floats, variance: Floats) -> Floats:
    return np.where(lapsed, np.sign(plain) * np.maximum(np.abs(plain) - GATE * np.sqrt(variance), 0.0), 0.0)


def _doubting_root(variance: Floats, plain: Floats) -> Floats | None:
    """Cholesky's root row by row, of a covariance in which each row that lies beyond the gate is noisier."""
    count = len(plain)
    root, white = np.zeros((count, count)), np.zeros(count)
    for r in range(count):
        for q in range(r):
            root[r, q] = (variance[r, q] - root[r, :q] @ root[q, :q]) / root[q, q]
        own, innovation = variance[r, r] - root[r, :r] @ root[r, :r], plain[r] - root[r, :r] @ white[:r]
        if not 0.0 < own < np.inf:
            return None
        own = max(own, abs(innovation) * np.sqrt(own) / GATE)
        root[r, r], white[r] = np.sqrt(own), innovation / np.sqrt(own)
    return root


def _remember(history: History, at: int, g: Floats, innovation: Floats, drawn: Floats) -> None:
    count = len(g)
    history.used[at] = count
    history.seen[at, :count], history.innovation[at, :count], history.drawn[at, :count] = g, innovation, drawn


def _static_bend(fixed: Fixed, last: Floats, load: float) -> None:
    last[0] = fixed.trim_m + fixed.bend_per_g_m * load
    if fixed.trim:
        last[fixed.trim] = 1.0
    if fixed.bend:
        last[fixed.bend] += fixed.step_s / LOAD_TIME_S * (load - last[fixed.bend])


def _turn(fixed: Fixed, step: Step, data: Data, k: int, state: Floats, measured: Floats, sense: Floats) -> None:
    seen = step.watch @ state
    vertical, slope, rate = data.vertical[k], seen[:2], seen[2:4]
    up, across = slice(Z_LEFT, Z_LEFT + 2), slice(Y_LEFT, Y_LEFT + 2)
    measured[up, 0] -= 0.5 * vertical * slope**2
    for side, column in enumerate(fixed.leaning.tolist()):
        if column and not data.present[k, Y_LEFT + side]:
            # gravity along the lateral axis, by the believed tilt: the axis itself would have told it
            measured[Z_LEFT + side, column] += (1.0 - 2.0 * side) * vertical[side] * slope[side]
    measured[across, 0] += data.tilted[k] * rate
    for side in (0, 1) if fixed.force_bias else ():
        if data.present[k, Y_LEFT + side]:
            # the slope seen is lateral over vertical force
            measured[Y_LEFT + side, fixed.force_bias] += slope[side] / vertical[side]
            sense[Y_LEFT + side, fixed.vertical_bias] -= slope[side] / vertical[side] * fixed.own_bias[side]
    sense[up] -= (vertical * slope + data.lateral[k])[:, None] * step.watch[:2]
    for side, bias in enumerate(fixed.lateral_bias.tolist()):
        if bias >= 0:
            sense[Y_LEFT + side, bias] = data.lateral_gain[k, side]
    measured[fixed.factor_rows, fixed.factor_columns] = seen[4:]


def _used(step: Step, data: Data, k: int) -> Ints:
    use = data.present[k].copy()
    if not step.rough:
        use[M_LEFT:Y_LEFT] &= ~use[P_LEFT : P_LEFT + 2]
    return np.flatnonzero(use)


def _sensor(fixed: Fixed, step: Step, data: Data, k: int, stir: float) -> Floats:
    out = stir * step.measured
    own, gain, shaken = fixed.own.copy(), data.lateral_gain[k], data.shaken[k]
    own[Y_LEFT:P_LEFT] *= gain**2
    own[Z_LEFT:M_LEFT] += stir * step.cut * data.cut[k]
    own[P_ROOT] += shaken[2]
    out[range(ROWS), range(ROWS)] += own
    out[Z_LEFT:M_LEFT, Z_LEFT:M_LEFT] += fixed.root_z + shaken[0]
    out[Y_LEFT:P_LEFT, Y_LEFT:P_LEFT] += (fixed.root_y + shaken[1]) * np.outer(gain, gain)
    return out


def _at_prediction(fixed: Fixed, use: Ints, innovation: Floats, plain: Floats) -> None:
    place = {row: at for at, row in enumerate(use.tolist())}
    for row, column, sign in zip(fixed.own_rows.tolist(), fixed.own_columns.tolist(), fixed.own_signs, strict=True):
        if row in place:
            innovation[place[row], column] += sign * plain[place[row]]
