"""Single samples that contradict their neighbours: they are told from vibration, from blows and from other samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.tracking.sample_outliers import NEIGHBOURS, find_outliers
from companion.core.tracking.streams import SampleBuffer, within_range
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Reject, Station
from sitl_tests.native.averaging import averages_of

LEFT = load_airframe("nadir-2m").left
MS, COUNT = 1_000_000, 120
NOISE = 0.016
T_NS = MS * np.arange(COUNT, dtype=np.int64)


def _swing(vibration_mps2: float = 0.0) -> np.ndarray:
    """Six channels: a 5 Hz swing of 3 m/s^2, a vibration at 230 Hz, the sensor's noise."""
    t = 1e-9 * T_NS[:, np.newaxis]
    noise = NOISE * np.random.default_rng(4).standard_normal((COUNT, 6))
    return 3.0 * np.sin(2 * np.pi * 5.0 * t) + vibration_mps2 * np.sin(2 * np.pi * 230.0 * t + 1.0) + noise


def _judged(values: np.ndarray) -> np.ndarray:
    return np.flatnonzero(find_outliers(T_NS, values, 0, np.full(6, 1.4 * NOISE), float(MS)))


@given(
    st.integers(2 * NEIGHBOURS, COUNT - 2 * NEIGHBOURS),
    st.integers(0, 5),
    st.sampled_from([-4.0, -1.0, 1.0, 2.0, 8.0, 1e6]),
)
def test_a_sample_that_lies_is_told_and_no_other(at: int, channel: int, lie_mps2: float) -> None:
    values = _swing()
    values[at, channel] += lie_mps2
    assert _judged(values).tolist() == [at]


@pytest.mark.parametrize("vibration_mps2", [0.0, 1.0, 30.0])
def test_noise_and_vibration_are_no_lapse(vibration_mps2: float) -> None:
    assert not len(_judged(_swing(vibration_mps2)))


def test_slope_times_force_is_seldom_taken_for_a_lapse() -> None:
    """A lateral axis shows white force times a swinging slope: its tails are longer than the noise around them."""
    rng = np.random.default_rng(7)
    t_ns = MS * np.arange(40_000, dtype=np.int64)
    values = NOISE * rng.standard_normal((len(t_ns), 6))
    values[:, 1] += 0.15 * np.sin(2 * np.pi * 10.0 * 1e-9 * t_ns) * rng.standard_normal(len(t_ns))
    assert np.count_nonzero(find_outliers(t_ns, values, 0, np.full(6, 1.4 * NOISE), float(MS))) <= 2


def test_slope_times_a_force_that_the_vertical_axis_shows_is_no_lapse() -> None:
    """With such samples, one in 10,000, went their vertical force: rows of 4 ms were up to 45 m/s^2 wrong."""
    rng = np.random.default_rng(7)
    t_ns = MS * np.arange(200_000, dtype=np.int64)
    values = NOISE * rng.standard_normal((len(t_ns), 6))
    force = 15.0 * rng.standard_normal(len(t_ns))
    values[:, 2] += force
    values[:, 1] += 0.01 * np.sin(2 * np.pi * 20.0 * 1e-9 * t_ns) * force
    assert not np.count_nonzero(find_outliers(t_ns, values, 0, np.full(6, 1.4 * NOISE), float(MS)))


@pytest.mark.parametrize("length_s", [0.005, 0.02])
@pytest.mark.parametrize("peak_mps2", [1.0, 10.0, 100.0])
def test_a_blow_is_no_lapse(length_s: float, peak_mps2: float) -> None:
    values = _swing()
    phase = (1e-9 * T_NS - 0.05) / length_s
    values[:, 2] += peak_mps2 * np.where((phase > 0) & (phase < 1), np.sin(np.pi * phase), 0.0)
    assert not len(_judged(values))


def _batch(t_ns: np.ndarray, values: np.ndarray) -> ImuBatch:
    return ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values, Axis.ALL, int(t_ns[-1]))


def test_a_stream_refuses_the_lapse_as_soon_as_it_has_its_neighbours_and_says_so_with_the_next_batch() -> None:
    clean, struck = SampleBuffer(LEFT), SampleBuffer(LEFT)
    values = _swing()
    lying = values.copy()
    lying[60, 2] += 5.0
    for stream, samples in ((clean, values), (struck, lying)):
        refused = []
        for first in range(0, COUNT, 20):
            chunk = slice(first, first + 20)
            refused += stream.add(_batch(T_NS[chunk], samples[chunk]), -1)
            stream.samples()
        assert [(r.reason, r.count) for r in refused] == ([] if stream is clean else [(Reject.LAPSED, 1)])
    assert len(struck.samples()[0]) == COUNT - 1
    edges = 4 * MS * np.arange(5, 25, dtype=np.int64)
    np.testing.assert_allclose(averages_of(struck, edges).mean, averages_of(clean, edges).mean, atol=0.05)
    # nobody knows yet whether the newest samples lie: epochs that can do without them do
    young = SampleBuffer(LEFT)
    young.add(_batch(T_NS[:62], lying[:62]), -1)
    np.testing.assert_allclose(averages_of(young, edges[:9]).mean, averages_of(clean, edges[:9]).mean, atol=1e-9)


@given(st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_no_value_beyond_the_range_gets_into_a_stream(value: float) -> None:
    stream, values = SampleBuffer(LEFT), _swing()
    values[60, 2] = value
    refused = stream.add(_batch(T_NS, values), -1)
    assert np.abs(stream.samples()[1]).max() <= 1.05 * LEFT.accel_range_mps2
    reasons = {record.reason for record in refused}
    assert (Reject.BEYOND_RANGE in reasons) == (abs(value) > 1.05 * LEFT.accel_range_mps2)
    valid, counted = within_range(_batch(T_NS, values), LEFT)
    assert len(valid.t_ns) + sum(r.count for r in counted) == COUNT
