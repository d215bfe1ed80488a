"""Rates of what leaves, obstacles as points, and that a change of trust never waits."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component import encode
from companion.adapters.mavlink.component.range_publisher import RangePublisher
from companion.params.settings import Settings
from companion.records import CorrectedRange, NoRange, ObstacleSectors, Reject, VehicleState

MS = 1_000_000
ANY = st.floats(allow_nan=True, allow_infinity=True)


def measured(t_ns: int, trusted: bool = True) -> CorrectedRange:
    return CorrectedRange(1, 1, t_ns, 25, 42.0, 0.1, 0.0, 1e-4, 0.0, 50, trusted, None)


def none(t_ns: int, orientation: int = 25) -> NoRange:
    return NoRange(t_ns, orientation, Reject.STALE)


def obstacle_sectors(t_ns: int, distances: dict[int, float], max_m: float = 100.0) -> ObstacleSectors:
    known_mask, distance = np.zeros(72, dtype=bool), np.zeros(72)
    for sector, metres in distances.items():
        known_mask[sector], distance[sector] = True, metres
    return ObstacleSectors(t_ns, distance, np.full(72, 0.1), known_mask, np.zeros(72, dtype=bool), 4.0, max_m)


def sent(message: Any) -> Any:
    (received,) = mavlink.MAVLink(None).parse_buffer(message.pack(mavlink.MAVLink(None, 1, 191)))
    return received


@pytest.mark.parametrize(("shots_hz", "rate_hz"), [(30, 10), (10, 10), (7, 10), (50, 2)])
def test_ranges_leave_at_their_rate_at_most(shots_hz: int, rate_hz: int) -> None:
    outputs = RangePublisher(Settings(publish_rate_hz=rate_hz), 25)
    times = [k * 1000 * MS // shots_hz for k in range(10 * shots_hz)]
    count = sum(len(outputs.messages(measured(t), 0, t)) for t in times)
    assert count <= 10 * rate_hz / 0.7 + 1
    assert count >= 0.9 * 10 * min(shots_hz, rate_hz)


def test_a_change_of_trust_goes_out_at_once() -> None:
    outputs = RangePublisher(Settings(), 25)
    outputs.note_motion(state(0, 0.0))
    kinds = []
    for k, record in enumerate([measured(0), measured(1), none(2), none(3), measured(4), measured(5, trusted=False)]):
        kinds += [message.signal_quality == 1 for message in outputs.messages(record, 0, k * MS)]
    assert kinds == [False, True, False, True]


@pytest.mark.slow
@given(
    rows=st.lists(st.tuples(ANY, st.booleans()), min_size=72, max_size=72),
    min_m=ANY,
    max_m=ANY,
    time_ms=st.integers(-(2**62), 2**62),
)
def test_no_point_lies(rows: list[tuple[float, bool]], min_m: float, max_m: float, time_ms: int) -> None:
    distance, known_mask = (np.array(column) for column in zip(*rows, strict=True))
    record = ObstacleSectors(0, distance, np.zeros(72), known_mask, np.zeros(72, dtype=bool), min_m, max_m)
    points = [sent(message) for message in encode.obstacle_points(record, time_ms)]
    assert 1 <= len(points) <= 72
    assert len({point.time_boot_ms for point in points}) == 1
    for point in points:
        numbers = (point.x, point.y, point.z, point.min_distance, point.max_distance)
        assert all(math.isfinite(number) for number in numbers)
        assert point.frame == 12
        assert point.obstacle_id == 65535
        assert np.hypot(point.x, point.y) >= point.min_distance * (1 - 1e-6)


def test_points_lie_where_the_sectors_are() -> None:
    ahead, right, behind_left = (
        sent(message) for message in encode.obstacle_points(obstacle_sectors(0, {0: 10.0, 18: 20.0, 45: 30.0}), 7)
    )
    assert (ahead.x, ahead.y) == pytest.approx((10.0, 0.0))
    assert (right.x, right.y) == pytest.approx((0.0, 20.0), abs=1e-5)  # clockwise, y to the right
    assert (behind_left.x, behind_left.y) == pytest.approx((-30 * math.sqrt(0.5), -30 * math.sqrt(0.5)))


@pytest.mark.parametrize("min_m", [0.5, 4.0, 4.35, 100.0])
def test_points_that_are_nearer_than_the_least_distance_are_put_there(min_m: float) -> None:
    """An autopilot passes over a point that is nearer than the message's least distance."""
    circle = dataclasses.replace(obstacle_sectors(0, dict.fromkeys(range(72), 0.9 * min_m), 200.0), min_m=min_m)
    points = [sent(message) for message in encode.obstacle_points(circle, 7)]
    assert len(points) == 72
    for point in points:
        length_m = np.sqrt(np.float32(point.x) ** 2 + np.float32(point.y) ** 2, dtype=np.float32)
        assert point.min_distance <= length_m < point.min_distance + 0.001


