"""The filter's inner loop in numpy's matrix products: ``native/filter.c``.

One function per equation of :mod:`companion.core.tracking.filter`; ``test_tracking_kernel.py`` compares both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from companion.core.kernels.arrays import (
    GATE_SIGMAS,
    LOAD_FACTOR_TIME_S,
    LOAD_VARIANCE_RATIO,
    MAX_NOISE_INFLATION,
    MAX_STEP_NIS,
    MOST_TILT_RAD,
    STRUCK_SIGMAS,
    DiscreteModel,
    Epochs,
    FilterConstants,
    FilterState,
    History,
)
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT
from companion.records import Bools, Floats, Ints


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
    """Filter the epochs ``first:last``: see :func:`companion.core.kernels.filter_loops.filter_epochs`."""
    size = len(history.state)
    with np.errstate(over="ignore", invalid="ignore"):  # what has run away is found, and said
        return all(
            _filter_step(const, model, epochs, filter_state, history, k, (steps + k - first) % size)
            for k in range(first, last)
        )


def _filter_step(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    filter_state: FilterState,
    history: History,
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
    _static_bend(const, state_and_sensitivity[n], epochs.load_g[k])
    history.state[slot], history.covariance[slot] = state_and_sensitivity[:n], covariance
    history.transition_index[slot], history.static_m[slot] = model.transition_index, state_and_sensitivity[n]
    residual_columns = np.concatenate([epochs.rows[k][:, None], -epochs.sensitivity[k]], axis=1)
    H, state = model.H.copy(), state_and_sensitivity @ one_and_bias
    tips = _linearise(const, model, epochs, k, state, one_and_bias, residual_columns, H)
    used = _select_rows(model, epochs, k)
    H_used = H[used, :n]
    HP = H_used @ covariance
    innovation = residual_columns[used] - H[used] @ state_and_sensitivity
    slope = (model.linearisation_rows @ (state_and_sensitivity @ one_and_bias))[:2]
    gravity = slope[:, None] * (model.linearisation_rows[:2] @ state_and_sensitivity)
    shared = _shared_errors(const, model, epochs, k, state, tips, H)[used]
    _regress_on_prediction(const, used, innovation, innovation @ one_and_bias, shared, slope, gravity)
    row_innovation, HPHT = innovation @ one_and_bias, HP @ H_used.T
    struck = 0.0 if epochs.root_vibrates[k] else float(epochs.root_motion_variance[k, 0])
    noise_inflation = min(
        1.0 + LOAD_VARIANCE_RATIO * struck / float(model.load_noise_in_rows[Z_LEFT, Z_LEFT]), MAX_NOISE_INFLATION
    )
    S = HPHT + _measurement_noise(const, model, epochs, k, noise_inflation, state, one_and_bias)[np.ix_(used, used)]
    history.innovation[slot], history.innovation_covariance[slot] = 0.0, 0.0
    history.lateral_gain[slot] = epochs.lateral_gain[k]
    history.innovation[slot, used], history.innovation_covariance[slot][np.ix_(used, used)] = row_innovation, np.tril(S)
    cholesky = _cholesky(S)
    if cholesky is None:
        return False
    whitened = _whiten(cholesky, row_innovation)
    gate_square = _gate_square(filter_state, cholesky, innovation)
    gated = whitened**2 > gate_square
    gate_excess, predicted_variance = np.zeros(len(used)), np.diag(S)
    if gated.any():
        noise_inflation = _inflate_process_noise(
            model, used, gated, row_innovation, gate_square * predicted_variance, noise_inflation
        )
        gate_excess = _gate_excess(gated, row_innovation, gate_square * predicted_variance)
        S = HPHT + _measurement_noise(const, model, epochs, k, noise_inflation, state, one_and_bias)[np.ix_(used, used)]
        cholesky = _robust_cholesky(S, row_innovation, gate_square)
        if cholesky is None:
            return False
    by_root = np.zeros(ROWS)
    by_root[Z_LEFT:M_LEFT], by_root[P_ROOT] = ((1.0 + LOAD_VARIANCE_RATIO) * struck, epochs.root_motion_variance[k, 2])
    gate_excess = np.where(by_root[used] > 0.5 * predicted_variance, row_innovation, gate_excess)
    whitened_cross_cov = HP @ model.transition.T + model.cross_cov[used]
    whitened_cross_cov += (noise_inflation - 1.0) * model.load_cross_cov[used]
    H_used, innovation, whitened_cross_cov = (
        _whiten(cholesky, rows) for rows in (H_used, innovation, whitened_cross_cov)
    )
    _store(history, slot, H_used, innovation, whitened_cross_cov)
    history.gate_excess[slot] = 0.0
    history.gate_excess[slot, used] = gate_excess
    fade = 1.0 - const.step_s
    bound = MAX_STEP_NIS if gated.any() else np.inf
    filter_state.nis_sums[0] = fade * filter_state.nis_sums[0] + min(float(np.sum(whitened**2)), bound)
    filter_state.nis_sums[1] = fade * filter_state.nis_sums[1] + len(used)
    if not gated.any():
        filter_state.information[:] += innovation.T @ innovation
    state_and_sensitivity[:n] = (
        model.transition @ state_and_sensitivity[:n]
        + np.outer(model.static_input, state_and_sensitivity[n])
        + whitened_cross_cov.T @ innovation
    )
    covariance_after = (
        model.transition @ covariance @ model.transition.T
        + model.Q
        + (noise_inflation - 1.0) * model.load_noise
        - whitened_cross_cov.T @ whitened_cross_cov
    )
    covariance[:] = 0.5 * (covariance_after + covariance_after.T)
    up = used < M_LEFT
    by_tip = (by_root[used] > 0.5 * predicted_variance) & (row_innovation**2 >= STRUCK_SIGMAS**2 * predicted_variance)
    if up.sum() == 2 and by_tip[up].all():  # the root is struck
        covariance += model.motion_covariance
    return True


def _cholesky(S: Floats) -> Floats | None:
    """Lower Cholesky factor; None if the matrix is not positive definite."""
    if not np.isfinite(S.sum()):
        return None
    cholesky, failed = lapack.dpotrf(S, lower=1)
    return None if failed else cholesky


def _whiten(cholesky: Floats, rows: Floats) -> Floats:
    """``L^-1`` times the rows; LAPACK prints a complaint about a system without any."""
    return np.asarray(lapack.dtrtrs(cholesky, rows, lower=1)[0]).reshape(rows.shape) if len(rows) else rows


def _gate_square(filter_state: FilterState, cholesky: Floats, innovation: Floats) -> Floats:
    """Square of the gate by row, in variances of the whitened row: wider by the uncertain bias parameters."""
    at = filter_state.teachable
    whitened = _whiten(cholesky, innovation)
    D, row = whitened[:, 1 + at], whitened @ filter_state.one_and_bias
    by_parameters = np.sum(D @ filter_state.bias_covariance[np.ix_(at, at)] * D, axis=1)
    return GATE_SIGMAS**2 * np.where(row**2 > GATE_SIGMAS**2, 1.0 + np.maximum(by_parameters, 0.0), 1.0)


def _inflate_process_noise(
    model: DiscreteModel, used: Ints, gated: Bools, row_innovation: Floats, gate_variance: Floats, before: float
) -> float:
    """Factor on the process noise that adds what the gate leaves of a gated vertical row's square to its variance."""
    vertical = gated & (used < M_LEFT)
    uncovered = row_innovation**2 - gate_variance
    needed = uncovered[vertical] / np.diag(model.load_noise_in_rows)[used[vertical]]
    return min(before + float(np.max(needed, initial=0.0)), MAX_NOISE_INFLATION)


