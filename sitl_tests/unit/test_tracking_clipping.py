"""Clipped samples: the mean that a vibration beyond the range leaves, and what is too much of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.tracking.streams import SampleBuffer
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, Floats, ImuBatch, Reject, Station

LEFT = load_airframe("nadir-2m").left
LIMIT_MPS2 = LEFT.accel_range_mps2
SECOND = 1_000_000_000
BATCH = 40


def _fed(vertical_mps2: Floats, axes: Axis = Axis.ALL) -> tuple[SampleBuffer, list[ImuBatch], int]:
    """Stream fed with a vertical axis (n,) at 1 kHz as a converter would give it; its batches; samples counted."""
    values = np.zeros((len(vertical_mps2), 6))
    values[:, 2] = np.clip(vertical_mps2, -LIMIT_MPS2, LIMIT_MPS2)
    t_ns = SECOND + 1_000_000 * np.arange(len(values), dtype=np.int64)
    batches = [
        ImuBatch(Station.LEFT, ClockName.HOST, t_ns[k : k + BATCH], values[k : k + BATCH], axes, SECOND)
        for k in range(0, len(values), BATCH)
    ]
    stream = SampleBuffer(LEFT)
    counted = 0
    for batch in batches:
        counted += sum(refusal.count for refusal in stream.add(batch, 0) if refusal.reason is Reject.SATURATED)
    return stream, batches, counted


def _gaussian(clipped_ratio: float, rng: np.random.Generator, count: int) -> Floats:
    """Gaussian vibration (count,) of which this share lies beyond the range."""
    from scipy.stats import norm

    return LIMIT_MPS2 / float(norm.isf(clipped_ratio / 2.0)) * rng.standard_normal(count)


def _sine(clipped_ratio: float, _rng: np.random.Generator, count: int) -> Floats:
    """Sine (count,) of which this share lies beyond the range, at a frequency that no count of samples divides."""
    return LIMIT_MPS2 / np.cos(np.pi * clipped_ratio / 2.0) * np.sin(2.0 * np.pi * 0.0712345 * np.arange(count))


@pytest.mark.parametrize("vibration", [_gaussian, _sine])
@pytest.mark.parametrize("clipped_ratio", [0.01, 0.05, 0.15])
def test_the_mean_of_what_vibrates_beyond_the_range_is_the_mean(vibration: object, clipped_ratio: float) -> None:
    """A step of a slow 9.8 to 19.6 m/s^2, with a vibration around it, less that vibration's own mean."""
    assert callable(vibration)
    rng = np.random.default_rng(3)
    shaken = vibration(clipped_ratio, rng, 60_000)
    slow = np.where(np.arange(60_000) < 30_000, -9.8, -19.6)
    stream, _, counted = _fed(slow + shaken)
    assert counted == np.count_nonzero(np.abs(slow + shaken) > 0.998 * LIMIT_MPS2)
    values = stream.samples()[1][:, 2]
    assert len(values) > 59_900, "but a few long runs all are held"
    middle, end = values[10_000:30_000].mean(), values[40_000:].mean()
    # four standard errors of the distortion of 20,000 samples at a share of 0.15, 0.17 of the vibration's deviation;
    # without the clipped ones 0.01 of a Gaussian cost 7 % of the mean, held at the limit without restoring 0.15 cost 15
    tolerance_mps2 = 0.06 * 9.8
    assert middle - shaken[10_000:30_000].mean() == pytest.approx(-9.8, abs=tolerance_mps2)
    assert end - middle - (shaken[40_000:].mean() - shaken[10_000:30_000].mean()) == pytest.approx(
        -9.8, abs=tolerance_mps2
    )


@pytest.mark.slow
def test_a_vibration_that_swells_and_fades_is_no_slow_force() -> None:
    """A common gain, which knows the seconds' share alone, gives back what a calm half second has not lost."""
    rng, t_s = np.random.default_rng(7), 1e-3 * np.arange(200_000)
    shaken = 0.7 * LIMIT_MPS2 * np.sin(np.pi * t_s) ** 2 * rng.standard_normal(len(t_s))
    stream, _, _ = _fed(-9.8 + shaken)
    values = stream.samples()[1][:, 2]
    assert len(values) > 199_900, "but a few long runs all are held"
    at = np.searchsorted(stream.samples()[0], SECOND + 1_000_000 * np.arange(20_000, 200_000))
    slow_mps2 = (values[at] - shaken[20_000:]).reshape(180, 10, 100).mean(axis=(0, 2))  # by tenths of the swell
    # 0.53 by a common gain; what the clipped samples exceed the limit by scatters by 0.1
    assert slow_mps2.std() < 0.25


def test_no_clipped_sample_leaves_the_values_as_they_are() -> None:
    vertical = -9.8 + np.random.default_rng(4).standard_normal(4_000)
    stream, _, counted = _fed(vertical)
    assert counted == 0
    np.testing.assert_array_equal(stream.samples()[1][:, 2], vertical)


@pytest.mark.parametrize("axes", [Axis.Z, Axis.ALL])
def test_a_sensor_clipped_by_more_than_a_fifth_blinds_until_it_is_still(axes: Axis) -> None:
    rng = np.random.default_rng(5)
    for clipped_ratio, blinds in ((0.15, False), (0.40, True)):
        stream, batches, _ = _fed(-9.8 + _gaussian(clipped_ratio, rng, 20_000), axes)
        assert stream.clipping.blinds is stream.is_saturated(21 * SECOND) is blinds
    still = dataclasses.replace(batches[0], values=np.tile([0.0, 0.0, -9.8, 0.0, 0.0, 0.0], (BATCH, 1)))
    for k in range(200):
        stream.add(dataclasses.replace(still, t_ns=still.t_ns + 20 * SECOND + k * BATCH * 1_000_000), 0)
    assert not stream.clipping.blinds


