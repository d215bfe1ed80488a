"""The filter's inner loop: the compiled one and numpy's say the same, whatever rows are missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.core.kernels import filter_loops as kernel_loops
from companion.core.kernels.arrays import DiscreteModel, Epochs, FilterConstants, FilterState, History
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.kernel_arrays import given_sum
from companion.core.tracking.model import build_model, propagation
from companion.core.tracking.parameters import ModeParameters, prior_parameters
from companion.core.tracking.row_noise import RowNoise
from companion.core.tracking.states import M_LEFT, P_LEFT, ROWS, Y_LEFT, Z_LEFT, make_layout, make_noise
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Floats
from sitl_tests.reference.kernels import filter_numpy as kernel_numpy

AIRFRAME = load_airframe("nadir-2m")
EXACT_SCALES = replace(
    AIRFRAME, left=replace(AIRFRAME.left, accel_scale_sigma=0.0), right=replace(AIRFRAME.right, accel_scale_sigma=0.0)
)
STEP_S = 0.004
STEPS = 60


def _filter(airframe: Airframe = AIRFRAME) -> SeparatedBiasFilter:
    layout, wing = make_layout(airframe), airframe.wing
    noise = make_noise(airframe, layout, STEP_S)
    parameters = (prior_parameters(layout.symmetric, wing.gust), prior_parameters(layout.antisymmetric, wing.gust))
    model = build_model(layout, noise, parameters, (-0.99, 0.99), STEP_S)
    return SeparatedBiasFilter(layout, noise, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, STEPS)


def _flown(kalman: SeparatedBiasFilter) -> Floats:
    """Rows (STEPS, ROWS) without noise that the filter's own model makes by chance.

    The wing moves so little that its way inboard, a square of it that these linear rows lack, is small.
    """
    rng, model = np.random.default_rng(8), kalman._discrete_model
    state, rows = 0.1 * np.linalg.cholesky(kalman.covariance) @ rng.standard_normal(len(model.Q)), []
    for _ in range(STEPS):
        rows.append(model.H[:, :-1] @ state)
        state = model.transition @ state + rng.multivariate_normal(np.zeros(len(model.Q)), model.Q)
    return np.array(rows)


def _epochs(kalman: SeparatedBiasFilter, missing: float) -> Epochs:
    """Rows of a flown wing, a tenth of them far beyond the gate, a share missing, at every step others."""
    rng, parameters = np.random.default_rng(7), len(kalman.bias_parameters)
    size = np.array([0.1, 0.1, 0.01, 0.01, 0.001, 0.001, 0.003, 0.003, 0.003])
    size = size * np.where(rng.random((STEPS, ROWS)) < 0.1, 6.0, 1.0)
    present = rng.random((STEPS, ROWS)) >= missing
    return Epochs(
        start_ns=4_000_000 * np.arange(STEPS),
        rows=np.where(present, _flown(kalman) + size * rng.standard_normal((STEPS, ROWS)), 0.0),
        present=present,
        vertical_mps2=-9.8 + rng.standard_normal((STEPS, 2)),
        lateral_mps2=0.3 * rng.standard_normal((STEPS, 2)),
        slope_rate_gain=1e-3 * rng.standard_normal((STEPS, 2)),
        lateral_gain=np.array([-0.1, 0.1]) * (1.0 + 0.1 * rng.standard_normal((STEPS, 2))),
        load_g=(load_g := 0.2 * rng.standard_normal(STEPS)),
        body_rate_radps=np.zeros((STEPS, 3)),
        earlier_roll_radps2=rng.standard_normal(STEPS),
        earlier_load_g=load_g + 0.01 * np.random.default_rng(9).standard_normal(STEPS),
        sensitivity=present[:, :, None] * rng.standard_normal((STEPS, ROWS, parameters)),
        aliasing_noise=rng.random((STEPS, 2)),
        root_motion_variance=np.where(rng.random((STEPS, 1)) < 0.2, np.array([1.0, 0.1, 0.01]), 0.0),
        root_vibrates=rng.random(STEPS) < 0.3,
        root_covered=np.ones(STEPS, np.bool_),
    )


def _believed(kalman: SeparatedBiasFilter) -> Floats:
    """``[1; c]`` of bias parameters without an error."""
    return np.eye(1, 1 + len(kalman.bias_parameters))[0]


def _linearised(kalman: SeparatedBiasFilter, epochs: Epochs, at: Floats, first: int) -> tuple[Floats, Floats]:
    """Innovations of both tips' rows from ``first`` on in epoch 5, and their derivative by the state, sign turned."""
    const, model, _, _ = _kernel_arguments(kalman)
    residual, H = np.zeros((ROWS, 1 + len(kalman.bias_parameters))), model.H.copy()
    residual[:, 0] = epochs.rows[5]
    kernel_numpy._linearise(const, model, epochs, 5, at, _believed(kalman), residual, H)
    return (residual[:, 0] - H @ at)[first : first + 2], H[first : first + 2]