def _gate_excess(gated: Bools, row_innovation: Floats, gate_variance: Floats) -> Floats:
    """Signed part of each gated innovation beyond the gate."""
    return np.where(
        gated, np.sign(row_innovation) * np.maximum(np.abs(row_innovation) - np.sqrt(gate_variance), 0.0), 0.0
    )


def _robust_cholesky(S: Floats, row_innovation: Floats, gate_square: Floats) -> Floats | None:
    """Cholesky factor, row by row, with the pivot of each row beyond the gate raised by Huber's weight."""
    count = len(row_innovation)
    cholesky, whitened = np.zeros((count, count)), np.zeros(count)
    for r in range(count):
        for q in range(r):
            cholesky[r, q] = (S[r, q] - cholesky[r, :q] @ cholesky[q, :q]) / cholesky[q, q]
        pivot, innovation = (
            S[r, r] - cholesky[r, :r] @ cholesky[r, :r],
            row_innovation[r] - cholesky[r, :r] @ whitened[:r],
        )
        if not 0.0 < pivot < np.inf:
            return None
        pivot = max(pivot, abs(innovation) * np.sqrt(pivot / gate_square[r]))
        cholesky[r, r], whitened[r] = np.sqrt(pivot), innovation / np.sqrt(pivot)
    return cholesky


