"""The oracle's truth and its reference filter held against closed forms and against each other."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from companion.records import Axis, Station
from tools.reference.imu import EPOCH_HOST_NS, chunks, samples
from tools.reference.oracle import Oracle
from tools.reference.rigid import LEVEL, RigidMotion, flight
from tools.reference.spec import (
    DRYDEN,
    FIVE_TWENTY,
    GRAVITY_MPS2,
    GUSTS,
    TWO_EIGHT,
    WHITE,
    ModeSpec,
    SensorSpec,
    TruthSpec,
)
from tools.reference.truth import STEP_S, simulate

MODE = ModeSpec(5.0, 0.05, 0.005)
QUIET = {
    "accel_noise_mps2_rthz": 0.0,
    "gyro_noise_radps_rthz": 0.0,
    "accel_bias_sigma_mps2": 0.0,
    "gyro_bias_sigma_radps": 0.0,
}


def spec(**changes) -> TruthSpec:
    base = TruthSpec(MODE, replace(MODE, frequency_hz=6.4), FIVE_TWENTY, 0.0149, 0.0149, LEVEL, duration_s=20.0)
    return replace(base, **changes)


def quiet(truth: TruthSpec) -> TruthSpec:
    sensors = {name: replace(getattr(truth, name), **QUIET) for name in ("root", "left", "right")}
    return replace(truth, **sensors)


def still(truth: TruthSpec) -> TruthSpec:
    modes = {name: replace(getattr(truth, name), rms_m=1e-12) for name in ("symmetric", "antisymmetric")}
    return replace(truth, **modes)


@pytest.mark.parametrize("gust", GUSTS.values(), ids=GUSTS)
def test_every_gust_gives_the_wanted_rms_from_the_first_instant(gust) -> None:
    run = simulate(spec(gust=gust, duration_s=4.0), tuple(range(60)))
    for mode in (0, 1):
        for k in (0, run.steps // 2, run.steps):
            # 60 independent values: the standard error of an rms is 9 %, so 4 of them
            assert run.q_m[:, mode, k].std() == pytest.approx(0.005, rel=0.37)
    rms_m = np.sqrt((run.q_m**2).mean(axis=(0, 2)))
    assert rms_m == pytest.approx([0.005, 0.005], rel=0.15)


@pytest.mark.parametrize(("gust", "slope"), [(WHITE, 0.0), (TWO_EIGHT, -4.0), (DRYDEN, -2.0)])
def test_the_load_has_the_spectrum_of_its_name(gust, slope) -> None:
    """Far above its corners a gust falls with 20 dB per decade for every pole more than zeros."""
    run = simulate(spec(gust=gust), tuple(range(8)))
    mode = run.spec.symmetric
    omega = 2 * np.pi * mode.frequency_hz
    v = run.v_mps[:, 0]
    middle = slice(1, None)
    load = np.diff(v, axis=1) / STEP_S + 2 * mode.damping * omega * v[:, middle] + omega**2 * run.q_m[:, 0, middle]
    power = (np.abs(np.fft.rfft(load * np.hanning(load.shape[1]), axis=1)) ** 2).mean(axis=0)
    f = np.fft.rfftfreq(load.shape[1], STEP_S)
    low, high = (power[(f > a) & (f < 1.3 * a)].mean() for a in (30.0, 120.0))
    assert np.log(high / low) / np.log(4.0) == pytest.approx(slope, abs=0.3)


def test_seeds_do_not_depend_on_their_company() -> None:
    together, alone = simulate(spec(duration_s=2.0), (3, 4)), simulate(spec(duration_s=2.0), (4,))
    assert together.q_m[1] == pytest.approx(alone.q_m[0], abs=1e-12)  # but for the order of sums
    assert samples(together)[1][1] == pytest.approx(samples(alone)[1][0], abs=1e-8)


def test_a_still_wing_reads_gravity_turned_by_its_trim() -> None:
    """Up-bend turns the left tip about +x: its y axis, dipped, then sees gravity along +y of the turned frame."""
    truth = quiet(still(spec(duration_s=0.5)))
    root, left, right = samples(simulate(truth, (1,)))
    psi = 0.0149 * 1.39
    assert root[0, 100] == pytest.approx([0, 0, -GRAVITY_MPS2, 0, 0, 0], abs=1e-9)
    assert left[0, 100] == pytest.approx(
        [0, -GRAVITY_MPS2 * np.sin(psi), -GRAVITY_MPS2 * np.cos(psi), 0, 0, 0], abs=1e-6
    )
    assert right[0, 100] == pytest.approx(
        [0, GRAVITY_MPS2 * np.sin(psi), -GRAVITY_MPS2 * np.cos(psi), 0, 0, 0], abs=1e-6
    )


def test_a_rolling_rigid_wing_feels_its_levers() -> None:
    """f = f_root + p' y in z, -(p^2 + r^2) y in y, for a tip at y."""
    motion = RigidMotion("roll", ((0, 0.5, 0.4, 0.3), (2, 0.2, 0.3, 1.0)))
    truth = quiet(still(spec(duration_s=2.0, motion=motion, trim_bend_m=0.0, bend_per_g_m=0.0)))
    _, left, right = samples(simulate(truth, (1,)))
    t = (np.arange(2000) + 0.5) * 0.001
    p, r = 0.5 * np.sin(2 * np.pi * 0.4 * t + 0.3), 0.2 * np.sin(2 * np.pi * 0.3 * t + 1.0)
    p_dot = 0.5 * 2 * np.pi * 0.4 * np.cos(2 * np.pi * 0.4 * t + 0.3)
    for tip, y in ((left, -1.0), (right, 1.0)):
        assert tip[0, :, 2] == pytest.approx(-GRAVITY_MPS2 + p_dot * y, abs=1e-4)
        assert tip[0, :, 1] == pytest.approx(-(p**2 + r**2) * y, abs=1e-4)
        assert tip[0, :, 3] == pytest.approx(p, abs=1e-4)


