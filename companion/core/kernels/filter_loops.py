"""The filter's inner loop, compiled: see :mod:`companion.core.tracking.filter` for its equations.

The arrays are far too small for a library's products to pay: what counts is that nothing is allocated inside the loop,
that rows which were not measured cost nothing, and that the zeros of the transition are skipped (nine tenths of it).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
from companion.core.kernels.compiled import compiled_loops
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT
from companion.records import Bools, Floats, Ints

_VERTICAL, _MOMENT, _LATERAL, _ROLL, _ROOT = Z_LEFT, M_LEFT, Y_LEFT, P_LEFT, P_ROOT


class _Work(NamedTuple):
    """Room for one step: ``used`` row numbers, ``at`` the places of the rows among them (-1: not used).

    Of the used rows ``innovation`` is the plain one and ``expected`` its variance, ``white`` is whitened.
    """

    used: Ints
    at: Ints
    innovation: Floats
    expected: Floats
    white: Floats
    state: Floats
    watched: Floats
    plain: Floats
    sense: Floats
    spread: Floats
    variance: Floats
    columns: Floats
    moved: Floats


@compiled_loops
def _room(states: int, columns: int, watched: int) -> _Work:
    return _Work(
        np.empty(ROWS, np.int64),
        np.empty(ROWS, np.int64),
        np.empty(ROWS),
        np.empty(ROWS),
        np.empty(ROWS),
        np.empty(states + 1),
        np.empty(watched),
        np.empty(ROWS),
        np.empty((ROWS, states + 1)),
        np.empty((ROWS, states)),
        np.empty((ROWS, ROWS)),
        np.empty((states, columns)),
        np.empty((states, states)),
    )


@compiled_loops
def run_cells(
    fixed: Fixed, step: Step, data: Data, memory: Memory, history: History, first: int, last: int, steps: int
) -> bool:
    """Take the cells ``first:last``; False where the numbers have run away."""
    size, n, columns = history.state.shape
    work = _room(n, columns, len(step.watch))
    for k in range(first, last):
        if not _one(fixed, step, data, memory, history, work, k, (steps + k - first) % size):
            return False
    return True


@compiled_loops
def _one(fixed: Fixed, step: Step, data: Data, memory: Memory, history: History, work: _Work, k: int, at: int) -> bool:
    columns, covariance, weights = memory.columns, memory.covariance, memory.weights
    n = len(covariance)
    _static_bend(fixed, columns, n, data.load[k])
    _store(history, at, columns, covariance, step.number)
    _watch(columns, weights, step.watch, work.state, work.watched)
    used = _choose(data.present, k, step.rough, work.used, work.at)
    history.used[at] = used
    _sense(fixed, step, data, k, work, used)
    _innovate(fixed, data, k, columns, weights, work, used, history.innovation, at)
    _spread(work.sense, covariance, used, work.spread)
    stir = min(1.0 + LIFTED * data.shaken[k, 0] / step.measured[_VERTICAL, _VERTICAL], MOST_STIR)
    _vary(fixed, step, data, k, work, used, stir)
    _look(weights, history.innovation, at, work, used)
    if not _root(work, used, False):
        return False
    struck = _judge(fixed, data, k, memory, work, used, history.excess, at)
    if struck:
        stir = _stir(step, work, used, stir)
        _vary(fixed, step, data, k, work, used, stir)
        if not _root(work, used, True):
            return False
    _draw(step, work, used, stir, history.drawn, at)
    _keep(work.sense, used, history.seen, at)
    _whiten(work.variance, used, history.seen, at)
    _whiten(work.variance, used, history.innovation, at)
    _whiten(work.variance, used, history.drawn, at)
    if not struck:
        _learn(memory.information, history.innovation, at, used)
    _move_columns(step, columns, history, at, used, work.columns)
    _move_covariance(step, covariance, stir, history.drawn, at, used, work.moved)
    return True


@compiled_loops
def _static_bend(fixed: Fixed, columns: Floats, n: int, load: float) -> None:
    """The static bend over the coming step and its sensitivities, in the last row of the columns."""
    columns[n, 0] = fixed.trim_m + fixed.bend_per_g_m * load
    if fixed.trim:
        columns[n, fixed.trim] = 1.0
    if fixed.bend:
        # smoothed, because the noise of the load is in the innovations too
        columns[n, fixed.bend] += fixed.step_s / LOAD_TIME_S * (load - columns[n, fixed.bend])


@compiled_loops
def _store(history: History, at: int, columns: Floats, covariance: Floats, number: int) -> None:
    n, width = len(covariance), columns.shape[1]
    for i in range(n):
        for j in range(width):
            history.state[at, i, j] = columns[i, j]
        for j in range(n):
            history.covariance[at, i, j] = covariance[i, j]
    for j in range(width):
        history.static_m[at, j] = columns[n, j]
    history.by[at] = number


@compiled_loops
def _watch(columns: Floats, weights: Floats, watch: Floats, state: Floats, watched: Floats) -> None:
    """The best state, static bend last, and what of it the measurement depends on."""
    for i in range(len(columns)):
        total = 0.0
        for j in range(len(weights)):
            total += columns[i, j] * weights[j]
        state[i] = total
    for i in range(len(watch)):
        total = 0.0
        for j in range(len(state)):
            total += watch[i, j] * state[j]
        watched[i] = total


@compiled_loops
def _choose(present: Bools, k: int, rough: bool, used: Ints, at: Ints) -> int:
    """The rows to use: moments are left out where they would tell nothing beside a gyro."""
    count = 0
    for row in range(ROWS):
        at[row] = -1
        idle = _MOMENT <= row < _LATERAL and not rough and present[k, _ROLL + row - _MOMENT]
        if present[k, row] and not idle:
            used[count], at[row] = row, count
            count += 1
    return count


@compiled_loops
def _sense(fixed: Fixed, step: Step, data: Data, k: int, work: _Work, used: int) -> None:
    """Sensitivity of the used rows to the state: the tip's own tilt is linearised where the state is believed to be.

    Through it gravity shows slow bending.
    """
    width = step.sense.shape[1]
    for r in range(used):
        for j in range(width):
            work.sense[r, j] = step.sense[work.used[r], j]
    for side in range(2):
        r = work.at[_VERTICAL + side]
        if r >= 0:
            tilt = -(data.vertical[k, side] * work.watched[side] + data.lateral[k, side])
            for j in range(width):
                work.sense[r, j] += tilt * step.watch[side, j]
        r, bias = work.at[_LATERAL + side], fixed.lateral_bias[side]
        if r >= 0 and bias >= 0:
            work.sense[r, bias] = data.lateral_gain[k, side]
        if r >= 0 and fixed.force_bias:
            # the slope seen is lateral over vertical force
            for other in range(2):
                share = work.watched[side] / data.vertical[k, side] * fixed.own_bias[side, other]
                work.sense[r, fixed.vertical_bias[other]] -= share


@compiled_loops
def _innovate(
    fixed: Fixed, data: Data, k: int, columns: Floats, weights: Floats, work: _Work, used: int, out: Floats, at: int
) -> None:
    """Innovation of the used rows and its sensitivities, those of the slope factors at the believed state."""
    width = columns.shape[1]
    for r in range(used):
        row = work.used[r]
        out[at, r, 0] = data.rows[k, row]
        for j in range(1, width):
            out[at, r, j] = -data.sensitivity[k, row, j - 1]
    for side in range(2):
        slope, rate, r = work.watched[side], work.watched[2 + side], work.at[_VERTICAL + side]
        if r >= 0:
            out[at, r, 0] -= 0.5 * data.vertical[k, side] * slope * slope
            if fixed.leaning[side] and not data.present[k, _LATERAL + side]:
                # gravity along the lateral axis, by the believed tilt: the axis itself would have told it
                out[at, r, fixed.leaning[side]] += (1.0 - 2.0 * side) * data.vertical[k, side] * slope
        r = work.at[_LATERAL + side]
        if r >= 0:
            out[at, r, 0] += data.tilted[k, side] * rate
            if fixed.force_bias:
                out[at, r, fixed.force_bias] += slope / data.vertical[k, side]
    for j in range(len(fixed.factor_rows)):
        r = work.at[fixed.factor_rows[j]]
        if r >= 0:
            out[at, r, fixed.factor_columns[j]] = work.watched[4 + j]
    for r in range(used):
        for i in range(len(columns)):
            share = work.sense[r, i]
            if share != 0.0:
                for j in range(width):
                    out[at, r, j] -= share * columns[i, j]
    _at_prediction(fixed, weights, work.at, work.plain, out, at)


@compiled_loops
def _at_prediction(fixed: Fixed, weights: Floats, place: Ints, plain: Floats, out: Floats, at: int) -> None:
    """Take the innovation out of the sensitivities that hold their row's own measurement."""
    for row in range(ROWS):
        plain[row] = 0.0
        for j in range(len(weights) if place[row] >= 0 else 0):
            plain[row] += out[at, place[row], j] * weights[j]
    for j in range(len(fixed.own_rows)):
        row = fixed.own_rows[j]
        if place[row] >= 0:
            out[at, place[row], fixed.own_columns[j]] += fixed.own_signs[j] * plain[row]