def _store(history: History, slot: int, H_used: Floats, innovation: Floats, whitened_cross_cov: Floats) -> None:
    """Whitened matrices of this step into the history."""
    count = len(H_used)
    history.row_count[slot] = count
    (
        history.whitened_H[slot, :count],
        history.whitened_innovation[slot, :count],
        history.whitened_cross_cov[slot, :count],
    ) = H_used, innovation, whitened_cross_cov


def _static_bend(const: FilterConstants, static_bend: Floats, load_g: float) -> None:
    """Static bend over the coming step and its sensitivities, in place."""
    static_bend[0] = const.trim_m + const.bend_per_g_m * load_g
    if const.trim_column:
        static_bend[const.trim_column] = 1.0
    if const.bend_column:
        static_bend[const.bend_column] += const.step_s / LOAD_FACTOR_TIME_S * (load_g - static_bend[const.bend_column])


def _linearise(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    k: int,
    state: Floats,
    one_and_bias: Floats,
    residual_columns: Floats,
    H: Floats,
) -> list[_MovingTip]:
    """Terms of innovation, sensitivity and ``H`` that depend on the predicted state, in place; both tips' motion."""
    linearised = model.linearisation_rows @ state
    vertical_mps2, slope, rate = epochs.vertical_mps2[k], linearised[:2], linearised[2:4]
    up, across = slice(Z_LEFT, Z_LEFT + 2), slice(Y_LEFT, Y_LEFT + 2)
    residual_columns[up, 0] -= 0.5 * vertical_mps2 * slope**2
    tips = [_moving_tip(const, model, epochs, k, side, state, one_and_bias) for side in (0, 1)]
    expected = [_expected_force(const, model, epochs, k, side, state, one_and_bias) for side in (0, 1)]
    force, by_state = (np.array(each) for each in zip(*expected, strict=True))
    for side, column in enumerate(const.roll_misalignment_column.tolist()):
        if column:  # of the lateral force the Jacobian has the rigid one: here is the rest
            rest = (1.0 - 2.0 * side) * vertical_mps2[side] * slope[side] + force[side]
            residual_columns[Z_LEFT + side, column] += rest
    for side, column in enumerate(const.height_column.tolist()):
        if column:  # the force has it at the estimate
            sensitivity = epochs.sensitivity[k, Y_LEFT + side, column - 1]
            residual_columns[Y_LEFT + side, 0] += sensitivity * one_and_bias[column]
    residual_columns[across, 0] += epochs.slope_rate_gain[k] * rate
    for side, tip in enumerate(tips):
        residual_columns[Y_LEFT + side, 0] += tip.rest
        columns = (const.foreshortening_column, const.further_foreshortening_column)
        for column, per_error in zip(columns, tip.per_foreshortening, strict=True):
            if column:  # the rows have it at the estimate, and column 0 is that of no error
                residual_columns[Y_LEFT + side, column] -= per_error
                residual_columns[Y_LEFT + side, 0] += per_error * one_and_bias[column]
        H[Y_LEFT + side] += tip.row
        for at, by_acceleration in zip((side, 1 - side), tip.by_acceleration, strict=True):
            if (bias := int(const.vertical_bias_state[at])) >= 0:
                H[Y_LEFT + side, bias] += by_acceleration
            residual_columns[Y_LEFT + side, 1:] -= by_acceleration * epochs.sensitivity[k, Z_LEFT + at]
        residual_columns[Y_LEFT + side, const.regressor_columns[const.regressor_rows == Z_LEFT + side]] -= tip.by_force
    for side in (0, 1) if const.common_bias_column else ():
        if epochs.present[k, Y_LEFT + side]:
            # the slope seen is lateral over vertical force, of which the tip's own is over the measured one
            per_bias = slope[side] / vertical_mps2[side]
            residual_columns[Y_LEFT + side, const.common_bias_column] += per_bias
            H[Y_LEFT + side, const.vertical_bias_state] -= per_bias * const.bias_projection[side]
    lateral = epochs.lateral_mps2[k] + np.array([1.0, -1.0]) * force
    H[up] -= (vertical_mps2 * slope + lateral)[:, None] * model.linearisation_rows[:2]
    tilted = np.array([1.0, -1.0]) * slope
    H[up] -= tilted[:, None] * by_state
    residual_columns[up, 0] -= tilted * (by_state @ state)
    lift_rows, p = _lift_rows(const, model), float(linearised[4])
    H[up] += _turn_squared(epochs, k, p) * lift_rows + 2.0 * p * np.outer(
        lift_rows @ state, model.linearisation_rows[4]
    )
    residual_columns[up, 0] += 2.0 * p**2 * (lift_rows @ state)
    for side, bias in enumerate(const.lateral_bias_state.tolist()):
        if bias >= 0:
            H[Y_LEFT + side, bias] = epochs.lateral_gain[k, side]
    residual_columns[const.slope_factor_rows, const.slope_factor_columns] = linearised[
        6 + 6 * const.foreshortening_pm.shape[1] :
    ]
    return tips