def test_stamps_of_points_advance_and_follow_a_restart() -> None:
    outputs = RangePublisher(Settings(obstacles=2), 0)
    stamps = []
    for k, t_ms in enumerate([5000, 5000, 4990, 5200, 30, 130]):
        now_ns = k * 1000 * MS
        (message,) = outputs.messages(obstacle_sectors(now_ns, {}), t_ms * MS - now_ns, now_ns)
        assert math.hypot(message.x, message.y) > message.max_distance, "a look without obstacles still ends the last"
        stamps.append(message.time_boot_ms)
    assert stamps == [5000, 5001, 5002, 5200, 30, 130]


def test_obstacles_take_the_form_that_is_set_and_alive_without_range_is_all_unknown() -> None:
    for form, expected in ((0, []), (1, ["OBSTACLE_DISTANCE"]), (2, ["OBSTACLE_DISTANCE_3D"])):
        outputs = RangePublisher(Settings(obstacles=form), 0)
        assert [m.get_type() for m in outputs.messages(obstacle_sectors(0, {3: 9.0}), 0, 0)] == expected
        kinds = [m.get_type() for m in outputs.messages(none(0, 0), 0, 1000 * MS)]
        assert kinds == ["DISTANCE_SENSOR", *expected]
    outputs = RangePublisher(Settings(), 0)
    circle = sent(outputs.messages(none(0, 0), 0, 0)[1])
    assert set(circle.distances) == {65535}
    assert [m.get_type() for m in RangePublisher(Settings(), 25).messages(none(0), 0, 0)] == ["DISTANCE_SENSOR"]


def state(t_ns: int, climb_mps: float) -> VehicleState:
    return VehicleState(t_ns, t_ns, 0.0, 0.0, 0.0, 20.0, climb_mps, 0.5, True)


def test_a_downward_range_is_moved_on_to_the_instant_of_sending() -> None:
    """42 m at the exposure, 0.6 s of sinking at 2 m/s: 40.8 m now, stamped now; 0.18 m of sigma by the climb rate."""
    outputs = RangePublisher(Settings(), 25)
    for k in range(10):
        outputs.note_motion(state(1000 * MS + 100 * k * MS, -2.0))
    (message,) = outputs.messages(measured(1100 * MS), 50 * MS, 1700 * MS)
    assert sent(message).current_distance == 4080
    assert sent(message).time_boot_ms == 1750
    assert sent(message).covariance == 255, "424 cm^2: more than the field holds"


def test_the_climb_since_the_exposure_counts_not_that_before() -> None:
    outputs = RangePublisher(Settings(), 25)
    for k in range(10):
        outputs.note_motion(state(100 * k * MS, -5.0))
    for k in range(10, 15):
        outputs.note_motion(state(100 * k * MS, 1.0))
    (message,) = outputs.messages(measured(1000 * MS), 0, 1500 * MS)
    assert sent(message).current_distance == 4250


def test_a_range_of_a_pair_that_looks_aside_stays_as_it_was() -> None:
    outputs = RangePublisher(Settings(), 6)
    outputs.note_motion(state(1200 * MS, -2.0))
    (message,) = outputs.messages(dataclasses.replace(measured(1000 * MS), orientation=6), 0, 1500 * MS)
    assert sent(message).current_distance == 4200
    assert sent(message).time_boot_ms == 1000