@compiled_loops
def _spread(sense: Floats, covariance: Floats, used: int, spread: Floats) -> None:
    """``G P``."""
    n = len(covariance)
    for r in range(used):
        for j in range(n):
            spread[r, j] = 0.0
        for i in range(n):
            share = sense[r, i]
            if share != 0.0:
                for j in range(n):
                    spread[r, j] += share * covariance[i, j]


@compiled_loops
def _vary(fixed: Fixed, step: Step, data: Data, k: int, work: _Work, used: int, stir: float) -> None:
    """Covariance of the used rows: by the state, by ``stir`` times the process noise, by the sensors; lower half."""
    n = work.spread.shape[1]
    for r in range(used):
        row = work.used[r]
        for q in range(r + 1):
            total = stir * step.measured[row, work.used[q]]
            for j in range(n):
                total += work.spread[r, j] * work.sense[q, j]
            work.variance[r, q] = total
        lateral = _LATERAL <= row < _ROLL
        work.variance[r, r] += fixed.own[row] * (data.lateral_gain[k, row - _LATERAL] ** 2 if lateral else 1.0)
        if row < _MOMENT:
            work.variance[r, r] += stir * step.cut * data.cut[k, row - _VERTICAL]
        if row == _ROOT:
            work.variance[r, r] += data.shaken[k, 2]
    for side in range(2):
        for other in range(side + 1):
            r, q = work.at[_VERTICAL + side], work.at[_VERTICAL + other]
            if r >= 0 and q >= 0:
                work.variance[r, q] += fixed.root_z + data.shaken[k, 0]
            r, q = work.at[_LATERAL + side], work.at[_LATERAL + other]
            if r >= 0 and q >= 0:
                variance = fixed.root_y + data.shaken[k, 1]
                work.variance[r, q] += variance * data.lateral_gain[k, side] * data.lateral_gain[k, other]