def _foreshortening_factors(const: FilterConstants, one_and_bias: Floats) -> Floats:
    """Estimated over believed way inboard by pairs of ranks, (r, r)."""
    lowest, further = (
        1.0 + one_and_bias[column] if column else 1.0
        for column in (const.foreshortening_column, const.further_foreshortening_column)
    )
    factors = np.full(const.foreshortening_pm.shape[1:], further)
    factors[0, 0] = lowest
    return factors


def _lift_rows(const: FilterConstants, model: DiscreteModel) -> Floats:
    """Rows (2, n + 1) of the linearisation that give both tips' lift by all ranks."""
    end = 6 + 6 * const.foreshortening_pm.shape[1]
    return np.stack([model.linearisation_rows[6 + side : end : 6].sum(axis=0) for side in (0, 1)])


def _turn_squared(epochs: Epochs, k: int, p: float) -> float:
    """Square of the body's turn about x and y, by which a lifted tip feels a downward force."""
    return p**2 + float(epochs.body_rate_radps[k, 1]) ** 2


class _MovingTip(NamedTuple):
    """Slope by a lateral force of a tip's motion in the turning body: row (n + 1,), what that leaves, derivatives."""

    row: Floats
    rest: float
    per_foreshortening: tuple[float, float]
    variance_mps2_2: float
    blow_variance_mps2_2: float
    per_measured: float
    by_acceleration: Floats
    by_force: float
    by_roll_acceleration: float


