"""One stream: what is refused, what order does not matter, what a gap leaves uncovered."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.core.tracking.streams import SampleBuffer
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Reject, Station
from sitl_tests.native.averaging import averages_of

LEFT = load_airframe("nadir-2m").left
SECOND = 1_000_000_000


def _batch(t_ms: np.ndarray, values: np.ndarray | None = None) -> ImuBatch:
    t_ns = np.round(np.asarray(t_ms) * 1e6).astype(np.int64) + SECOND
    if values is None:
        values = np.sin(np.outer(np.asarray(t_ms) * 0.03, np.arange(1, 7)))
    return ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values, Axis.ALL, SECOND)


def _edges() -> np.ndarray:
    return SECOND + 4_000_000 * np.arange(5, 40, dtype=np.int64)


def test_bad_samples_are_refused_and_counted_and_the_rest_is_kept() -> None:
    stream = SampleBuffer(LEFT)
    values = np.zeros((6, 6))
    values[1, 0], values[2, 4], values[3, 2] = np.nan, np.inf, -LEFT.accel_range_mps2
    refused = stream.add(_batch(np.arange(6.0), values), SECOND)
    counts = {r.reason: r.count for r in refused}
    assert counts == {Reject.NOT_FINITE: 2, Reject.SATURATED: 1, Reject.TOO_LATE: 1}
    assert len(stream.samples()[0]) == 2
    assert stream.saturated_ns == SECOND + 3_000_000


@given(st.permutations(range(8)))
def test_the_order_of_arrival_does_not_matter(order: list[int]) -> None:
    straight, shuffled = SampleBuffer(LEFT), SampleBuffer(LEFT)
    t = np.arange(0.5, 200.0)
    straight.add(_batch(t), 0)
    for chunk in order:
        shuffled.add(_batch(t[chunk * 25 : chunk * 25 + 25]), 0)
    a, b = averages_of(straight, _edges()), averages_of(shuffled, _edges())
    np.testing.assert_array_equal(a.mean, b.mean)
    np.testing.assert_array_equal(a.covered, b.covered)


def test_equal_stamps_are_averaged() -> None:
    stream = SampleBuffer(LEFT)
    t = np.repeat(np.arange(0.5, 200.0), 2)
    values = np.ones((len(t), 6))
    values[::2] = 3.0
    stream.add(_batch(t, values), 0)
    np.testing.assert_allclose(averages_of(stream, _edges()).mean, 2.0)


def test_a_gap_uncovers_the_cells_that_touch_it_and_no_others() -> None:
    stream = SampleBuffer(LEFT)
    t = np.arange(0.5, 200.0)
    stream.add(_batch(t[(t < 80) | (t > 110)]), 0)
    covered = averages_of(stream, _edges()).covered
    starts = (_edges()[:-1] - SECOND) / 1e6
    assert not covered[(starts >= 80) & (starts < 108)].any()
    assert covered[(starts < 76) | (starts >= 112)].all()


def test_a_few_lost_samples_are_bridged() -> None:
    stream = SampleBuffer(LEFT)
    t = np.arange(0.5, 200.0)
    keep = np.random.default_rng(0).random(len(t)) > 0.1
    w = 2 * np.pi * 5e-3
    stream.add(_batch(t[keep], np.repeat(np.sin(w * t[keep])[:, None], 6, axis=1)), 0)
    middle = (0.5 * (_edges()[1:] + _edges()[:-1]) - SECOND) / 1e6
    np.testing.assert_allclose(averages_of(stream, _edges()).mean[:, 0], np.sin(w * middle), atol=4e-3)


def test_a_slow_stream_makes_no_moment() -> None:
    slow = SampleBuffer(dataclasses.replace(LEFT, rate_hz=333.0))
    slow.add(_batch(np.arange(0.0, 200.0, 3.0)), 0)
    assert not averages_of(slow, _edges()).resolved.any()


def test_views_and_read_only_arrays_are_taken_like_any_other() -> None:
    plain, strided, frozen = SampleBuffer(LEFT), SampleBuffer(LEFT), SampleBuffer(LEFT)
    t = np.arange(0.5, 200.0)
    batch = _batch(t)
    table = np.zeros((len(t), 8))
    table[:, 1:7] = batch.values
    values = batch.values.copy()
    values.flags.writeable = False
    plain.add(batch, 0)
    strided.add(dataclasses.replace(batch, t_ns=np.repeat(batch.t_ns, 2)[::2], values=table[:, 1:7]), 0)
    frozen.add(dataclasses.replace(batch, values=values), 0)
    for other in (strided, frozen):
        np.testing.assert_array_equal(averages_of(other, _edges()).mean, averages_of(plain, _edges()).mean)


def _sent_on(
    stream: SampleBuffer, values: np.ndarray, first_ms: int = 0, axes: Axis = Axis.ALL
) -> list[tuple[int, Reject]]:
    """Instants (ms) and reasons of refusals, where values (n, 6) come 20 at a time, one a millisecond."""
    refused = []
    for at in range(0, len(values), 20):
        t_ns = 1_000_000 * (first_ms + at + np.arange(20, dtype=np.int64))
        sent = ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values[at : at + 20], axes, int(t_ns[-1]))
        refused += [(first_ms + at, each.reason) for each in stream.add(sent, -1)]
    return refused


def _noisy(count: int, accel_step_mps2: float = 0.0) -> np.ndarray:
    """Noise of the sensor at rest, (n, 6), in steps of the accelerometers' resolution."""
    sensor = LEFT
    density = np.repeat([sensor.accel_noise_mps2_rthz, sensor.gyro_noise_radps_rthz], 3)
    values = np.random.default_rng(4).normal(size=(count, 6)) * density * np.sqrt(500.0)
    if accel_step_mps2:
        values[:, :3] = np.round(values[:, :3] / accel_step_mps2) * accel_step_mps2
    return values


