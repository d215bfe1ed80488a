"""State of a filter when its wing's parameters change under way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.model import WingParameters, build_model
from companion.core.tracking.parameters import ModeParameters, prior_parameters
from companion.core.tracking.rigid_body import Epochs
from companion.core.tracking.states import ROWS, make_layout, make_noise
from companion.params.files import load_airframe

AIRFRAME = load_airframe("nadir-2m")
STEP_S = 0.004
LAYOUT = make_layout(AIRFRAME)
NOISE = make_noise(AIRFRAME, LAYOUT, STEP_S)
OLD: WingParameters = (
    prior_parameters(LAYOUT.symmetric, AIRFRAME.wing.gust),
    prior_parameters(LAYOUT.antisymmetric, AIRFRAME.wing.gust),
)


def _changed(old: ModeParameters, by_hz: tuple[float, ...], by_damping: tuple[float, ...]) -> ModeParameters:
    """Frequencies and dampings of all modes times these factors."""
    factors = zip(old.modes, by_hz, by_damping, strict=True)
    modes = (replace(mode, frequency_hz=hz * mode.frequency_hz, damping=d * mode.damping) for mode, hz, d in factors)
    return replace(old, modes=tuple(modes))


NEW: WingParameters = (_changed(OLD[0], (1.12, 1.0), (1.6, 1.0)), _changed(OLD[1], (0.9, 1.1), (1.0, 1.0)))


def _filter() -> SeparatedBiasFilter:
    wing, rng = AIRFRAME.wing, np.random.default_rng(2)
    model = build_model(LAYOUT, NOISE, OLD, (-0.99, 0.99), STEP_S)
    kalman = SeparatedBiasFilter(LAYOUT, NOISE, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, 8)
    kalman.state_and_sensitivity[:, 0] = rng.normal(size=LAYOUT.size + 1)
    root = rng.normal(size=(LAYOUT.size, LAYOUT.size))
    kalman.covariance[:] = root @ root.T
    return kalman


def _acceleration_rows(parameters: WingParameters) -> np.ndarray:
    """Acceleration of every mode: load less damper less spring, which is at others at the static bend; (4, n + 1)."""
    rows = np.zeros((4, LAYOUT.size + 1))
    for k, (family, p) in enumerate(zip(LAYOUT.families, parameters, strict=True)):
        for rank, ((q, v), mode) in enumerate(zip(family.pairs, p.modes, strict=True)):
            omega, row = 2.0 * math.pi * mode.frequency_hz, rows[2 * k + rank]
            row[q], row[v], row[q + 3] = -(omega**2), -2.0 * mode.damping * omega, 1.0
    rows[0, LAYOUT.size] = -rows[0, LAYOUT.symmetric.q]
    return rows


def test_other_springs_and_dampers_change_neither_motion_nor_acceleration_nor_how_well_they_are_known() -> None:
    kalman = _filter()
    before, after, n = _acceleration_rows(OLD), _acceleration_rows(NEW), LAYOUT.size
    state_and_sensitivity, covariance = kalman.state_and_sensitivity.copy(), kalman.covariance.copy()
    kalman.switch_model(build_model(LAYOUT, NOISE, NEW, (-0.99, 0.99), STEP_S))
    np.testing.assert_allclose(
        after @ kalman.state_and_sensitivity, before @ state_and_sensitivity, rtol=1e-9, atol=1e-6
    )
    after_change, before_change = (
        rows[:, :n] @ spread @ rows[:, :n].T for rows, spread in ((after, kalman.covariance), (before, covariance))
    )
    np.testing.assert_allclose(after_change, before_change, rtol=1e-7, atol=1e-6 * np.abs(before_change).max())
    loads = [q + 2 + k for q, _ in LAYOUT.pairs for k in (0, 1)]
    others = np.delete(np.arange(n), loads)
    np.testing.assert_array_equal(kalman.state_and_sensitivity[others], state_and_sensitivity[others])
    np.testing.assert_array_equal(kalman.covariance[np.ix_(others, others)], covariance[np.ix_(others, others)])


def test_the_same_wing_again_changes_nothing() -> None:
    kalman = _filter()
    state_and_sensitivity, covariance = kalman.state_and_sensitivity.copy(), kalman.covariance.copy()
    kalman.switch_model(build_model(LAYOUT, NOISE, OLD, (-0.99, 0.99), STEP_S))
    np.testing.assert_array_equal(kalman.state_and_sensitivity, state_and_sensitivity)
    np.testing.assert_allclose(kalman.covariance, covariance, rtol=1e-12)


def test_what_was_learned_of_a_wandering_bias_ages_and_what_cannot_move_stays_learned() -> None:
    wing, othersless = AIRFRAME.wing, replace(NOISE, bias_time_s=1.0)
    model = build_model(LAYOUT, othersless, OLD, (-0.99, 0.99), STEP_S)
    kalman = SeparatedBiasFilter(LAYOUT, othersless, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, 8)
    sigma = LAYOUT.bias_parameter_sigma
    kalman._filter_state.information[1:, 1:] = np.diag(100.0 / sigma**2)
    kalman._filter_state.information[0, 1:] = kalman._filter_state.information[1:, 0] = (
        -100.0 / sigma
    )  # each is one sigma
    slopes = [name for name in LAYOUT.bias_parameters if name.startswith("slope.")]
    ages = np.array([name in ("root.bp", "root.br", *slopes) for name in LAYOUT.bias_parameters])
    # the root's errors, the tips' stamps and a bend per g that is calibrated are not learned
    names = [name for name in LAYOUT.bias_parameters if not name.startswith("root.") and not name.endswith(".tau")]
    stays = np.array([name in {*names} - {"bend_per_g", *slopes} for name in LAYOUT.bias_parameters])
    assert ages.sum() == 2 + len(slopes)
    assert len(slopes) == 3
    blind = _nothing_measured(500)
    for first, last in ((0, 25), (25, 50), (50, 75), (75, 325), (325, 500)):
        kalman.run(blind.span(first, last))
        age_s = (last - 25) * STEP_S  # since what was learned was first used
        estimate, spread = kalman.bias_parameters / sigma, np.diag(kalman._bias_covariance) / sigma**2
        np.testing.assert_allclose(estimate[stays], 100.0 / 101.0, rtol=1e-9)
        np.testing.assert_allclose(spread[stays], 1.0 / 101.0, rtol=1e-9)
        # a stationary Ornstein-Uhlenbeck process that was seen once
        np.testing.assert_allclose(estimate[ages], 100.0 / 101.0 * math.exp(-age_s), rtol=1e-9)
        np.testing.assert_allclose(spread[ages], 1.0 - 100.0 / 101.0 * math.exp(-2.0 * age_s), rtol=1e-9)


def test_a_state_that_hangs_on_a_bias_is_neither_moved_nor_made_surer_when_the_bias_ages() -> None:
    kalman = _filter()
    column = LAYOUT.bias_parameters.index("root.bp") + 1
    sigma = LAYOUT.bias_parameter_sigma[column - 1]
    kalman.state_and_sensitivity[:, 1:] = 0.0
    kalman.state_and_sensitivity[3, column] = 2.0 / sigma
    kalman._filter_state.information[column, column] = 100.0 / sigma**2
    kalman._filter_state.information[0, column] = kalman._filter_state.information[column, 0] = -100.0 / sigma
    kalman._solve_bias_parameters()
    state, variance = kalman.state[3], kalman.total_covariance[3, 3]
    for _ in range(50):
        kalman._age_wandering()
    kalman._solve_bias_parameters()
    assert kalman.state[3] == pytest.approx(state, rel=1e-9)
    assert kalman.total_covariance[3, 3] == pytest.approx(variance, rel=1e-9)


def _nothing_measured(count: int) -> Epochs:
    per_row, per_side = np.zeros((count, ROWS)), np.zeros((count, 2))
    return Epochs(
        start_ns=np.arange(count, dtype=np.int64) * 4_000_000,
        rows=per_row,
        present=np.zeros((count, ROWS), dtype=np.bool_),
        vertical_mps2=per_side,
        lateral_mps2=per_side,
        slope_rate_gain=per_side,
        lateral_gain=per_side,
        load_g=np.zeros(count),
        body_rate_radps=np.zeros((count, 3)),
        earlier_roll_radps2=np.zeros(count),
        earlier_load_g=np.zeros(count),
        sensitivity=np.zeros((count, ROWS, len(LAYOUT.bias_parameters))),
        aliasing_noise=per_side,
        root_motion_variance=np.zeros((count, 3)),
        root_vibrates=np.zeros(count, np.bool_),
        root_covered=np.zeros(count, np.bool_),
    )
