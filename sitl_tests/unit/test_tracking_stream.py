"""One stream: what is refused, what order does not matter, what a gap leaves uncovered."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.core.tracking.streams import SampleBuffer
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Reject, Station

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
    a, b = straight.average(_edges()), shuffled.average(_edges())
    np.testing.assert_array_equal(a.mean, b.mean)
    np.testing.assert_array_equal(a.covered, b.covered)


def test_equal_stamps_are_averaged() -> None:
    stream = SampleBuffer(LEFT)
    t = np.repeat(np.arange(0.5, 200.0), 2)
    values = np.ones((len(t), 6))
    values[::2] = 3.0
    stream.add(_batch(t, values), 0)
    np.testing.assert_allclose(stream.average(_edges()).mean, 2.0)


def test_a_gap_uncovers_the_cells_that_touch_it_and_no_others() -> None:
    stream = SampleBuffer(LEFT)
    t = np.arange(0.5, 200.0)
    stream.add(_batch(t[(t < 80) | (t > 110)]), 0)
    covered = stream.average(_edges()).covered
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
    np.testing.assert_allclose(stream.average(_edges()).mean[:, 0], np.sin(w * middle), atol=4e-3)


def test_a_slow_stream_makes_no_moment() -> None:
    slow = SampleBuffer(dataclasses.replace(LEFT, rate_hz=333.0))
    slow.add(_batch(np.arange(0.0, 200.0, 3.0)), 0)
    assert not slow.average(_edges()).resolved.any()


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
        np.testing.assert_array_equal(other.average(_edges()).mean, plain.average(_edges()).mean)