def _moving_tip(
    const: FilterConstants, model: DiscreteModel, epochs: Epochs, k: int, side: int, state: Floats, one_and_bias: Floats
) -> _MovingTip:
    """``2 p w' + (p' - q r) w - d2/dt2 (w K w) / 2`` of the ranks' lifts w, linear in what the state has of it.

    Derivatives have the root's ``p'`` of some epochs before, and accelerations found with it: the state's ``p'``,
    estimated from the same tips, is noisy, and its error is in the rows.
    """
    ranks, linearised = const.foreshortening_pm.shape[1], model.linearisation_rows @ state
    lift_rows, rate_rows, accel_rows = np.stack(
        [model.linearisation_rows[6 + 6 * rank + side : 12 + 6 * rank : 2] for rank in range(ranks)], axis=1
    )
    p_row, a_row = model.linearisation_rows[4:6]
    lift, rate, accel = np.stack([linearised[6 + 6 * rank + side : 12 + 6 * rank : 2] for rank in range(ranks)], axis=1)
    p, p_dot = float(linearised[4]), float(linearised[5])
    believed = const.foreshortening_pm[side]
    factors = _foreshortening_factors(const, one_and_bias)
    K = believed * factors
    slope = float(linearised[side])
    by_gyros = -float(epochs.body_rate_radps[k, 1] * epochs.body_rate_radps[k, 2])
    turning = p_dot + by_gyros
    step_s = const.step_s
    height_column = int(const.height_column[side])
    height = float(one_and_bias[height_column]) if height_column else 0.0
    raised = lift.sum() + height
    of_this, of_other, covariance = _rank_shares(model, epochs.present[k, Z_LEFT : Z_LEFT + 2], side)
    beyond = [_beyond_expected(const, model, epochs, k, tip, state) for tip in (side, 1 - side)]
    accel = accel + of_this * beyond[0] + of_other * beyond[1]
    lever_m = of_this * float(const.lever_m[side]) + of_other * float(const.lever_m[1 - side])
    instruments = accel + lever_m * (float(epochs.earlier_roll_radps2[k]) - p_dot)
    inside_mps = -step_s * (of_this * epochs.rows[k, M_LEFT + side] + of_other * epochs.rows[k, M_LEFT + 1 - side])
    rate = rate + 0.5 * step_s * accel - inside_mps
    inside = K @ inside_mps
    quarter_s2 = 0.25 * step_s**2
    mean_lift = lift + quarter_s2 * accel - 0.5 * step_s * inside_mps
    by_lift, by_rate = K @ accel, K @ rate
    along = mean_lift @ K @ accel + rate @ K @ rate + rate @ inside
    inward = np.outer(mean_lift, instruments) + np.outer(rate, rate + inside_mps)
    by_lowest, by_all = float(believed[0, 0] * inward[0, 0]), float(np.sum(believed * inward))
    per_accel = -step_s * by_rate - lift @ K
    apart = per_accel - of_this @ per_accel
    variance, blow_variance = (float(apart @ C @ apart) for C in (covariance, model.lift_acceleration_covariance[2]))
    per_accel = per_accel - 2.0 * quarter_s2 * by_lift
    sign, per_measured, per_other = 1.0 - 2.0 * side, float(of_this @ per_accel), float(of_other @ per_accel)
    along += per_measured * sign * slope * (2.0 * p * rate.sum() + turning * raised - along)
    force = 2.0 * p * rate.sum() + turning * raised - along
    row = (epochs.earlier_roll_radps2[k] + by_gyros - K @ instruments) @ lift_rows
    row = row + (2.0 * (p - K @ rate) - inside) @ rate_rows
    row = row + (per_accel - per_measured) @ accel_rows + 2.0 * rate.sum() * p_row
    row = row - per_other * model.linearisation_rows[11 - side : 6 + 6 * ranks : 6].sum(axis=0)
    by_roll = per_measured * float(const.lever_m[side]) + per_other * float(const.lever_m[1 - side])
    row = row + (raised + by_roll) * a_row  # the roll lifts the tips as well
    gain, read = float(epochs.lateral_gain[k, side]), float(epochs.rows[k, Y_LEFT + side])
    turned = 0.5 * slope**2 * (force + sign * float(epochs.lateral_mps2[k, side]))
    lean = math.tan(read) - gain * (force + turned)
    gain /= 1.0 + lean**2
    return _MovingTip(
        gain * row,
        math.atan(lean) - read + gain * float(row @ state),
        (-gain * by_lowest, -gain * (by_all - by_lowest)),
        variance,
        blow_variance,
        per_measured + per_other,
        gain * np.array([per_measured, per_other]),
        gain * force,
        gain * (raised + by_roll),
    )


