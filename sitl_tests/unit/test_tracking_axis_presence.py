"""A gyro or an axis that stops coming is missing, and no measured zero."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.tracking.streams import SampleBuffer
from companion.core.tracking.tracker import WingTracker
from companion.params.settings import Settings
from companion.records import Axis, ClockName, ImuBatch, Station, Validity
from sitl_tests.unit.tracking_samples import EPOCH_NS, plain_airframe, swinging

MS = 1_000_000


def _batch(station: Station, t_ns: np.ndarray, values: np.ndarray, axes: Axis = Axis.ALL) -> ImuBatch:
    """As the decoder makes it: axes that a message does not have are 0."""
    return ImuBatch(station, ClockName.HOST, t_ns, np.where(axes.mask, values, 0.0), axes, int(t_ns[-1]))


def test_an_axis_that_stops_is_held_for_a_moment_and_then_missing() -> None:
    stream = SampleBuffer(plain_airframe().left, "left")
    values = np.sin(np.outer(np.arange(300.0), 0.02 * np.arange(1, 7)))
    t_ns = EPOCH_NS + MS * np.arange(300, dtype=np.int64)
    for first in range(0, 300, 10):
        axes = Axis.ALL if first < 100 or first >= 250 else Axis.ACCEL
        stream.add(_batch(Station.LEFT, t_ns[first : first + 10], values[first : first + 10], axes), 0)
        assert stream.axes == (Axis.ACCEL if 150 <= first < 250 else Axis.ALL), first
        assert bool(stream.complaints) is (150 <= first < 250)
    taken_ns, taken = stream.samples()
    at = (taken_ns - EPOCH_NS) // MS
    assert len(at) >= 298, "where an axis goes or comes, its step is one sample's"
    held = (at >= 100) & (at < 150)
    np.testing.assert_array_equal(taken[held, 3:], np.tile(values[99, 3:], (np.sum(held), 1)))
    np.testing.assert_array_equal(taken[:, :3], values[at, :3])


def test_axes_that_come_in_turn_are_all_there() -> None:
    """Every other message has the accelerometer alone."""
    stream = SampleBuffer(plain_airframe().left)
    for k in range(200):
        axes = Axis.ACCEL if k % 2 else Axis.GYRO
        stream.add(_batch(Station.LEFT, np.array([EPOCH_NS + MS * k]), np.full((1, 6), 0.01 * (1.0 + k)), axes), 0)
    assert stream.axes == Axis.ALL
    _, taken = stream.samples()
    assert np.all(np.abs(taken[2:] - 0.01 * np.arange(3.0, 201.0)[:, None]) <= 0.0101)


@pytest.mark.parametrize(
    ("station", "validity"), [(Station.LEFT, {Validity.TRACKING, Validity.SETTLING}), (Station.ROOT, {Validity.STALE})]
)
def test_a_gyro_that_stops_is_no_standing_wing(station: Station, validity: set[Validity]) -> None:
    """Its rows are gone; without the root's rates nothing is trusted."""
    tracker = WingTracker(plain_airframe(), Settings())
    t_ns, values = swinging(4.0, 0.01)
    state = None
    for first in range(0, len(t_ns), 20):
        span = slice(first, first + 20)
        for each in Station:
            axes = Axis.ACCEL if each is station and first >= 2000 else Axis.ALL
            tracker.add(_batch(each, t_ns[span], values[each][span], axes))
        state = tracker.advance(int(t_ns[first]) + 30 * MS) or state
    assert state is not None
    assert state.validity in validity
    assert [sentence for sentence in tracker.complaints if "sends no pqr any more" in sentence]