def test_a_speed_that_was_told_before_the_exposure_moves_the_range_and_widens_its_sigma() -> None:
    """42 m, 0.5 s of sinking at 2 m/s; the speed may be 3 m/s off by now."""
    outputs = RangePublisher(Settings(trust_ratio=0.2), 25)
    outputs.note_motion(state(900 * MS, -2.0))
    record = dataclasses.replace(measured(1000 * MS), sigma_m=0.01)
    (message,) = outputs.messages(record, 0, 1500 * MS)
    assert sent(message).current_distance == 4100
    assert sent(message).covariance == 255, "150^2 cm^2: more than the field holds"


@pytest.mark.parametrize(("range_m", "goes_out"), [(95.0, True), (70.0, True), (59.0, False)])
def test_what_the_way_makes_too_vague_is_not_sent(range_m: float, goes_out: bool) -> None:
    """0.6 s by airspeed alone: 1.8 m of sigma, 3 % of 60 m; what is too near to measure is sent all the same."""
    outputs = RangePublisher(Settings(), 0)
    for k in range(10):
        outputs.note_motion(state(1000 * MS + 100 * k * MS, 0.0))
    record = dataclasses.replace(measured(1100 * MS), orientation=0, range_m=range_m + 12.0)
    (message,) = outputs.messages(record, 0, 1700 * MS)
    assert (sent(message).signal_quality != encode.NO_RANGE_QUALITY) is goes_out
    (circle,) = outputs.messages(obstacle_sectors(1100 * MS, {0: range_m + 12.0, 1: 9.0}), 0, 1700 * MS)
    distances = sent(circle).distances
    assert distances[4] == (round(100 * range_m) if goes_out else 65535)
    assert distances[5] == 400


def test_a_flare_keeps_its_ranges() -> None:
    """5 m and 0.25 m of sigma after 0.6 s at the usual rate: 5 %, and of use."""
    outputs = RangePublisher(Settings(), 25)
    for k in range(14):
        outputs.note_motion(state(1000 * MS + 50 * k * MS, -0.5))
    record = dataclasses.replace(measured(1100 * MS), range_m=5.3, sigma_m=0.15)
    (message,) = outputs.messages(record, 0, 1700 * MS)
    assert sent(message).current_distance == 500


def covariance_cm2(climb_told_ms: int) -> int | None:
    """Covariance of a downward range sent at 3 s where attitudes come until then; None: no range is sent."""
    outputs = RangePublisher(Settings(trust_ratio=0.2), 25)
    for at_ms in range(2700, 3000, 10):
        state_of_then = state(at_ms * MS, -0.1)
        outputs.note_motion(dataclasses.replace(state_of_then, air_host_ns=min(at_ms, climb_told_ms) * MS))
    record = dataclasses.replace(measured(2970 * MS), range_m=100.0, sigma_m=0.01)
    (message,) = outputs.messages(record, 0, 3000 * MS)
    return None if sent(message).signal_quality == encode.NO_RANGE_QUALITY else int(sent(message).covariance)


def test_attitudes_make_no_climb_younger_that_stopped() -> None:
    """VFR_HUD ends, ATTITUDE goes on: the climb's sigma grows by 3 m/s^2, and after 2 s nothing is sent by it."""
    fresh, older, old = covariance_cm2(2980), covariance_cm2(2750), covariance_cm2(1100)
    assert fresh is not None
    assert older is not None
    assert fresh < 10
    assert older == math.ceil(100**2 * (0.01**2 + 0.03**2 * (0.3**2 + 3.0**2) + (1.5 * 0.25**2) ** 2))
    assert old == 255
    assert covariance_cm2(950) is None


