"""Constants and discrete model of the filter as the arrays that its inner loop reads."""

from __future__ import annotations

import numpy as np

from companion.core.kernels.arrays import DiscreteModel, FilterConstants
from companion.core.tracking.error_jacobians import measured_regressors
from companion.core.tracking.model import DiscreteWingModel, lift_rows
from companion.core.tracking.states import P_LEFT, Y_LEFT, Z_LEFT, SensorNoise, StateLayout
from companion.core.wing.foreshortening import foreshortening_pm
from companion.records import Floats, Ints


def kernel_model(
    layout: StateLayout, model: DiscreteWingModel, transition: Floats, transition_index: int
) -> DiscreteModel:
    """Discrete model with its ``transition`` (n, n), which is stored under an index, and the rows to linearise at."""
    fraction, left_open = _rank_shares(layout, model)
    row, col = (np.ascontiguousarray(index) for index in np.nonzero(transition))
    return DiscreteModel(
        transition=transition,
        static_input=np.ascontiguousarray(model.transition[:, layout.size]),
        row=row,
        col=col,
        value=transition[row, col],
        transition_index=transition_index,
        H=np.ascontiguousarray(model.H),
        Q=np.ascontiguousarray(model.noise),
        cross_cov=np.ascontiguousarray(model.cross_cov.T),
        process_noise_in_rows=np.ascontiguousarray(model.process_noise_in_rows),
        load_noise=np.ascontiguousarray(model.load_noise),
        load_cross_cov=np.ascontiguousarray(model.load_cross_cov.T),
        load_noise_in_rows=np.ascontiguousarray(model.load_noise_in_rows),
        linearisation_rows=_linearisation_rows(layout, model),
        aliasing_variance=model.aliasing_variance,
        moments_beside_gyro=model.moments_beside_gyro,
        lift_acceleration_share=fraction,
        lift_acceleration_covariance=left_open,
        motion_covariance=model.motion_covariance,
    )


def _linearisation_rows(layout: StateLayout, model: DiscreteWingModel) -> Floats:
    """Rows (r, n + 1) on the state before a step that give what the measurement is linearised at.

    Slopes, slope rates, roll rate and roll acceleration in the middle of a step; for each rank of modes lifts,
    extrapolated to there by the rates as it begins, these rates, and expected lift accelerations; then the change of
    each tip's slope and slope rate with its slope factors. A roll rate that no station sends is 0 there: the filter
    would learn it from the small forces that are products with it, and be sure of a wrong one.
    """
    ahead, now = model.transition, np.eye(layout.size, layout.size + 1)
    middle, rate = 0.5 * (now + ahead), (ahead - now) / model.step_s
    roll = middle[layout.roll_rate : layout.roll_accel + 1] * [[float(layout.senses_roll)], [1.0]]
    rows = [model.slope @ middle, model.slope @ rate, roll]
    for lift, lift_rate in (lift_rows(layout, rank) for rank in range(layout.ranks)):
        rising = lift_rate @ now
        rows += [lift @ now + 0.5 * model.step_s * rising, rising, lift_rate @ rate]
    for _, q, _, sign in layout.slope_factors:
        for side, sense_of_rotation in ((0, 1.0), (1, -1.0)):
            rows += [-sign[side] * middle[q : q + 1], -sense_of_rotation * sign[side] * rate[q : q + 1]]
    return np.ascontiguousarray(np.concatenate(rows))


def _rank_shares(layout: StateLayout, model: DiscreteWingModel) -> tuple[Floats, Floats]:
    """Shares (3, r) and covariances (3, r, r) of the ranks' accelerations: see ``DiscreteModel``.

    Tips that are both measured tell the families' sums apart, as half of their sum and of their difference.
    """
    by_family = np.zeros((2, layout.ranks, layout.ranks))
    for family, covariance in zip(layout.families, by_family, strict=True):
        rates = [v for _, v in family.pairs]
        covariance[: len(rates), : len(rates)] = model.noise[np.ix_(rates, rates)] / model.step_s**2
    of_tip = by_family.sum(axis=0)
    alone, left_open = given_sum(of_tip)
    (symmetric, open_symmetric), (antisymmetric, open_antisymmetric) = map(given_sum, by_family)
    fraction = np.stack([alone, 0.5 * (symmetric + antisymmetric), 0.5 * (symmetric - antisymmetric)])
    return fraction, np.stack([open_symmetric + open_antisymmetric, left_open, of_tip])