@pytest.mark.parametrize("first", [400, 418, 430])  # inside a batch, held at its end, across two
def test_a_run_of_more_than_4_ms_is_a_gap_though_there_were_others(first: int) -> None:
    vertical = np.full(800, -9.8)
    vertical[[100, 160, 220]] = 1e3
    vertical[first : first + 20] = 1e3
    stream, _, counted = _fed(vertical)
    assert counted == 23
    t_ns, values = stream.samples()
    assert np.diff(t_ns).max() == 21_000_000, "all twenty are missing"
    assert stream.saturated_ns == SECOND + (first + 19) * 1_000_000
    assert np.abs(values[t_ns > SECOND + 230_000_000, 2] + 9.8).max() < 0.05


def test_a_wing_that_swings_beyond_the_range_is_measured_between_its_peaks() -> None:
    """Its peaks are gaps, and no sample is moved for a loss that they did not cause."""
    vertical = -9.8 + 1.1 * LIMIT_MPS2 * np.sin(2.0 * np.pi * 5.0 * 1e-3 * np.arange(20_000))
    stream, _, counted = _fed(vertical)
    assert counted > 2_000
    t_ns, values = stream.samples()
    true_mps2 = vertical[(t_ns - SECOND) // 1_000_000]
    assert len(t_ns) == 20_000 - counted
    assert values[:, 2] == pytest.approx(true_mps2, abs=0.01)


def test_the_third_run_within_seconds_is_held() -> None:
    vertical = np.full(8_000, -9.8)
    for first in (1_000, 4_000, 7_000):
        vertical[first : first + 3] = 1e3
    stream, _, counted = _fed(vertical)
    assert counted == 9
    missing = np.flatnonzero(np.diff(stream.samples()[0]) > 1_000_000)
    assert missing.tolist() == [999, 3_996], "the first two, three samples each"


def test_a_single_run_is_no_vibration_and_becomes_a_gap() -> None:
    vertical = np.full(800, -9.8)
    vertical[400:404] = 1e3
    stream, _, counted = _fed(vertical)
    assert counted == 4
    assert np.diff(stream.samples()[0]).max() == 5_000_000
    assert stream.samples()[1][:, 2] == pytest.approx(-9.8, rel=0.002)


def test_values_that_are_not_finite_are_no_clipped_ones() -> None:
    values = np.zeros((4, 6))
    values[0, 2], values[1, 0] = np.inf, np.nan
    stream = SampleBuffer(LEFT)
    t_ns = SECOND + 1_000_000 * np.arange(4, dtype=np.int64)
    refused = stream.add(ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values, Axis.ALL, SECOND), 0)
    assert {refusal.reason: refusal.count for refusal in refused} == {Reject.NOT_FINITE: 2}
    assert not stream.clipping.active


def test_what_waits_for_another_station_is_kept_for_seconds_only() -> None:
    stream = SampleBuffer(LEFT)
    for k in range(600):
        t_ns = np.arange(k * 1000, (k + 1) * 1000, 3, dtype=np.int64) * 1_000_000
        stream.add(ImuBatch(Station.LEFT, ClockName.HOST, t_ns, np.ones((len(t_ns), 6)), Axis.ACCEL, int(t_ns[-1])), 0)
        stream.forget_waited()
        stream.first_ns()
    assert len(stream.samples()[0]) < 1500


def _shaken(limit_mps2: float, step_mps2: float = 0.0) -> SampleBuffer:
    """Stream of 6 s of a gust of 14 m/s^2 rms about one g, clipped at a limit, in steps of a resolution."""
    stream, rng = SampleBuffer(LEFT, "left"), np.random.default_rng(6)
    values = rng.standard_normal((6000, 6)) * np.repeat([0.02, 0.002], 3)
    values[:, 2] += -9.8 + np.convolve(14.0 * rng.standard_normal(6009), np.full(10, 10.0**-0.5), "valid")
    if step_mps2:
        values[:, 2] = np.round(values[:, 2] / step_mps2) * step_mps2
    values[:, :3] = np.clip(values[:, :3], -limit_mps2, limit_mps2)
    t_ns = SECOND + 1_000_000 * np.arange(len(values), dtype=np.int64)
    for k in range(0, len(values), BATCH):
        sent = slice(k, k + BATCH)
        stream.add(ImuBatch(Station.LEFT, ClockName.HOST, t_ns[sent], values[sent], Axis.ALL, SECOND), 0)
    return stream


def test_an_extreme_that_comes_again_and_again_is_the_range() -> None:
    stream = _shaken(39.2)
    assert stream.complaints == ["left accelerometer clips at 39.2 m/s2, its file says 157"]
    assert stream.clipping.often
    assert stream.clipping.found_range.range_of.tolist()[2] == 39.2
    values = np.random.default_rng(7).standard_normal((100, 6)) * np.repeat([0.02, 0.002], 3)
    values[:, 2] -= 60.0
    t_ns = 8 * SECOND + 1_000_000 * np.arange(len(values), dtype=np.int64)
    stream.add(ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values, Axis.ALL, SECOND), 0)
    assert stream.complaints == [], "a value beyond it refutes it"


@pytest.mark.parametrize("step_mps2", [0.0, 0.0098, 0.1])
def test_the_extreme_of_a_gust_is_no_range(step_mps2: float) -> None:
    assert _shaken(LIMIT_MPS2, step_mps2).complaints == []