def _expected_force(
    const: FilterConstants, model: DiscreteModel, epochs: Epochs, k: int, side: int, state: Floats, one_and_bias: Floats
) -> tuple[float, Floats]:
    """Lateral force of a moving tip by the predicted state alone, and its derivatives by that (n + 1,)."""
    rows, end = model.linearisation_rows, 6 + 6 * const.foreshortening_pm.shape[1]
    lift_rows, rate_rows, accel_rows = (rows[first + side : end : 6] for first in (6, 8, 10))
    lift, rate, accel = lift_rows @ state, rate_rows @ state, accel_rows @ state
    p, p_dot = rows[4:6] @ state
    K = const.foreshortening_pm[side] * _foreshortening_factors(const, one_and_bias)
    by_gyros = -float(epochs.body_rate_radps[k, 1] * epochs.body_rate_radps[k, 2])
    height_column = int(const.height_column[side])
    raised = lift.sum() + (one_and_bias[height_column] if height_column else 0.0)
    force = 2.0 * p * rate.sum() + (p_dot + by_gyros) * raised - lift @ K @ accel - rate @ K @ rate
    if abs(float(rows[side] @ state)) > MOST_TILT_RAD:
        return float(force), np.zeros(rows.shape[1])
    by_state = (epochs.earlier_roll_radps2[k] + by_gyros - K @ accel) @ lift_rows
    by_state = by_state + 2.0 * (p - K @ rate) @ rate_rows - (lift @ K) @ accel_rows
    return float(force), by_state + 2.0 * rate.sum() * rows[4] + raised * rows[5]


def _rank_shares(model: DiscreteModel, measured: Bools, side: int) -> tuple[Floats, Floats, Floats]:
    """Shares (r,) of the ranks in what this tip and the other show beyond the expected; the covariance left (r, r)."""
    alone, of_this, of_other = model.lift_acceleration_share
    if not measured[side]:
        return 0.0 * alone, 0.0 * alone, model.lift_acceleration_covariance[2]
    if not measured[1 - side]:
        return alone, 0.0 * alone, model.lift_acceleration_covariance[1]
    return of_this, of_other, model.lift_acceleration_covariance[0]


def _beyond_expected(
    const: FilterConstants, model: DiscreteModel, epochs: Epochs, k: int, side: int, state: Floats
) -> float:
    """Excess of the measured sum of all ranks' lift accelerations of a tip over the expected one."""
    linearised = model.linearisation_rows @ state
    lift, _, accel = linearised[6 + side : 6 + 6 * const.foreshortening_pm.shape[1]].reshape(-1)[::2].reshape(-1, 3).T
    slope, p, p_dot = float(linearised[side]), float(linearised[4]), float(linearised[5])
    tilted = 0.5 * float(epochs.vertical_mps2[k, side]) * slope**2 + float(epochs.lateral_mps2[k, side]) * slope
    measured = float(const.lever_m[side]) * p_dot - float(epochs.rows[k, Z_LEFT + side]) - tilted
    return measured + _turn_squared(epochs, k, p) * float(lift.sum()) - float(accel.sum())