@compiled_loops
def _draw(step: Step, work: _Work, used: int, stir: float, out: Floats, at: int) -> None:
    """``C^T = G P A^T + H1 Q``, of ``stir`` times the process noise."""
    for r in range(used):
        for i in range(step.cross.shape[1]):
            out[at, r, i] = stir * step.cross[work.used[r], i]
        for k in range(len(step.to)):
            out[at, r, step.to[k]] += step.share[k] * work.spread[r, step.of[k]]


@compiled_loops
def _look(weights: Floats, rows: Floats, at: int, work: _Work, used: int) -> None:
    """The plain innovations with what is expected of them."""
    for r in range(used):
        total = 0.0
        for j in range(len(weights)):
            total += rows[at, r, j] * weights[j]
        work.innovation[r], work.expected[r] = total, work.variance[r, r]


@compiled_loops
def _root(work: _Work, used: int, doubting: bool) -> bool:
    """Cholesky's ``L`` in place, the diagonal inverted, and the whitened innovation; False where there is none.

    ``doubting``: each row that lies beyond the gate is noisier, by as much.
    """
    variance = work.variance
    for r in range(used):
        innovation = work.innovation[r]
        for q in range(r + 1):
            total = variance[r, q]
            for j in range(q):
                total -= variance[r, j] * variance[q, j]
            if q < r:
                variance[r, q] = total * variance[q, q]
                innovation -= variance[r, q] * work.white[q]
            elif not 0.0 < total < np.inf:
                return False
            else:
                if doubting:
                    total = max(total, np.abs(innovation) * np.sqrt(total) / GATE)
                variance[r, r] = 1.0 / np.sqrt(total)
        work.white[r] = innovation * variance[r, r]
    return True