def given_sum(covariance: Floats) -> tuple[Floats, Floats]:
    """Regression of jointly Gaussian terms on their sum.

    Parameters
    ----------
    covariance : (r, r) float64
        Of the terms.

    Returns
    -------
    fraction : (r,) float64
        Part of a deviation of the sum that each term is expected to have; they add up to one.
    covariance : (r, r) float64
        What the sum leaves open.
    """
    with_sum = covariance.sum(axis=1)
    total = float(with_sum.sum())
    fraction = with_sum / total if total > 0.0 else np.eye(len(covariance))[0]
    return fraction, covariance - np.outer(fraction, with_sum)


def kernel_constants(
    layout: StateLayout, noise: SensorNoise, model: DiscreteWingModel, trim_m: float, bend_per_g_m: float
) -> FilterConstants:
    """Constants of the filter's inner loop, for one airframe."""
    bias_states = dict(layout.row_bias_states)
    factors = [
        (row + side, column) for column, _, _, _ in layout.slope_factors for side in (0, 1) for row in (Y_LEFT, P_LEFT)
    ]
    regressors = measured_regressors(layout)
    return FilterConstants(
        step_s=model.step_s,
        trim_m=trim_m,
        bend_per_g_m=bend_per_g_m,
        root_z_variance=noise.root_z_variance,
        root_y_variance=noise.root_y_variance,
        trim_column=layout.column("trim") or 0,
        bend_column=layout.column("bend_per_g") or 0,
        sensor_variance=noise.sensor_variance,
        lateral_bias_state=np.array([bias_states.get(Y_LEFT + side, -1) for side in (0, 1)], np.int64),
        roll_misalignment_column=_tip_columns(layout, "mx"),
        vertical_bias_state=np.array([bias_states.get(Z_LEFT + side, -1) for side in (0, 1)], np.int64),
        bias_projection=noise.bias_projection,
        common_bias_column=layout.column("bz") or 0,
        slope_factor_rows=np.array([row for row, _ in factors], np.int64),
        slope_factor_columns=np.array([column for _, column in factors], np.int64),
        regressor_rows=np.array([row for row, _, _, _ in regressors], np.int64),
        regressor_columns=np.array([column for _, column, _, _ in regressors], np.int64),
        regressor_sources=np.array([source for _, _, source, _ in regressors], np.int64),
        regressor_signs=np.array([sign for _, _, _, sign in regressors], np.float64),
        lever_m=np.array(model.lever_y_m),
        foreshortening_pm=np.stack([_foreshortening_pm(layout, y_m) for y_m in layout.tip_y_m]),
        foreshortening_column=layout.column("shortening") or 0,
        further_foreshortening_column=layout.column("further_shortening") or 0,
        height_column=_tip_columns(layout, "height"),
    )


def _foreshortening_pm(layout: StateLayout, tip_y_m: float) -> Floats:
    """Signed foreshortening of a tip by each pair of ranks."""
    slope_factors = [layout.slope_factor(rank).value for rank in range(layout.ranks)]
    ranks = tuple(range(layout.ranks))
    return np.asarray(np.sign(tip_y_m) * layout.foreshortening * foreshortening_pm(ranks, tip_y_m, slope_factors))


def _tip_columns(layout: StateLayout, error: str) -> Ints:
    """Columns of an error of the left and right tip's sensor, 0 where it is certain, (2,)."""
    return np.array([layout.column(f"{place}.{error}") or 0 for place in ("left", "right")], np.int64)
