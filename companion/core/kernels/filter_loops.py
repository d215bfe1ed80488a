"""Compiled inner loop of the filter: see :mod:`companion.core.tracking.filter` for its equations.

The arrays are too small for a library's products to pay: nothing is allocated inside the loop, absent rows cost
nothing, and the zeros of the transition (nine tenths of it) are skipped.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.kernels.arrays import (
    GATE_SIGMAS,
    LOAD_FACTOR_TIME_S,
    LOAD_VARIANCE_RATIO,
    MAX_NOISE_INFLATION,
    MAX_STEP_NIS,
    DiscreteModel,
    Epochs,
    FilterConstants,
    FilterState,
    History,
)
from companion.core.kernels.compiled import compiled_loops
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT
from companion.records import Bools, Floats, Ints

_VERTICAL, _MOMENT, _LATERAL, _ROLL, _ROOT = Z_LEFT, M_LEFT, Y_LEFT, P_LEFT, P_ROOT


class _Workspace(NamedTuple):
    """Scratch arrays of one step.

    ``used_rows`` are the numbers of the used rows, ``position`` each row's place among them (-1: absent). For the used
    rows ``innovation`` is the innovation at the estimated bias parameters, ``predicted_variance`` its variance and
    ``whitened`` the innovation whitened by ``L``.
    """

    used_rows: Ints
    position: Ints
    innovation: Floats
    predicted_variance: Floats
    whitened: Floats
    state: Floats
    linearised: Floats
    row_innovation: Floats
    H: Floats
    HP: Floats
    S: Floats
    next_state: Floats
    next_covariance: Floats


@compiled_loops
def _make_workspace(states: int, width: int, linearised: int) -> _Workspace:
    """Uninitialised workspace for so many states, columns and linearisation rows."""
    return _Workspace(
        np.empty(ROWS, np.int64),
        np.empty(ROWS, np.int64),
        np.empty(ROWS),
        np.empty(ROWS),
        np.empty(ROWS),
        np.empty(states + 1),
        np.empty(linearised),
        np.empty(ROWS),
        np.empty((ROWS, states + 1)),
        np.empty((ROWS, states)),
        np.empty((ROWS, ROWS)),
        np.empty((states, width)),
        np.empty((states, states)),
    )


@compiled_loops
def filter_epochs(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    filter_state: FilterState,
    history: History,
    first: int,
    last: int,
    steps: int,
) -> bool:
    """Filter the epochs ``first:last`` in place.

    Parameters
    ----------
    const : FilterConstants
        Constants of the airframe.
    model : DiscreteModel
        Model that the filter runs on.
    epochs : Epochs
        Measurements.
    filter_state : FilterState
        Updated in place.
    history : History
        Updated in place; epoch ``first`` is step ``steps``.
    first, last : int
        Range of epochs.
    steps : int
        Steps done before.

    Returns
    -------
    bool
        False where the innovation covariance is not positive definite or not finite: the filter has run away.
    """
    size, n, width = history.state.shape
    work = _make_workspace(n, width, len(model.linearisation_rows))
    for k in range(first, last):
        if not _filter_step(const, model, epochs, filter_state, history, work, k, (steps + k - first) % size):
            return False
    return True


@compiled_loops
def _filter_step(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    filter_state: FilterState,
    history: History,
    work: _Workspace,
    k: int,
    slot: int,
) -> bool:
    """Predict, gate, update and propagate through epoch ``k``; False where the numbers have run away."""
    state_and_sensitivity, covariance, one_and_bias = (
        filter_state.state_and_sensitivity,
        filter_state.covariance,
        filter_state.one_and_bias,
    )
    n = len(covariance)
    _static_bend(const, state_and_sensitivity, n, epochs.load_g[k])
    _store_prior(history, slot, state_and_sensitivity, covariance, model.transition_index)
    _evaluate_linearisation(state_and_sensitivity, one_and_bias, model.linearisation_rows, work.state, work.linearised)
    count = _select_rows(epochs.present, k, model.moments_beside_gyro, work.used_rows, work.position)
    history.row_count[slot] = count
    _linearise(const, model, epochs, k, work, count)
    _compute_innovation(
        const, epochs, k, state_and_sensitivity, one_and_bias, work, count, history.whitened_innovation, slot
    )
    _project_covariance(work.H, covariance, count, work.HP)
    noise_inflation = min(
        1.0
        + LOAD_VARIANCE_RATIO * epochs.root_motion_variance[k, 0] / model.process_noise_in_rows[_VERTICAL, _VERTICAL],
        MAX_NOISE_INFLATION,
    )
    _innovation_covariance(const, model, epochs, k, work, count, noise_inflation)
    _sum_innovation(one_and_bias, history, slot, work, count)
    if not _cholesky_and_whiten(work, count, False):
        return False
    gated = _gate(const, epochs, k, filter_state, work, count, history.gate_excess, slot)
    if gated:
        noise_inflation = _inflate_process_noise(model, work, count, noise_inflation)
        _innovation_covariance(const, model, epochs, k, work, count, noise_inflation)
        if not _cholesky_and_whiten(work, count, True):
            return False
    _cross_covariance(model, work, count, noise_inflation, history.whitened_cross_cov, slot)
    _store_rows(work.H, count, history.whitened_H, slot)
    _whiten(work.S, count, history.whitened_H, slot)
    _whiten(work.S, count, history.whitened_innovation, slot)
    _whiten(work.S, count, history.whitened_cross_cov, slot)
    if not gated:
        _accumulate_information(filter_state.information, history.whitened_innovation, slot, count)
    _propagate_state(model, state_and_sensitivity, history, slot, count, work.next_state)
    _propagate_covariance(
        model, covariance, noise_inflation, history.whitened_cross_cov, slot, count, work.next_covariance
    )
    return True


@compiled_loops
def _static_bend(const: FilterConstants, state_and_sensitivity: Floats, n: int, load_g: float) -> None:
    """Static bend over the coming step and its sensitivities, in the last row of ``[x | V]``."""
    state_and_sensitivity[n, 0] = const.trim_m + const.bend_per_g_m * load_g
    if const.trim_column:
        state_and_sensitivity[n, const.trim_column] = 1.0
    if const.bend_column:
        # smoothed, because the noise of the load is in the innovations too
        state_and_sensitivity[n, const.bend_column] += (
            const.step_s / LOAD_FACTOR_TIME_S * (load_g - state_and_sensitivity[n, const.bend_column])
        )


@compiled_loops
def _store_prior(
    history: History, slot: int, state_and_sensitivity: Floats, covariance: Floats, transition_index: int
) -> None:
    """State, covariance and transition at the start of the step into the history."""
    n, width = len(covariance), state_and_sensitivity.shape[1]
    for i in range(n):
        for j in range(width):
            history.state[slot, i, j] = state_and_sensitivity[i, j]
        for j in range(n):
            history.covariance[slot, i, j] = covariance[i, j]
    for j in range(width):
        history.static_m[slot, j] = state_and_sensitivity[n, j]
    history.transition_index[slot] = transition_index


@compiled_loops
def _evaluate_linearisation(
    state_and_sensitivity: Floats, one_and_bias: Floats, linearisation_rows: Floats, state: Floats, linearised: Floats
) -> None:
    """State at the estimated bias parameters, static bend last, and the linearisation rows of it."""
    for i in range(len(state_and_sensitivity)):
        total = 0.0
        for j in range(len(one_and_bias)):
            total += state_and_sensitivity[i, j] * one_and_bias[j]
        state[i] = total
    for i in range(len(linearisation_rows)):
        total = 0.0
        for j in range(len(state)):
            total += linearisation_rows[i, j] * state[j]
        linearised[i] = total


@compiled_loops
def _select_rows(present: Bools, k: int, moments_beside_gyro: bool, used_rows: Ints, position: Ints) -> int:
    """Measured rows and how many; first moments only where they add to a gyro."""
    count = 0
    for row in range(ROWS):
        position[row] = -1
        redundant = _MOMENT <= row < _LATERAL and not moments_beside_gyro and present[k, _ROLL + row - _MOMENT]
        if present[k, row] and not redundant:
            used_rows[count], position[row] = row, count
            count += 1
    return count


@compiled_loops
def _linearise(
    const: FilterConstants, model: DiscreteModel, epochs: Epochs, k: int, work: _Workspace, count: int
) -> None:
    """``H`` of the used rows, with the tip's tilt linearised at the predicted state.

    Through the tilt gravity shows slow bending.
    """
    width = model.H.shape[1]
    for r in range(count):
        for j in range(width):
            work.H[r, j] = model.H[work.used_rows[r], j]
    for side in range(2):
        r = work.position[_VERTICAL + side]
        if r >= 0:
            tilt = -(epochs.vertical_mps2[k, side] * work.linearised[side] + epochs.lateral_mps2[k, side])
            for j in range(width):
                work.H[r, j] += tilt * model.linearisation_rows[side, j]
        r, bias = work.position[_LATERAL + side], const.lateral_bias_state[side]
        if r >= 0 and bias >= 0:
            work.H[r, bias] = epochs.lateral_gain[k, side]
        if r >= 0 and const.common_bias_column:
            # the slope seen is lateral over vertical force
            for tip in range(2):
                value = work.linearised[side] / epochs.vertical_mps2[k, side] * const.bias_projection[side, tip]
                work.H[r, const.vertical_bias_state[tip]] -= value


@compiled_loops
def _compute_innovation(
    const: FilterConstants,
    epochs: Epochs,
    k: int,
    state_and_sensitivity: Floats,
    one_and_bias: Floats,
    work: _Workspace,
    count: int,
    out: Floats,
    slot: int,
) -> None:
    """Innovation ``e`` of the used rows and its sensitivity ``D`` to the bias parameters."""
    width = state_and_sensitivity.shape[1]
    for r in range(count):
        row = work.used_rows[r]
        out[slot, r, 0] = epochs.rows[k, row]
        for j in range(1, width):
            out[slot, r, j] = -epochs.sensitivity[k, row, j - 1]
    for side in range(2):
        slope, rate, r = work.linearised[side], work.linearised[2 + side], work.position[_VERTICAL + side]
        if r >= 0:
            out[slot, r, 0] -= 0.5 * epochs.vertical_mps2[k, side] * slope * slope
            if const.roll_misalignment_column[side] and not epochs.present[k, _LATERAL + side]:
                # gravity along the lateral axis, by the predicted tilt: the axis itself would have measured it
                out[slot, r, const.roll_misalignment_column[side]] += (
                    (1.0 - 2.0 * side) * epochs.vertical_mps2[k, side] * slope
                )
        r = work.position[_LATERAL + side]
        if r >= 0:
            out[slot, r, 0] += epochs.slope_rate_gain[k, side] * rate
            if const.common_bias_column:
                out[slot, r, const.common_bias_column] += slope / epochs.vertical_mps2[k, side]
    for j in range(len(const.slope_factor_rows)):
        r = work.position[const.slope_factor_rows[j]]
        if r >= 0:
            out[slot, r, const.slope_factor_columns[j]] = work.linearised[4 + j]
    for r in range(count):
        for i in range(len(state_and_sensitivity)):
            value = work.H[r, i]
            if value != 0.0:
                for j in range(width):
                    out[slot, r, j] -= value * state_and_sensitivity[i, j]
    _regress_on_prediction(const, one_and_bias, work.position, work.row_innovation, out, slot)


@compiled_loops
def _regress_on_prediction(
    const: FilterConstants, one_and_bias: Floats, position: Ints, row_innovation: Floats, out: Floats, slot: int
) -> None:
    """Replace the measurement by its prediction in the sensitivities that contain it, in place."""
    for row in range(ROWS):
        row_innovation[row] = 0.0
        for j in range(len(one_and_bias) if position[row] >= 0 else 0):
            row_innovation[row] += out[slot, position[row], j] * one_and_bias[j]
    for j in range(len(const.regressor_rows)):
        row = const.regressor_rows[j]
        if position[row] >= 0:
            source = const.regressor_sources[j]
            out[slot, position[row], const.regressor_columns[j]] += const.regressor_signs[j] * row_innovation[source]


@compiled_loops
def _project_covariance(H: Floats, covariance: Floats, count: int, HP: Floats) -> None:
    """``H P``."""
    n = len(covariance)
    for r in range(count):
        for j in range(n):
            HP[r, j] = 0.0
        for i in range(n):
            value = H[r, i]
            if value != 0.0:
                for j in range(n):
                    HP[r, j] += value * covariance[i, j]


@compiled_loops
def _innovation_covariance(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    k: int,
    work: _Workspace,
    count: int,
    noise_inflation: float,
) -> None:
    """``S = H P H^T`` + inflated process noise + sensor noise of the used rows; lower half."""
    n = work.HP.shape[1]
    for r in range(count):
        row = work.used_rows[r]
        for q in range(r + 1):
            total = noise_inflation * model.process_noise_in_rows[row, work.used_rows[q]]
            for j in range(n):
                total += work.HP[r, j] * work.H[q, j]
            work.S[r, q] = total
        is_lateral = _LATERAL <= row < _ROLL
        work.S[r, r] += const.sensor_variance[row] * (
            epochs.lateral_gain[k, row - _LATERAL] ** 2 if is_lateral else 1.0
        )
        if row < _MOMENT:
            work.S[r, r] += noise_inflation * model.aliasing_variance * epochs.aliasing_noise[k, row - _VERTICAL]
        if row == _ROOT:
            work.S[r, r] += epochs.root_motion_variance[k, 2]
    for side in range(2):
        for side_2 in range(side + 1):
            r, q = work.position[_VERTICAL + side], work.position[_VERTICAL + side_2]
            if r >= 0 and q >= 0:
                work.S[r, q] += const.root_z_variance + epochs.root_motion_variance[k, 0]
            r, q = work.position[_LATERAL + side], work.position[_LATERAL + side_2]
            if r >= 0 and q >= 0:
                variance = const.root_y_variance + epochs.root_motion_variance[k, 1]
                work.S[r, q] += variance * epochs.lateral_gain[k, side] * epochs.lateral_gain[k, side_2]


@compiled_loops
def _cross_covariance(
    model: DiscreteModel, work: _Workspace, count: int, noise_inflation: float, out: Floats, slot: int
) -> None:
    """``C^T = H P A^T + H1 Q``, with inflated process noise."""
    for r in range(count):
        for i in range(model.cross_cov.shape[1]):
            out[slot, r, i] = noise_inflation * model.cross_cov[work.used_rows[r], i]
        for k in range(len(model.row)):
            out[slot, r, model.row[k]] += model.value[k] * work.HP[r, model.col[k]]


@compiled_loops
def _sum_innovation(one_and_bias: Floats, history: History, slot: int, work: _Workspace, count: int) -> None:
    """Innovations at the estimated bias parameters, with their covariance; both are noted in the history."""
    for row in range(ROWS):
        history.innovation[slot, row] = 0.0
        for other in range(row + 1):
            history.innovation_covariance[slot, row, other] = 0.0
    for r in range(count):
        total = 0.0
        for j in range(len(one_and_bias)):
            total += history.whitened_innovation[slot, r, j] * one_and_bias[j]
        work.innovation[r], work.predicted_variance[r] = total, work.S[r, r]
        row = work.used_rows[r]
        history.innovation[slot, row] = total
        for q in range(r + 1):
            history.innovation_covariance[slot, row, work.used_rows[q]] = work.S[r, q]


@compiled_loops
def _cholesky_and_whiten(work: _Workspace, count: int, robust: bool) -> bool:
    """Cholesky factor ``L`` of ``S`` in place, diagonal inverted, and the whitened innovation; False without one.

    ``robust``: the pivot of each row beyond the gate is raised until its innovation lies on the gate (Huber).
    """
    S = work.S
    for r in range(count):
        innovation = work.innovation[r]
        for q in range(r + 1):
            total = S[r, q]
            for j in range(q):
                total -= S[r, j] * S[q, j]
            if q < r:
                S[r, q] = total * S[q, q]
                innovation -= S[r, q] * work.whitened[q]
            elif not 0.0 < total < np.inf:
                return False
            else:
                if robust:
                    total = max(total, np.abs(innovation) * np.sqrt(total) / GATE_SIGMAS)
                S[r, r] = 1.0 / np.sqrt(total)
        work.whitened[r] = innovation * S[r, r]
    return True


@compiled_loops
def _gate(
    const: FilterConstants,
    epochs: Epochs,
    k: int,
    filter_state: FilterState,
    work: _Workspace,
    count: int,
    gate_excess: Floats,
    slot: int,
) -> bool:
    """Accumulate the NIS and note what teaches nothing; whether a row lies beyond the gate."""
    square_sum, gated = 0.0, False
    for row in range(ROWS):
        gate_excess[slot, row] = 0.0
    for r in range(count):
        squared = work.whitened[r] ** 2
        if squared > GATE_SIGMAS**2:
            gated = True
            beyond = np.abs(work.innovation[r]) - GATE_SIGMAS * np.sqrt(work.predicted_variance[r])
            gate_excess[slot, work.used_rows[r]] = np.sign(work.innovation[r]) * max(beyond, 0.0)
        row, by_root = work.used_rows[r], 0.0
        if row < _MOMENT:
            by_root = (1.0 + LOAD_VARIANCE_RATIO) * epochs.root_motion_variance[k, 0]
        elif row == _ROOT:
            by_root = epochs.root_motion_variance[k, 2]
        if by_root > 0.5 * work.predicted_variance[r]:
            gate_excess[slot, row] = work.innovation[r]
        square_sum += squared
    fade = 1.0 - const.step_s
    filter_state.nis_sums[0] = fade * filter_state.nis_sums[0] + min(square_sum, MAX_STEP_NIS)
    filter_state.nis_sums[1] = fade * filter_state.nis_sums[1] + count
    return gated


@compiled_loops
def _inflate_process_noise(model: DiscreteModel, work: _Workspace, count: int, before: float) -> float:
    """Factor on the process noise that puts the innovations of the gated vertical rows on the gate."""
    noise_inflation = before
    for r in range(count):
        row = work.used_rows[r]
        if row < _MOMENT and work.whitened[r] ** 2 > GATE_SIGMAS**2:
            uncovered = work.innovation[r] ** 2 - GATE_SIGMAS**2 * work.predicted_variance[r]
            noise_inflation = max(noise_inflation, before + uncovered / model.process_noise_in_rows[row, row])
    return min(noise_inflation, MAX_NOISE_INFLATION)


@compiled_loops
def _store_rows(H: Floats, count: int, out: Floats, slot: int) -> None:
    """Copy ``H`` of the used rows into the history."""
    for r in range(count):
        for j in range(out.shape[2]):
            out[slot, r, j] = H[r, j]


@compiled_loops
def _whiten(cholesky: Floats, count: int, rows: Floats, slot: int) -> None:
    """``L^-1`` times the rows, in place."""
    width = rows.shape[2]
    for r in range(count):
        for q in range(r):
            for j in range(width):
                rows[slot, r, j] -= cholesky[r, q] * rows[slot, q, j]
        for j in range(width):
            rows[slot, r, j] *= cholesky[r, r]


@compiled_loops
def _accumulate_information(information: Floats, whitened_innovation: Floats, slot: int, count: int) -> None:
    """Add ``[e | D]^T S^-1 [e | D]`` to the information about the bias parameters."""
    width = whitened_innovation.shape[2]
    for r in range(count):
        for i in range(width):
            value = whitened_innovation[slot, r, i]
            for j in range(width):
                information[i, j] += value * whitened_innovation[slot, r, j]


@compiled_loops
def _propagate_state(
    model: DiscreteModel, state_and_sensitivity: Floats, history: History, slot: int, count: int, product: Floats
) -> None:
    """``[x | V]`` after the step: ``A x + b u + C S^-1 e``, likewise for every column."""
    n, width = product.shape
    for i in range(n):
        for j in range(width):
            product[i, j] = 0.0
    _add_transition_product(model, state_and_sensitivity, product)
    for i in range(n):
        if model.static_input[i] != 0.0:
            for j in range(width):
                product[i, j] += model.static_input[i] * state_and_sensitivity[n, j]
        for r in range(count):
            value = history.whitened_cross_cov[slot, r, i]
            for j in range(width):
                product[i, j] += value * history.whitened_innovation[slot, r, j]
    for i in range(n):
        for j in range(width):
            state_and_sensitivity[i, j] = product[i, j]


@compiled_loops
def _add_transition_product(model: DiscreteModel, rows: Floats, out: Floats) -> None:
    """Add ``A rows`` to ``out``."""
    for k in range(len(model.row)):
        row, col, value = model.row[k], model.col[k], model.value[k]
        for j in range(out.shape[1]):
            out[row, j] += value * rows[col, j]


@compiled_loops
def _propagate_covariance(
    model: DiscreteModel,
    covariance: Floats,
    noise_inflation: float,
    whitened_cross_cov: Floats,
    slot: int,
    count: int,
    product: Floats,
) -> None:
    """``P = A P A^T + inflated Q - C S^-1 C^T``: the lower half, mirrored."""
    n = len(covariance)
    for i in range(n):
        for j in range(n):
            product[i, j] = 0.0
    _add_transition_product(model, covariance, product)
    _transpose(product)
    for i in range(n):
        for j in range(n):
            covariance[i, j] = noise_inflation * model.Q[i, j]
    _add_transition_product(model, product, covariance)
    for i in range(n):
        for r in range(count):
            value = whitened_cross_cov[slot, r, i]
            for j in range(i + 1):
                covariance[i, j] -= value * whitened_cross_cov[slot, r, j]
    for i in range(n):
        for j in range(i):
            covariance[j, i] = covariance[i, j]


@compiled_loops
def _transpose(square: Floats) -> None:
    """Transpose in place."""
    for i in range(len(square)):
        for j in range(i):
            square[i, j], square[j, i] = square[j, i], square[i, j]