@pytest.mark.parametrize("orientation", [0, 25])
@pytest.mark.parametrize(("told_at_ms", "exposed_ms"), [(None, 3800), (1900, 3800), (3900, 1900)])
def test_no_range_goes_out_where_nothing_tells_how_it_changed(
    orientation: int, told_at_ms: int | None, exposed_ms: int
) -> None:
    """The autopilot never told its speed, or more than 2 s ago; or the exposure is older than that."""
    outputs = RangePublisher(Settings(), orientation)
    if told_at_ms is not None:
        outputs.note_motion(state(told_at_ms * MS, -2.0))
    record = dataclasses.replace(measured(exposed_ms * MS), orientation=orientation)
    (message,) = outputs.messages(record, 0, 4000 * MS)
    assert sent(message).signal_quality == encode.NO_RANGE_QUALITY
    assert sent(message).time_boot_ms == 4000
    if orientation == 0:
        (circle,) = outputs.messages(obstacle_sectors(exposed_ms * MS, {0: 42.0}), 0, 4000 * MS)
        assert set(sent(circle).distances) == {65535}


@pytest.mark.parametrize(
    ("velocity_ned_mps", "metres_cm", "sigma_m"),
    [(None, 3000, math.hypot(0.1, 1.8)), ((0.0, 24.0, 0.0), 2760, math.hypot(0.1, 0.18))],
)
def test_what_lies_ahead_is_moved_on_by_the_speed_towards_it(
    velocity_ned_mps: tuple[float, float, float] | None, metres_cm: int, sigma_m: float
) -> None:
    """42 m at the exposure, 0.6 s at 20 m/s of airspeed or, heading east, 24 over ground."""
    outputs = RangePublisher(Settings(trust_ratio=0.2), 0)
    for k in range(10):
        flying = dataclasses.replace(state(1000 * MS + 100 * k * MS, 0.0), yaw_rad=math.pi / 2)
        outputs.note_motion(dataclasses.replace(flying, velocity_ned_mps=velocity_ned_mps))
    record = dataclasses.replace(measured(1100 * MS), orientation=0)
    (message,) = outputs.messages(record, 0, 1700 * MS)
    assert sent(message).current_distance == metres_cm
    assert sent(message).covariance == min(round((100 * sigma_m) ** 2), 255)
    (circle,) = outputs.messages(obstacle_sectors(1100 * MS, {0: 42.0, 12: 42.0, 18: 42.0, 1: 6.0}), 0, 1700 * MS)
    distances = dict(zip(np.arange(-4, 68) % 72, sent(circle).distances, strict=True))
    approached_cm = 4200 - metres_cm
    assert [distances[k] for k in (0, 12, 18)] == [metres_cm, 4200 - approached_cm // 2, 4200]
    assert distances[1] == 400, "too near to be measured by now, and still there"


def test_ahead_no_range_is_no_free_way() -> None:
    """PX4's collision prevention reads what is too far as a free way, and leaves out what is too near."""
    outputs = RangePublisher(Settings(), 0)
    message = sent(outputs.messages(none(0, 0), 0, 0)[0])
    assert min(message.current_distance, message.max_distance) <= message.min_distance
    assert message.signal_quality == 1
    unsure = dataclasses.replace(measured(1000 * MS, trusted=False), orientation=0)
    assert sent(outputs.messages(unsure, 0, 1000 * MS)[0]).current_distance == 0


def test_sectors_stand_until_nothing_was_known_for_as_long_as_of_a_range() -> None:
    """Sky on the axis and a tree beside it: pairs bring sectors and no range, in turn with "alive, no range"."""
    outputs = RangePublisher(Settings(), 0)
    circles = []
    for k in range(100):
        record = obstacle_sectors(k * 100 * MS, {3: 30.0}) if k % 4 < 2 else none(k * 100 * MS, 0)
        circles += [m for m in outputs.messages(record, 0, k * 100 * MS) if m.get_type() == "OBSTACLE_DISTANCE"]
    assert circles
    assert all(3000 in circle.distances for circle in circles)
    silent = [outputs.messages(none(0, 0), 0, (10_000 + 100 * k) * MS) for k in range(8)]
    assert any(m.get_type() == "OBSTACLE_DISTANCE" and set(m.distances) == {65535} for sent in silent for m in sent)