@compiled_loops
def _judge(fixed: Fixed, data: Data, k: int, memory: Memory, work: _Work, used: int, excess: Floats, at: int) -> bool:
    """Count how surprising the innovations are; whether one lies beyond the gate. Note what teaches nothing."""
    square, struck = 0.0, False
    for row in range(ROWS):
        excess[at, row] = 0.0
    for r in range(used):
        own = work.white[r] ** 2
        if own > GATE**2:
            struck = True
            more = np.abs(work.innovation[r]) - GATE * np.sqrt(work.expected[r])
            excess[at, work.used[r]] = np.sign(work.innovation[r]) * max(more, 0.0)
        row, shaken = work.used[r], 0.0
        if row < _MOMENT:
            shaken = (1.0 + LIFTED) * data.shaken[k, 0]
        elif row == _ROOT:
            shaken = data.shaken[k, 2]
        if shaken > 0.5 * work.expected[r]:
            excess[at, row] = work.innovation[r]
        square += own
    fade = 1.0 - fixed.step_s
    memory.surprise[0] = fade * memory.surprise[0] + min(square, MOST_SURPRISE)
    memory.surprise[1] = fade * memory.surprise[1] + used
    return struck


@compiled_loops
def _stir(step: Step, work: _Work, used: int, before: float) -> float:
    """By what the process noise must be raised so that what the vertical rows say lies inside the gate."""
    stir = before
    for r in range(used):
        row = work.used[r]
        if row < _MOMENT and work.white[r] ** 2 > GATE**2:
            missing = work.innovation[r] ** 2 - GATE**2 * work.expected[r]
            stir = max(stir, before + missing / step.measured[row, row])
    return min(stir, MOST_STIR)


@compiled_loops
def _keep(sense: Floats, used: int, out: Floats, at: int) -> None:
    for r in range(used):
        for j in range(out.shape[2]):
            out[at, r, j] = sense[r, j]


@compiled_loops
def _whiten(root: Floats, used: int, rows: Floats, at: int) -> None:
    """``L^-1`` times the rows, in place."""
    width = rows.shape[2]
    for r in range(used):
        for q in range(r):
            for j in range(width):
                rows[at, r, j] -= root[r, q] * rows[at, q, j]
        for j in range(width):
            rows[at, r, j] *= root[r, r]


@compiled_loops
def _learn(information: Floats, innovation: Floats, at: int, used: int) -> None:
    """What the innovations say about the constants."""
    width = innovation.shape[2]
    for r in range(used):
        for i in range(width):
            share = innovation[at, r, i]
            for j in range(width):
                information[i, j] += share * innovation[at, r, j]


@compiled_loops
def _move_columns(step: Step, columns: Floats, history: History, at: int, used: int, moved: Floats) -> None:
    n, width = moved.shape
    for i in range(n):
        for j in range(width):
            moved[i, j] = 0.0
    _add_moved(step, columns, moved)
    for i in range(n):
        if step.static[i] != 0.0:
            for j in range(width):
                moved[i, j] += step.static[i] * columns[n, j]
        for r in range(used):
            share = history.drawn[at, r, i]
            for j in range(width):
                moved[i, j] += share * history.innovation[at, r, j]
    for i in range(n):
        for j in range(width):
            columns[i, j] = moved[i, j]


@compiled_loops
def _add_moved(step: Step, rows: Floats, out: Floats) -> None:
    """Add ``A rows``."""
    for k in range(len(step.to)):
        to, of, share = step.to[k], step.of[k], step.share[k]
        for j in range(out.shape[1]):
            out[to, j] += share * rows[of, j]


@compiled_loops
def _move_covariance(
    step: Step, covariance: Floats, stir: float, drawn: Floats, at: int, used: int, moved: Floats
) -> None:
    """``P = A P A^T + stir Q - K C^T``: the lower half, mirrored."""
    n = len(covariance)
    for i in range(n):
        for j in range(n):
            moved[i, j] = 0.0
    _add_moved(step, covariance, moved)
    _transpose(moved)
    for i in range(n):
        for j in range(n):
            covariance[i, j] = stir * step.noise[i, j]
    _add_moved(step, moved, covariance)
    for i in range(n):
        for r in range(used):
            share = drawn[at, r, i]
            for j in range(i + 1):
                covariance[i, j] -= share * drawn[at, r, j]
    for i in range(n):
        for j in range(i):
            covariance[j, i] = covariance[i, j]


@compiled_loops
def _transpose(square: Floats) -> None:
    for i in range(len(square)):
        for j in range(i):
            square[i, j], square[j, i] = square[j, i], square[i, j]