def test_a_channel_that_stands_still_is_refused_from_its_last_change_on_until_it_has_moved_for_a_while() -> None:
    stream = SampleBuffer(LEFT, "left")
    values = _noisy(10_000)
    values[6000:7000, 1] = values[6000, 1]
    refused = _sent_on(stream, values[:6500])
    assert {reason for _, reason in refused} == {Reject.STALE}
    assert refused[0][0] in (6040, 6060)
    assert int(stream.samples()[0][-1]) == 6_000_000_000
    assert stream.newest_ns == 6_000_000_000
    assert stream.complaints == ["left y stands still: its samples are not used"]
    refused = _sent_on(stream, values[6500:], 6500)
    assert 7150 < max(at_ms for at_ms, _ in refused) < 7250
    assert stream.complaints == []


def test_a_channel_coarser_than_its_noise_may_stand_still_and_so_may_one_at_its_limit() -> None:
    sensor = LEFT
    sigma_mps2 = sensor.accel_noise_mps2_rthz * np.sqrt(500.0)
    for step_mps2, coarse in ((0.3 * sigma_mps2, False), (1.5 * sigma_mps2, True)):
        stream, values = SampleBuffer(sensor, "left"), _noisy(7000, step_mps2)
        values[6000:, 1] = values[6000, 1]
        assert bool(_sent_on(stream, values)) is not coarse
    stream, values = SampleBuffer(sensor, "left"), _noisy(7000)
    values[6000:, 2] = sensor.accel_range_mps2
    assert Reject.STALE not in {reason for _, reason in _sent_on(stream, values)}


def test_an_axis_that_is_not_sent_may_stand_still() -> None:
    stream, values = SampleBuffer(LEFT, "left"), _noisy(7000)
    values[6000:, 1] = values[6000, 1]
    assert not _sent_on(stream, values, axes=Axis.Z | Axis.P)
