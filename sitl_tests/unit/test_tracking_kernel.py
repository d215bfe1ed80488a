"""The filter's inner loop: the compiled one and numpy's say the same, whatever rows are missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.core.kernels import filter_loops as kernel_loops
from companion.core.kernels import filter_numpy as kernel_numpy
from companion.core.kernels.arrays import Data, Fixed, History, Memory, Step
from companion.core.tracking.filter import Kalman
from companion.core.tracking.model import build_model
from companion.core.tracking.parameters import prior_parameters
from companion.core.tracking.states import ROWS, Y_LEFT, make_layout, make_noise
from companion.params.airframe import Airframe
from companion.params.files import load_airframe

AIRFRAME = load_airframe("nadir-2m")
EXACT_SCALES = replace(
    AIRFRAME, left=replace(AIRFRAME.left, accel_scale_sigma=0.0), right=replace(AIRFRAME.right, accel_scale_sigma=0.0)
)
STEP_S = 0.004
STEPS = 60


def _filter(airframe: Airframe = AIRFRAME) -> Kalman:
    layout, wing = make_layout(airframe), airframe.wing
    noise = make_noise(airframe, layout, STEP_S)
    parameters = (prior_parameters(layout.symmetric, wing.gust), prior_parameters(layout.antisymmetric, wing.gust))
    model = build_model(layout, noise, parameters, (-0.99, 0.99), STEP_S)
    return Kalman(layout, noise, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, STEPS)


def _cells(constants: int, missing: float) -> Data:
    """Rows as of a calm wing, a tenth of them far beyond the gate, a share missing, at every step others."""
    rng = np.random.default_rng(7)
    size = np.array([0.1, 0.1, 0.01, 0.01, 0.001, 0.001, 0.003, 0.003, 0.003])
    size = size * np.where(rng.random((STEPS, ROWS)) < 0.1, 6.0, 1.0)
    present = rng.random((STEPS, ROWS)) >= missing
    return Data(
        rows=np.where(present, size * rng.standard_normal((STEPS, ROWS)), 0.0),
        present=present,
        vertical=-9.8 + rng.standard_normal((STEPS, 2)),
        lateral=0.3 * rng.standard_normal((STEPS, 2)),
        tilted=1e-3 * rng.standard_normal((STEPS, 2)),
        lateral_gain=np.array([-0.1, 0.1]) * (1.0 + 0.1 * rng.standard_normal((STEPS, 2))),
        load=0.2 * rng.standard_normal(STEPS),
        sensitivity=present[:, :, None] * rng.standard_normal((STEPS, ROWS, constants)),
        cut=rng.random((STEPS, 2)),
        shaken=np.where(rng.random((STEPS, 1)) < 0.2, np.array([1.0, 0.1, 0.01]), 0.0),
    )


def _parts(kalman: Kalman) -> tuple[Fixed, Step, Memory, History]:
    return kalman._fixed, kalman._step, kalman._memory, kalman.history


@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("airframe", [AIRFRAME, EXACT_SCALES], ids=["uncertain scales", "exact scales"])
def test_compiled_loops_and_numpy_agree(airframe: Airframe, missing: float, rough: bool) -> None:
    one, other = _filter(airframe), _filter(airframe)
    data = _cells(len(one.constants), missing)
    for kalman, kernel in ((one, kernel_loops), (other, kernel_numpy)):
        fixed, step, memory, history = _parts(kalman)
        assert kernel.run_cells(fixed, step._replace(rough=rough), data, memory, history, 0, STEPS, 0)
    for name in Memory._fields:
        found, wanted = getattr(one._memory, name), getattr(other._memory, name)
        np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-10 * np.abs(wanted).max(), err_msg=name)
    np.testing.assert_array_equal(one.history.used, other.history.used)
    for at, used in enumerate(one.history.used):
        for name in ("seen", "innovation", "drawn"):
            found, wanted = getattr(one.history, name)[at, :used], getattr(other.history, name)[at, :used]
            np.testing.assert_allclose(found, wanted, atol=1e-9 * max(np.abs(wanted).max(initial=0.0), 1e-6))


def test_a_bias_of_the_vertical_force_turns_every_slope_that_is_seen() -> None:
    """The lateral axis shows the slope as ``arctan(y / z)``, with the bias in ``z``."""
    kalman = _filter(EXACT_SCALES)
    fixed, step, _, _ = _parts(kalman)
    data = _cells(len(kalman.constants), 0.0)
    state = 0.01 * np.random.default_rng(3).standard_normal(kalman.layout.size + 1)
    measured, sense = np.zeros((ROWS, 1 + len(kalman.constants))), np.zeros((ROWS, kalman.layout.size + 1))
    kernel_numpy._turn(fixed, step, data, 5, state, measured, sense)
    left, right, root = 0.011, -0.007, 0.004  # biases
    sensors = (EXACT_SCALES.left, EXACT_SCALES.right, EXACT_SCALES.root)
    weight = np.array([sensor.accel_bias_sigma_mps2**-2 for sensor in sensors])
    common = weight @ (left, right, root) / weight.sum()
    for side, own in enumerate((left, right)):
        slope, z = (step.watch @ state)[side], data.vertical[5, side]
        assert abs(slope) > 1e-3
        turned = np.arctan(z * np.tan(slope) / (z + own)) - slope
        row = Y_LEFT + side
        found = sense[row, fixed.vertical_bias] @ (left - root, right - root)
        found -= measured[row, kalman.layout.column("bz")] * common  # prediction less reading
        assert found == pytest.approx(turned, rel=3e-3)


def test_a_scale_as_uncertain_as_the_bias_says_the_same() -> None:
    assert _filter().layout.column("bz") is None


@pytest.mark.parametrize("kernel", [kernel_loops, kernel_numpy])
def test_the_history_knows_the_motion_of_every_step_however_often_it_changes(kernel: object) -> None:
    kalman = _filter()
    data = _cells(len(kalman.constants), 0.0)
    layout, noise, believed = kalman.layout, kalman.noise, kalman.model.parameters
    motions = []
    for step in range(STEPS):
        faster = tuple(replace(p, frequency_hz=p.frequency_hz * (1.0 + 0.01 * step)) for p in believed)
        kalman.use(build_model(layout, noise, (faster[0], faster[1]), (-0.99, 0.99), STEP_S))
        fixed, taken, memory, history = _parts(kalman)
        assert kernel.run_cells(fixed, taken, data, memory, history, step, step + 1, step)  # type: ignore[attr-defined]
        motions.append(kalman.model.transition[:, : layout.size])
    history = kalman.history
    for step, motion in enumerate(motions):
        np.testing.assert_array_equal(history.transition[history.by[step]], motion)


@pytest.mark.parametrize("kernel", [kernel_loops, kernel_numpy])
def test_numbers_that_have_run_away_stop_the_filter(kernel: object) -> None:
    kalman = _filter()
    data = _cells(len(kalman.constants), 0.0)
    kalman.covariance[0, 0] = np.inf
    fixed, step, memory, history = _parts(kalman)
    assert not kernel.run_cells(fixed, step, data, memory, history, 0, STEPS, 0)  # type: ignore[attr-defined]