def _kernel_arguments(kalman: SeparatedBiasFilter) -> tuple[FilterConstants, DiscreteModel, FilterState, History]:
    return kalman._constants, kalman._discrete_model, kalman._filter_state, kalman.history


@pytest.mark.parametrize("moments_beside_gyro", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("airframe", [AIRFRAME, EXACT_SCALES], ids=["uncertain scales", "exact scales"])
def test_compiled_loops_and_numpy_agree(airframe: Airframe, missing: float, moments_beside_gyro: bool) -> None:
    """Each step begins where the compiled one left: rounding does not grow along the run."""
    compiled, plain = _filter(airframe), _filter(airframe)
    epochs = _epochs(compiled, missing)
    for k in range(STEPS):
        for before, after in zip(plain._filter_state, compiled._filter_state, strict=True):
            before[...] = after
        for kalman, kernel in ((compiled, kernel_loops), (plain, kernel_numpy)):
            const, model, filter_state, history = _kernel_arguments(kalman)
            model = model._replace(moments_beside_gyro=moments_beside_gyro)
            assert kernel.filter_epochs(const, model, epochs, filter_state, history, k, k + 1, k)
        for name in FilterState._fields:
            result, expected = getattr(compiled._filter_state, name), getattr(plain._filter_state, name)
            np.testing.assert_allclose(result, expected, rtol=1e-7, atol=1e-10 * np.abs(expected).max(), err_msg=name)
    np.testing.assert_array_equal(compiled.history.row_count, plain.history.row_count)
    for at, row_count in enumerate(compiled.history.row_count):
        for name in ("whitened_H", "whitened_innovation", "whitened_cross_cov"):
            result, expected = (
                getattr(compiled.history, name)[at, :row_count],
                getattr(plain.history, name)[at, :row_count],
            )
            np.testing.assert_allclose(result, expected, atol=1e-9 * max(np.abs(expected).max(initial=0.0), 1e-6))


def _after(kalman: SeparatedBiasFilter, tips_mps2: tuple[float, float], root_mps2: float) -> Floats:
    """Covariance after an epoch in which the tips show so much, and the root moves so much unresolved."""
    epochs, at = _epochs(kalman, 0.0), 30
    rows, root = epochs.rows.copy(), np.zeros_like(epochs.root_motion_variance)
    rows[:at] = _flown(kalman)[:at]
    rows[at, Z_LEFT : Z_LEFT + 2], root[at, 0] = tips_mps2, root_mps2**2
    const, model, state, history = _kernel_arguments(kalman)
    as_believed = np.zeros_like(epochs.sensitivity)
    epochs = epochs._replace(rows=rows, root_motion_variance=root, sensitivity=as_believed)
    plain = [array.copy() for array in state]
    assert kernel_loops.filter_epochs(const, model, epochs, state, history, 0, at + 1, 0)
    twin = FilterState(*plain)
    assert kernel_numpy.filter_epochs(const, model, epochs, twin, history, 0, at + 1, 0)
    np.testing.assert_allclose(state.covariance, twin.covariance, rtol=1e-6, atol=1e-12)
    return state.covariance


@pytest.mark.parametrize(
    ("tips_mps2", "root_mps2", "forgotten"),
    [
        ((90.0, 90.0), 0.0, False),  # a gust explains it
        ((90.0, 90.0), 8.0, True),
        ((90.0, 0.0), 8.0, False),  # not of the root
        ((15.0, 15.0), 8.0, False),  # no more than the root moves
    ],
)
def test_a_struck_root_leaves_motion_as_uncertain_as_in_an_unknown_gust(
    tips_mps2: tuple[float, float], root_mps2: float, forgotten: bool
) -> None:
    kalman = _filter()
    q = kalman.layout.symmetric.q
    by_gust = kalman._discrete_model.motion_covariance[q, q]
    assert (_after(kalman, tips_mps2, root_mps2)[q, q] > by_gust) == forgotten


def test_a_blow_makes_the_loads_uncertain_and_not_the_roll() -> None:
    calm, struck = (_after(_filter(), tips_mps2, 0.0) for tips_mps2 in ((0.0, 0.0), (90.0, 90.0)))
    layout = _filter().layout
    load, roll, biases = layout.symmetric.q + 2, slice(layout.roll_rate, layout.roll_accel + 1), layout.bias_states
    assert struck[load, load] > 10.0 * calm[load, load]
    assert np.diag(struck)[roll] == pytest.approx(np.diag(calm)[roll], rel=0.05)
    assert np.all(np.diag(struck)[biases] < 1.05 * np.diag(calm)[biases])


@pytest.mark.parametrize(
    ("explained_by", "sigmas", "teaches"),
    [("left.kp", 0.0, False), ("left.kp", 1.0, False), ("left.kp", 2.0, True), ("root.kp", 2.0, False)],
)
def test_an_innovation_teaches_where_bias_parameters_that_a_flight_tells_explain_it(
    explained_by: str, sigmas: float, teaches: bool
) -> None:
    """Eight sigma of the row lie beyond a gate of five, but not of ``5 sqrt(1 + 2^2)``."""
    kalman = _filter()
    const, model, state, history = _kernel_arguments(kalman)
    epochs, column = _epochs(kalman, 0.0), kalman.layout.bias_parameters.index(explained_by)
    only_roll_rate = np.broadcast_to(np.arange(ROWS) == P_LEFT, (STEPS, ROWS)).copy()
    quiet = {"root_motion_variance": np.zeros((STEPS, 3)), "sensitivity": np.zeros_like(epochs.sensitivity)}
    epochs = epochs._replace(rows=np.zeros((STEPS, ROWS)), present=only_roll_rate, **quiet)
    looking = kalman.fork(kalman.model)
    assert kernel_loops.filter_epochs(*_kernel_arguments(looking)[:2], epochs, *_kernel_arguments(looking)[2:], 0, 1, 0)
    row_sigma = np.sqrt(looking.history.innovation_covariance[0, P_LEFT, P_LEFT])
    epochs.rows[0, P_LEFT] = 8.0 * row_sigma
    epochs.sensitivity[0, P_LEFT, column] = sigmas * row_sigma / kalman.layout.bias_parameter_sigma[column]
    assert kernel_loops.filter_epochs(const, model, epochs, state, history, 0, 1, 0)
    assert (history.gate_excess[0, P_LEFT] == 0.0) == teaches
    assert (state.information[0, 0] > 0.0) == teaches


def test_a_bias_of_the_vertical_force_turns_every_measured_slope() -> None:
    """The lateral axis shows the slope as ``arctan(y / z)``, with the bias in ``z``.

    Its part by the tip's own motion is over the measured ``z`` in the prediction, too: there the bias does nothing.
    """
    kalman = _filter(EXACT_SCALES)
    const, model, _, _ = _kernel_arguments(kalman)
    epochs = _epochs(kalman, 0.0)
    epochs = epochs._replace(rows=np.zeros_like(epochs.rows), sensitivity=np.zeros_like(epochs.sensitivity))
    state = 0.002 * np.random.default_rng(3).standard_normal(kalman.layout.size + 1)
    measured, H = np.zeros((ROWS, 1 + len(kalman.bias_parameters))), np.zeros((ROWS, kalman.layout.size + 1))
    kernel_numpy._linearise(const, model, epochs, 5, state, _believed(kalman), measured, H)
    left, right, root = 0.011, -0.007, 0.004  # biases
    sensors = (EXACT_SCALES.left, EXACT_SCALES.right, EXACT_SCALES.root)
    weight = np.array([sensor.accel_bias_sigma_mps2**-2 for sensor in sensors])
    common = weight @ (left, right, root) / weight.sum()
    for side, bias in enumerate((left, right)):
        tip = kernel_numpy._moving_tip(const, model, epochs, 5, side, state, _believed(kalman))
        slope = float(model.linearisation_rows[side] @ state)
        z = epochs.vertical_mps2[5, side]
        assert abs(slope) > 1e-3
        tilted = np.arctan(z * np.tan(slope) / (z + bias)) - slope
        row = Y_LEFT + side
        result = H[row, const.vertical_bias_state] @ (left - root, right - root)
        result -= measured[row, kalman.layout.column("bz")] * common  # prediction less reading
        relative = np.array([bias, (left, right)[1 - side]]) - root
        result -= tip.by_acceleration @ relative  # by the way inboard, whose acceleration is measured too
        assert result == pytest.approx(tilted, rel=3e-3)


@pytest.mark.parametrize("tips", [2, 1])
def test_the_slope_row_is_linear_in_the_state_as_its_derivative_says(tips: int) -> None:
    """Coriolis' and Euler's force and the way inboard: the prediction's difference quotient by every state.

    The roll acceleration of some epochs before, which the derivative by a lift has, is the present one here.
    """
    kalman = _filter()
    const, model, _, _ = _kernel_arguments(kalman)
    epochs, size = _epochs(kalman, 0.0), kalman.layout.size + 1
    none = np.zeros((STEPS, 2))  # the slope's change with the force inside the epoch is taken as known
    roll_radps, roll_accel = 0.5, 2.0
    earlier = np.full(STEPS, roll_accel)
    epochs = epochs._replace(
        rows=0.1 * epochs.rows, lateral_mps2=none, slope_rate_gain=none, earlier_roll_radps2=earlier
    )
    epochs.present[5, Z_LEFT + tips : M_LEFT] = False
    state = 3e-4 * np.random.default_rng(3).standard_normal(size)
    state[kalman.layout.roll_rate], state[kalman.layout.roll_accel] = roll_radps, roll_accel

    def linearised(at: Floats) -> tuple[Floats, Floats]:
        return _linearised(kalman, epochs, at, Y_LEFT)

    _, H = linearised(state)
    for i in range(size - 1):
        step = np.zeros(size)
        step[i] = 1e-4
        quotient = (linearised(state + step)[0] - linearised(state - step)[0]) / 2e-4
        tilt = np.abs(model.H[Y_LEFT : Y_LEFT + 2, i]).max() + 1.0
        assert -quotient[:tips] == pytest.approx(H[:tips, i], abs=0.02 * tilt), f"state {i}"
        if i == kalman.layout.roll_rate:
            assert -quotient == pytest.approx(H[:, i], rel=0.01)
        if i == kalman.layout.roll_accel:  # H has nothing of the lift rate's share, h p y of a measured tip
            left_out = epochs.lateral_gain[5] * const.step_s * roll_radps * const.lever_m
            left_out = left_out * epochs.present[5, Z_LEFT : Z_LEFT + 2]
            assert -quotient == pytest.approx(H[:, i] + left_out, rel=0.1)


def test_the_vertical_row_is_linear_in_a_state_that_bends_the_wing_far() -> None:
    """A tilted tip shows its lateral force, which the lift makes too: difference quotients by every state.

    At 0.1 m of lift this is as large as what the tilt shows of the vertical force.
    """
    kalman = _filter()
    epochs, layout = _epochs(kalman, 0.0), kalman.layout
    epochs = epochs._replace(rows=0.1 * epochs.rows, earlier_roll_radps2=np.full(STEPS, 2.0))
    state = np.zeros(layout.size + 1)
    state[layout.roll_rate], state[layout.roll_accel] = 0.5, 2.0
    state[layout.symmetric.q], state[layout.antisymmetric.q] = 0.1, -0.04
    state[layout.symmetric.v], state[layout.antisymmetric.v] = 1.5, 2.0

    def linearised(at: Floats) -> tuple[Floats, Floats]:
        return _linearised(kalman, epochs, at, Z_LEFT)

    _, H = linearised(state)
    for i in range(layout.size):
        step = np.zeros(layout.size + 1)
        step[i] = 1e-6
        quotient = (linearised(state + step)[0] - linearised(state - step)[0]) / 2e-6
        assert -quotient == pytest.approx(H[:, i], rel=1e-6, abs=1e-6), f"state {i}"


@pytest.mark.parametrize("lift_m", [0.3, 0.5])
def test_a_state_beyond_all_wings_is_not_driven_on(lift_m: float) -> None:
    """At 0.5 m, a slope of 0.7 rad, a vertical row sees a change of the tilt alone; both loops say so."""
    states = []
    for kernel in (kernel_loops, kernel_numpy):
        kalman = _filter()
        const, model, filter_state, history = _kernel_arguments(kalman)
        filter_state.state_and_sensitivity[kalman.layout.symmetric.q, 0] = lift_m
        state, epochs = filter_state.state_and_sensitivity[:, 0].copy(), _epochs(kalman, 0.0)
        assert kernel.filter_epochs(const, model, epochs, filter_state, history, 0, 1, 0)  # type: ignore[attr-defined]
        states.append(filter_state.state_and_sensitivity)
    np.testing.assert_allclose(*states, rtol=1e-7, atol=1e-7)
    residual, H = np.zeros((ROWS, 1 + len(kalman.bias_parameters))), model.H.copy()
    kernel_numpy._linearise(const, model, epochs, 0, state, _believed(kalman), residual, H)
    change, by_tilt = (H - model.H)[Z_LEFT], model.linearisation_rows[0]
    besides = change - (change @ by_tilt) / (by_tilt @ by_tilt) * by_tilt
    assert (np.abs(besides).max() < 1e-9 * np.abs(change).max()) == (lift_m > 0.4)


def test_each_part_of_the_way_inboard_has_its_own_relative_error() -> None:
    """Difference quotients of both slope rows by K of the lowest modes, and by all of K that further modes have in."""
    kalman = _filter()
    const, model, _, _ = _kernel_arguments(kalman)
    epochs, parameters = _epochs(kalman, 0.0), kalman.layout.bias_parameters
    epochs = epochs._replace(rows=0.1 * epochs.rows, sensitivity=np.zeros_like(epochs.sensitivity))
    state = 3e-3 * np.random.default_rng(3).standard_normal(kalman.layout.size + 1)
    state[kalman.layout.symmetric.q] = 0.015
    epochs = epochs._replace(earlier_roll_radps2=np.full(STEPS, state[kalman.layout.roll_accel]))
    assert {"shortening", "further_shortening"} < set(parameters)

    def innovation(foreshortening_pm: Floats) -> Floats:
        """Slope rows (2, 1 + c) less their prediction, and the derivatives of that by the bias parameters."""
        residual, H = np.zeros((ROWS, 1 + len(parameters))), model.H.copy()
        residual[:, 0] = epochs.rows[5]
        varied = const._replace(foreshortening_pm=foreshortening_pm)
        kernel_numpy._linearise(varied, model, epochs, 5, state, _believed(kalman), residual, H)
        residual[:, 0] -= H @ state
        return residual[Y_LEFT : Y_LEFT + 2]

    K, small = const.foreshortening_pm, 1e-3
    lowest = K * np.pad([[1.0]], (0, len(K[0]) - 1))
    for name, varied_pm in (("shortening", lowest), ("further_shortening", K - lowest)):
        quotient = (innovation(K + small * varied_pm) - innovation(K - small * varied_pm))[:, 0] / (2.0 * small)
        by_parameter = innovation(K)[:, 1 + parameters.index(name)]
        assert np.abs(quotient).max() > 1e-4, name
        assert quotient == pytest.approx(by_parameter, rel=0.05, abs=1e-5), name


def test_an_estimated_height_is_in_the_prediction_with_the_roll_of_the_state() -> None:
    """Less its part in the sensitivity, which has the roll acceleration of some epochs before."""
    kalman = _filter()
    const, model, _, _ = _kernel_arguments(kalman)
    epochs = _epochs(kalman, 0.0)
    epochs = epochs._replace(rows=0.01 * epochs.rows, sensitivity=np.zeros_like(epochs.sensitivity))
    state = np.zeros(kalman.layout.size + 1)
    roll_accel_radps2 = state[kalman.layout.roll_accel] = 2.0
    gain, height_m = epochs.lateral_gain[5], 0.01

    def innovations(height_m: float, roll_before_radps2: float) -> Floats:
        """Innovations of both slope rows with all heights zero, by a filter that takes them for ``height_m``."""
        believed = _believed(kalman)
        believed[const.height_column] = height_m
        for side in (0, 1):
            sensitivity = gain[side] * roll_before_radps2
            epochs.sensitivity[5, Y_LEFT + side, const.height_column[side] - 1] = sensitivity
        residual, H = np.zeros((ROWS, 1 + len(kalman.bias_parameters))), model.H.copy()
        residual[:, 0] = epochs.rows[5]
        kernel_numpy._linearise(const, model, epochs, 5, state, believed, residual, H)
        return (residual[:, 0] - H @ state)[Y_LEFT : Y_LEFT + 2]

    turning = -epochs.body_rate_radps[5, 1] * epochs.body_rate_radps[5, 2]
    without = innovations(0.0, roll_accel_radps2)
    at_once = innovations(height_m, roll_accel_radps2 + turning)
    late = innovations(height_m, turning)
    assert at_once == pytest.approx(without, abs=1e-5)
    assert without - late == pytest.approx(gain * roll_accel_radps2 * height_m, rel=0.02)


def test_rows_are_linear_about_the_estimated_way_inboard() -> None:
    """With an estimated error of it a filter has the state and covariance of one whose file has no such error.

    Linear about the file's way inboard, states differ by 0.6 of their sigmas, and sigmas by a quarter. The innovation
    of the vertical force, which is taken out of every sensitivity, leaves a thousandth.
    """
    estimated, filed = _filter(), _filter()
    const, model, state, history = _kernel_arguments(estimated)
    epochs = _epochs(estimated, 0.0)
    epochs = epochs._replace(rows=0.1 * epochs.rows, sensitivity=np.zeros_like(epochs.sensitivity))
    factors = np.full(const.foreshortening_pm.shape[1:], 0.8)
    factors[0, 0] = 1.2
    state.one_and_bias[[const.foreshortening_column, const.further_foreshortening_column]] = 0.2, -0.2
    assert kernel_loops.filter_epochs(const, model, epochs, state, history, 0, STEPS, 0)
    const, model, state_of_filed, history_of_filed = _kernel_arguments(filed)
    const = const._replace(foreshortening_pm=const.foreshortening_pm * factors)
    assert kernel_loops.filter_epochs(const, model, epochs, state_of_filed, history_of_filed, 0, STEPS, 0)
    sigma = np.sqrt(np.diag(filed.covariance))
    assert np.abs((estimated.state - filed.state) / sigma).max() < 0.01
    assert np.sqrt(np.diag(estimated.covariance)) == pytest.approx(sigma, rel=1e-3)


@pytest.mark.parametrize(("scale", "row"), [("ky", Y_LEFT), ("kz", Z_LEFT)])
def test_a_scale_s_sensitivity_has_no_error_that_the_innovation_has_too(scale: str, row: int) -> None:
    """Their product has a mean: a level wing without errors of scale learned 3 % of slope factor, 9 sigma.

    The error is that of the roll acceleration in slope rows, and that of the load factor in vertical ones.
    """

    def first_step(roll_accel_radps2: float, load_g: float) -> Floats:
        """Innovation and sensitivities of the first step, (9, 1 + c), with these for what is zero."""
        kalman = _filter()
        const, model, state, history = _kernel_arguments(kalman)
        state.state_and_sensitivity[kalman.layout.roll_accel, 0] = roll_accel_radps2
        epochs = _epochs(kalman, 0.0)
        zeros = np.zeros(STEPS)
        epochs = epochs._replace(
            earlier_roll_radps2=zeros, load_g=np.full(STEPS, load_g), earlier_load_g=zeros, rows=0.01 * epochs.rows
        )
        kernel_loops.filter_epochs(const, model, epochs, state, history, 0, 1, 0)
        S = np.tril(history.innovation_covariance[0])
        used = np.flatnonzero(np.diag(S))
        lower = np.linalg.cholesky((S + np.tril(S, -1).T)[np.ix_(used, used)])
        rows = np.zeros((ROWS, history.whitened_innovation.shape[2]))
        rows[used] = lower @ history.whitened_innovation[0, : len(used)]
        return rows

    shifted = first_step(0.3, 0.0) if row == Y_LEFT else first_step(0.0, 0.01)
    change = shifted - first_step(0.0, 0.0)
    for side, place in enumerate(("left", "right")):
        assert abs(change[row + side, 0]) > (1e-4 if row == Y_LEFT else 0.05), "the innovation has it"
        by_scale = change[row + side, _filter().layout.column(f"{place}.{scale}")]
        assert abs(by_scale) < 0.05 * abs(change[row + side, 0]), place


def test_innovations_are_as_uncertain_as_considered_parameters_make_them() -> None:
    """Against difference quotients by each.

    What stamp offsets add to a second mode of 29 Hz passed for vibration of a tip, and its scales were not estimated.
    """
    steps = 1  # later ones regress on the innovations themselves

    def filtered(column: int = 0, shift: float = 0.0) -> SeparatedBiasFilter:
        kalman = _filter()
        kalman._one_and_bias[column] += shift
        kalman.run(_epochs(kalman, 0.0).span(0, steps))
        return kalman

    kalman, shift = filtered(), 1e-5
    (innovation, of_taught), (_, of_all) = kalman.innovations(steps), kalman.innovations(steps, of_all=True)
    considered = np.setdiff1d(np.arange(len(kalman.bias_parameters)), kalman._teachable)
    assert len(considered) > 5
    D = np.array([(filtered(1 + at, shift).innovations(steps)[0] - innovation) / shift for at in considered])
    sigma = kalman.layout.bias_parameter_sigma[considered]
    added = np.einsum("ckr,cks,c->krs", D, D, sigma**2)
    np.testing.assert_allclose(of_all - of_taught, np.tril(added), rtol=1e-4, atol=1e-9 * added.max())


LATERAL_MPS2, GRAVITY_MPS2, FINE = 0.5, 9.80665, 64


def _swinging(kalman: SeparatedBiasFilter, state: Floats, side: int, scale: float) -> Epochs:
    """Epoch of exact sensors at tips that swing freely; the vertical axis of one reads too much by a scale."""
    const, layout = kalman._constants, kalman.layout
    fine, _ = propagation(layout, kalman.noise, kalman.model.parameters, STEP_S / FINE)
    path = [state[:-1]]
    for _ in range(FINE):
        path.append(fine @ path[-1])
    w, rate = np.array(path)[:, [layout.symmetric.q, layout.symmetric.q + 1]].T
    slope = kalman.model.slope[side, layout.symmetric.q] * 0.5 * (w[1:] + w[:-1])
    K, sign, step_s = const.foreshortening_pm[side, 0, 0], 1.0 - 2.0 * side, STEP_S / FINE
    across = LATERAL_MPS2 - K * np.diff(w * rate) / step_s
    up = -GRAVITY_MPS2 - np.diff(rate) / step_s
    y = across * np.cos(slope) + sign * up * np.sin(slope)
    z = (1.0 + scale) * (up * np.cos(slope) - sign * across * np.sin(slope))
    moment = ((np.arange(FINE) + 0.5) / FINE - 0.5) @ z / FINE
    gain, lateral = sign / z.mean(), y.mean() - LATERAL_MPS2
    epochs = _epochs(kalman, 0.0)
    empty = {
        name: np.zeros_like(getattr(epochs, name))
        for name in ("rows", "vertical_mps2", "lateral_mps2", "slope_rate_gain", "lateral_gain", "sensitivity")
    }
    epochs = epochs._replace(**empty)
    epochs.rows[0, [Z_LEFT, Z_LEFT + 1]], epochs.rows[0, [M_LEFT, M_LEFT + 1]] = z.mean() + GRAVITY_MPS2, moment
    epochs.rows[0, Y_LEFT + side] = np.arctan(lateral * gain)
    epochs.vertical_mps2[0], epochs.lateral_mps2[0] = z.mean(), (LATERAL_MPS2, -LATERAL_MPS2)
    epochs.lateral_gain[0, side] = gain
    epochs.slope_rate_gain[0, side] = moment * STEP_S * abs(gain)
    column = kalman.layout.bias_parameters.index(f"{('left', 'right')[side]}.kz")
    epochs.sensitivity[0, [Z_LEFT + side, Y_LEFT + side], column] = z.mean(), -lateral * gain
    return epochs


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize(("lift_m", "rate_mps"), [(0.03, 0.0), (0.03, 0.3), (-0.03, 0.2), (0.0, 0.9)])
def test_a_wing_that_swings_far_shows_the_slope_row_what_it_expects(lift_m: float, rate_mps: float, side: int) -> None:
    """Beside 1 m/s^2 by the way inboard 3e-4 is left at most; a wrong vertical scale does what its derivative says."""
    kalman = _filter()
    layout, (const, model, _, _) = kalman.layout, _kernel_arguments(kalman)
    column = 1 + layout.bias_parameters.index(f"{('left', 'right')[side]}.kz")
    state, row, scale = np.zeros(layout.size + 1), Y_LEFT + side, 0.002
    state[[layout.symmetric.q, layout.symmetric.q + 1]] = lift_m, rate_mps

    def innovation(scale: float) -> tuple[float, float]:
        """Lateral force that the row shows beyond its prediction, and its derivative by the scale."""
        epochs = _swinging(kalman, state, side, scale)
        residual, H = np.zeros((ROWS, 1 + len(kalman.bias_parameters))), model.H.copy()
        residual[:, 0], residual[:, 1:] = epochs.rows[0], -epochs.sensitivity[0]
        kernel_numpy._linearise(const, model, epochs, 0, state, _believed(kalman), residual, H)
        force_mps2 = abs(float(epochs.vertical_mps2[0, side]))
        return float(residual[row, 0] - H[row] @ state) * force_mps2, float(residual[row, column]) * force_mps2

    exact, by_scale = innovation(0.0)
    assert abs(exact) < 3e-4
    assert (innovation(scale)[0] - exact) / scale == pytest.approx(-by_scale, abs=0.08)


def test_what_a_shaken_tip_cannot_tell_is_estimated_again_when_it_is_still() -> None:
    kalman = _filter()
    names, size = np.array(kalman.layout.bias_parameters), kalman.layout.size
    kalman.run(_epochs(kalman, 0.0))
    estimated, wandering = kalman._estimated, kalman._wandering
    still, shaken = RowNoise(kalman.noise), RowNoise(kalman.noise)
    shaken.vibrating = shaken.strongly_vibrating = (True, False)
    kalman.take_noise(shaken)
    left_out = set(names[estimated]) - set(names[kalman._estimated])
    of_the_tip = {f"left.{error}" for error in ("kz", "ky", "kp", "mx", "my", "mz")}
    assert of_the_tip | {"trim", "shortening", "slope.symmetric"} <= left_out
    assert not any(name.startswith("right") for name in left_out)
    assert np.all(kalman.bias_parameters[np.isin(names, list(left_out))] == 0.0)
    kalman.take_noise(still)
    np.testing.assert_array_equal(kalman._estimated, estimated)
    np.testing.assert_array_equal(kalman._wandering, wandering)
    at_prior = np.sqrt(np.diag(kalman.bias_parameter_covariance)) / kalman.layout.bias_parameter_sigma
    assert at_prior[estimated] == pytest.approx(1.0), "what was learned beside vibration is forgotten"
    np.testing.assert_array_equal(kalman.state_and_sensitivity[:size, 1 + estimated], 0.0)


@given(arrays(np.float64, (3, 3), elements=st.floats(-3.0, 3.0)))
def test_terms_given_their_sum_are_a_regression_on_it(root: Floats) -> None:
    """The remainder of each term is uncorrelated with the sum, and all remainders add up to nothing."""
    covariance = root @ root.T + 0.1 * np.eye(3)
    fraction, left_open = given_sum(covariance)
    assert fraction.sum() == pytest.approx(1.0)
    assert covariance.sum(axis=1) - fraction * covariance.sum() == pytest.approx(0.0, abs=1e-9)
    assert left_open.sum(axis=1) == pytest.approx(0.0, abs=1e-9)
    without_sum = np.eye(3) - np.outer(fraction, np.ones(3))
    assert left_open == pytest.approx(without_sum @ covariance @ without_sum.T, abs=1e-9)


def test_terms_without_variance_leave_the_first_to_the_sum() -> None:
    fraction, left_open = given_sum(np.zeros((2, 2)))
    np.testing.assert_array_equal(fraction, (1.0, 0.0))
    np.testing.assert_array_equal(left_open, 0.0)


def test_a_scale_as_uncertain_as_the_bias_says_the_same() -> None:
    assert _filter().layout.column("bz") is None


def _faster(parameters: ModeParameters, ratio: float) -> ModeParameters:
    first = replace(parameters.modes[0], frequency_hz=ratio * parameters.frequency_hz)
    return replace(parameters, modes=(first, *parameters.modes[1:]))


@pytest.mark.parametrize("kernel", [kernel_loops, kernel_numpy])
def test_the_history_knows_the_motion_of_every_step_however_often_it_changes(kernel: object) -> None:
    kalman = _filter()
    epochs = _epochs(kalman, 0.0)
    layout, noise, believed = kalman.layout, kalman.noise, kalman.model.parameters
    motions = []
    for model in range(STEPS):
        faster = [_faster(p, 1.0 + 0.01 * model) for p in believed]
        kalman.switch_model(build_model(layout, noise, (faster[0], faster[1]), (-0.99, 0.99), STEP_S))
        const, taken, filter_state, history = _kernel_arguments(kalman)
        assert kernel.filter_epochs(const, taken, epochs, filter_state, history, model, model + 1, model)  # type: ignore[attr-defined]
        motions.append(kalman.model.transition[:, : layout.size])
    history = kalman.history
    for model, transition in enumerate(motions):
        np.testing.assert_array_equal(history.transition[history.transition_index[model]], transition)


@pytest.mark.parametrize("kernel", [kernel_loops, kernel_numpy])
def test_numbers_that_have_run_away_stop_the_filter(kernel: object) -> None:
    kalman = _filter()
    epochs = _epochs(kalman, 0.0)
    kalman.covariance[0, 0] = np.inf
    const, model, filter_state, history = _kernel_arguments(kalman)
    assert not kernel.filter_epochs(const, model, epochs, filter_state, history, 0, STEPS, 0)  # type: ignore[attr-defined]


@pytest.mark.filterwarnings("error")
def test_a_filter_whose_numbers_run_away_says_so_and_stops() -> None:
    kalman = _filter()
    epochs = _epochs(kalman, 0.0)
    kalman.run(epochs)
    kalman.covariance[0, 0] = kalman._filter_state.information[1, 1] = np.inf
    kalman.run(epochs)
    assert not kalman.finite
    assert kalman.steps == STEPS


TIPS_UP = slice(Z_LEFT, Z_LEFT + 2)


def _taught_by_gust(kernel: object, gust_mps2: float) -> tuple[Floats, Floats]:
    """Innovations (2,) of the vertical rows of one step, and what it teaches the trim and both roll misalignments.

    The tips' trim bend shows them gravity and the gust, nothing else is there.
    """
    kalman = _filter()
    epochs, parameters = _epochs(kalman, 0.0), kalman.layout.bias_parameters
    present, rows = np.zeros_like(epochs.present), np.zeros_like(epochs.rows)
    present[:, TIPS_UP], rows[:, TIPS_UP] = True, gust_mps2
    nothing = {
        name: np.zeros_like(getattr(epochs, name))
        for name in ("lateral_mps2", "load_g", "sensitivity", "aliasing_noise", "root_motion_variance")
    }
    vertical = np.full_like(epochs.vertical_mps2, -9.80665 + gust_mps2)
    gusty = epochs._replace(rows=rows, present=present, vertical_mps2=vertical, **nothing)
    const, model, filter_state, history = _kernel_arguments(kalman)
    assert kernel.filter_epochs(const, model, gusty, filter_state, history, 0, 1, 0)  # type: ignore[attr-defined]
    columns = [1 + parameters.index(name) for name in ("trim", "left.mx", "right.mx")]
    return history.innovation[0, TIPS_UP], filter_state.information[0, columns]


@pytest.mark.parametrize("kernel", [kernel_loops, kernel_numpy])
def test_a_gust_teaches_nothing_of_the_tilt_by_which_its_own_force_is_seen(kernel: object) -> None:
    """Innovations as large upwards as downwards: their products with the force that holds them would add up."""
    calm, _ = _taught_by_gust(kernel, 0.0)
    assert 1e-4 < abs(calm[0]) < 0.01, "gravity along the bent tip"
    (up, taught_up), (down, taught_down) = (_taught_by_gust(kernel, gust) for gust in (0.05 - calm[0], -0.05 - calm[0]))
    np.testing.assert_allclose(up, -down, rtol=2e-3)
    assert np.all(np.abs(taught_up) > 0.0)
    np.testing.assert_allclose(taught_up, -taught_down, rtol=4e-3)