def _select_rows(model: DiscreteModel, epochs: Epochs, k: int) -> Ints:
    """Measured rows; first moments only where they add to a gyro."""
    used = epochs.present[k].copy()
    if not model.moments_beside_gyro:
        used[M_LEFT:Y_LEFT] &= ~used[P_LEFT : P_LEFT + 2]
    return np.flatnonzero(used)


def _measurement_noise(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    k: int,
    noise_inflation: float,
    state: Floats,
    one_and_bias: Floats,
) -> Floats:
    """Covariance (9, 9) of the rows by inflated process noise, sensors, aliasing and root motion."""
    out = model.process_noise_in_rows + (noise_inflation - 1.0) * model.load_noise_in_rows
    variance, gain, root_motion_variance = (
        const.sensor_variance.copy(),
        epochs.lateral_gain[k],
        epochs.root_motion_variance[k],
    )
    tips = [_moving_tip(const, model, epochs, k, side, state, one_and_bias) for side in (0, 1)]
    moving = np.array([tip.variance_mps2_2 + (noise_inflation - 1.0) * tip.blow_variance_mps2_2 for tip in tips])
    moving += np.array([tip.per_measured for tip in tips]) ** 2 * root_motion_variance[0]
    variance[Y_LEFT:P_LEFT] = (variance[Y_LEFT:P_LEFT] + moving) * gain**2
    variance[Z_LEFT:M_LEFT] += noise_inflation * model.aliasing_variance * epochs.aliasing_noise[k]
    variance[P_ROOT] += root_motion_variance[2]
    out[range(ROWS), range(ROWS)] += variance
    out[Z_LEFT:M_LEFT, Z_LEFT:M_LEFT] += const.root_z_variance + root_motion_variance[0]
    out[Y_LEFT:P_LEFT, Y_LEFT:P_LEFT] += (const.root_y_variance + root_motion_variance[1]) * np.outer(gain, gain)
    return out


def _shared_errors(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    k: int,
    state: Floats,
    tips: list[_MovingTip],
    H: Floats,
) -> Floats:
    """Errors of the predicted rows by the load factor and of slopes by the roll acceleration, against earlier means."""
    roll = float(model.linearisation_rows[5] @ state) - float(epochs.earlier_roll_radps2[k])
    errors = H[:, -1] * const.bend_per_g_m * (epochs.load_g[k] - epochs.earlier_load_g[k])
    errors[Y_LEFT : Y_LEFT + 2] += np.array([tip.by_roll_acceleration for tip in tips]) * roll
    return np.asarray(errors)


def _regress_on_prediction(
    const: FilterConstants,
    used: Ints,
    innovation: Floats,
    row_innovation: Floats,
    shared: Floats,
    slope: Floats,
    gravity: Floats,
) -> None:
    """Replace the measurement by its prediction in the sensitivities that contain it, in place.

    ``shared`` (m,) are errors of the prediction that the innovation has too. ``gravity`` (2, 1 + c) are the columns
    of the vertical rows by which the vertical force shows the tilt ``slope``
    (2,), per unit of that force.
    """
    position = {row: at for at, row in enumerate(used.tolist())}
    rows, columns, sources = const.regressor_rows, const.regressor_columns, const.regressor_sources
    entries = zip(rows.tolist(), columns.tolist(), sources.tolist(), const.regressor_signs, strict=True)
    for row, column, source, sign in entries:
        if row in position and source in position:
            at = position[source]
            innovation[position[row], column] += sign * (row_innovation[at] + shared[at])
    for side, column in enumerate(const.roll_misalignment_column.tolist()):
        at = position.get(Z_LEFT + side)
        if at is None:
            continue
        innovation[at, 1:] -= row_innovation[at] * gravity[side, 1:]
        if column:
            innovation[at, column] -= (1.0 - 2.0 * side) * slope[side] * row_innovation[at]