def test_the_bend_follows_a_slow_pull_up() -> None:
    """0.3 g more at 0.1 Hz bends a 5 Hz wing by 0.3 of its bend per g, and a tip accelerometer reads the root's."""
    motion = RigidMotion("pull", ((5, -0.3 * GRAVITY_MPS2, 0.1, 0.0),))
    run = simulate(quiet(still(spec(motion=motion))), (1,))
    t = np.arange(run.steps + 1) * STEP_S
    late = t > 8.0  # the start, at rest, has died away
    assert run.q_m[0, 0, late] == pytest.approx(0.3 * 0.0149 * np.sin(2 * np.pi * 0.1 * t[late]), abs=2e-5)


def test_a_rising_tip_unloads_its_accelerometer_and_turns_its_gyro() -> None:
    """z less by w'', p of the left tip plus the slope rate, of the right minus, in rising together."""
    run = simulate(quiet(spec(duration_s=4.0, trim_bend_m=0.0)), (5,))
    root, left, right = samples(run)
    v, q = run.v_mps[0], run.q_m[0]
    rise = np.stack([v[0] - v[1], v[0] + v[1]])[:, ::2]
    bend = 1.39 * np.stack([q[0] - q[1], q[0] + q[1]])[:, ::2]
    for tip, side, sign in ((left, 0, 1.0), (right, 1, -1.0)):
        acceleration = np.diff(rise[side]) / 0.001
        # turned by at most 25 mrad: cos is within 3e-4 of 1
        assert tip[0, :, 2] - root[0, :, 2] == pytest.approx(
            -acceleration, abs=4e-4 * np.abs(acceleration).max() + 5e-3
        )
        assert tip[0, :, 3] == pytest.approx(sign * np.diff(bend[side]) / 0.001, abs=1e-9)


def test_a_late_stamp_shows_the_past() -> None:
    truth = quiet(spec(duration_s=3.0))
    run = simulate(truth, (2,))
    run.errors.time_offset_s[:, 1] = -0.0005
    late = samples(run)[1][0, :, 3]
    run.errors.time_offset_s[:, 1] = 0.0
    sharp = samples(run)[1][0, :, 3]
    between = (sharp[:-1] + sharp[1:]) / 2  # a sample 0.5 ms earlier averages two halves
    assert late[1:] == pytest.approx(between, abs=0.02 * np.abs(sharp).max())


@pytest.mark.slow
def test_noise_has_its_density_and_its_bias_its_prior() -> None:
    truth = still(spec(duration_s=2.0))  # the bias takes 1000 s to move, and 80,000 samples tell white noise to 0.3 %
    values = np.concatenate([samples(simulate(truth, (seed,)))[2] for seed in range(40)])
    white = np.diff(values[..., 2], axis=1).std() / np.sqrt(2)
    assert white == pytest.approx(0.0007 * np.sqrt(500), rel=0.01)
    means = values[..., 3].mean(axis=1)
    assert means.std() == pytest.approx(0.0009, rel=0.45)  # 40 values: 4 standard errors
    assert np.abs(means).max() < 0.0009 * 4


def test_chunks_hold_every_sample_once_on_the_host_clock() -> None:
    truth = spec(duration_s=2.0, left=SensorSpec(-1.0, "z"), right=SensorSpec(1.0, "z"))
    run = simulate(truth, (1,))
    values = samples(run)
    ends = [round(0.01 * k, 3) for k in range(1, 201)]
    batches = [batch for _, some in chunks(run, values, 0, ends) for batch in some]
    for station in Station:
        station_batches = [batch for batch in batches if batch.station is station]
        t = np.sort(np.concatenate([batch.t_ns for batch in station_batches]))
        assert np.array_equal(t, EPOCH_HOST_NS + 500_000 + 1_000_000 * np.arange(2000))
    assert all(batch.axes == Axis.Z for batch in batches if batch.station is not Station.ROOT)
    assert any(a.t_ns[0] > b.t_ns[0] for a, b in pairwise(batches))  # arrival is not in order


def silent(y_m: float) -> SensorSpec:
    """Sensor so quiet that its biases limit what it tells."""
    return SensorSpec(y_m, accel_noise_mps2_rthz=2e-5)


CASES = {
    "6-axis, white": spec(gust=WHITE),
    "6-axis, Dryden": spec(gust=DRYDEN),
    "vertical, 5+20": spec(left=SensorSpec(-1.0, "z"), right=SensorSpec(1.0, "z")),
    "vertical, white": spec(gust=WHITE, left=SensorSpec(-1.0, "z"), right=SensorSpec(1.0, "z")),
    "second mode": spec(second_symmetric=ModeSpec(27.0, 0.02, 5e-5, 4.78)),
    "flight": spec(motion=flight(1)),
    "drift": spec(drift_per_s=0.01),
    "biases alone": spec(
        symmetric=replace(MODE, rms_m=3.0 * MODE.rms_m),
        antisymmetric=replace(MODE, frequency_hz=6.4, rms_m=3.0 * MODE.rms_m),
        root=silent(0.0),
        left=silent(-1.0),
        right=silent(1.0),
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("truth", CASES.values(), ids=CASES)
def test_the_reference_is_as_good_as_it_says(truth) -> None:
    """Truth and reference were written from different equations; only if both are right is the error its sigma."""
    run = simulate(truth, tuple(range(12)))
    oracle = Oracle(truth, samples(run, moving=False))
    t = np.arange(2.0, 19.0, 0.5)
    q = run.total_at(t)[:, :2].swapaxes(1, 2)
    for estimate in (oracle.causal(t), oracle.smoothed(t, 0.5)):
        nees = (((estimate.q_m - q) / estimate.q_sigma_m) ** 2).mean(axis=(0, 1))
        # slow errors leave about 40 independent values in 12 runs: standard error 0.22; three of them
        assert nees == pytest.approx([1.0, 1.0], abs=0.66)


@pytest.mark.long
@pytest.mark.parametrize("motion", [LEVEL, flight(2)], ids=["level", "flight"])
def test_the_reference_that_knows_the_priors_is_as_good_as_it_says(motion) -> None:
    tip = {"accel_scale_sigma": 0.005, "gyro_scale_sigma": 0.005, "misalignment_sigma_rad": 0.005}
    tip["time_offset_sigma_s"] = 0.0002
    truth = spec(
        motion=motion,
        duration_s=14.0,
        root=SensorSpec(0.0, accel_scale_sigma=0.005, gyro_scale_sigma=0.003, misalignment_sigma_rad=0.003),
        left=SensorSpec(-1.0, **tip),
        right=SensorSpec(1.0, **tip),
        slope_sigma_ratio=0.01,
        trim_sigma_m=0.0002,
        bend_per_g_sigma_m=0.0004,
    )
    run = simulate(truth, tuple(range(40, 56)))
    estimate = Oracle(truth, samples(run, moving=False)).smoothed(np.array([8.0, 12.0]), 0.5)
    q = run.total_at(np.array([8.0, 12.0]))[:, :2].swapaxes(1, 2)
    nees = (((estimate.q_m - q) / estimate.q_sigma_m) ** 2).mean(axis=(0, 1))
    # misalignment is constant: 16 independent values, standard error of the mean square 0.35; three of them
    assert (nees < 2.06).all()
    assert (nees > 0.2).all()
