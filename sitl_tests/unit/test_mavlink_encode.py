"""Messages that leave: always finite, always in range, and "no range" wherever a number would be a guess."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component import encode
from companion.records import CorrectedRange, Health, ObstacleSectors

ANY = st.floats(allow_nan=True, allow_infinity=True)
NEAR = st.floats(-1e3, 1e3)
TIMES = st.integers(-(2**62), 2**62)


def sent(message: Any) -> Any:
    """The message as a receiver has it: packed and parsed by pymavlink."""
    frame = message.pack(mavlink.MAVLink(None, 1, 191))
    (received,) = mavlink.MAVLink(None).parse_buffer(frame)
    return received


def every_number(message: Any) -> list[float]:
    numbers: list[float] = []
    for name in message.get_fieldnames():
        value = getattr(message, name)
        numbers += [item for item in (value if isinstance(value, list) else [value]) if isinstance(item, int | float)]
    return numbers


def a_range(
    range_m: float = 42.0, sigma_m: float = 0.1, trusted: bool = True, orientation: int = 25, toe_rad: float = 0.0
) -> CorrectedRange:
    return CorrectedRange(1, 1, 10**9, orientation, range_m, sigma_m, toe_rad, 1e-4, 0.0, 50, trusted, None)


@given(
    range_m=st.one_of(ANY, NEAR),
    sigma_m=st.one_of(ANY, NEAR),
    trusted=st.booleans(),
    orientation=st.integers(-5, 400),
    min_m=ANY,
    max_m=ANY,
    time_ms=TIMES,
)
def test_no_distance_sensor_lies(
    range_m: float, sigma_m: float, trusted: bool, orientation: int, min_m: float, max_m: float, time_ms: int
) -> None:
    record = a_range(range_m, sigma_m, trusted, orientation)
    message = sent(encode.distance_sensor(record, min_m, max_m, time_ms))
    assert all(math.isfinite(number) for number in every_number(message))
    assert message.min_distance <= message.max_distance
    if message.signal_quality == 1:
        assert message.current_distance == (message.max_distance + 1 if orientation == 25 else 0)
        assert message.covariance == 255
    else:
        assert trusted
        assert sigma_m >= 0
        assert 2 <= message.signal_quality <= 100
        assert message.min_distance <= message.current_distance <= message.max_distance
        assert abs(message.current_distance - 100 * range_m) <= 0.5 + 1e-9 * abs(range_m)
        assert message.covariance == 255 or message.covariance >= min(254.0, (100 * sigma_m) ** 2) - 1e-9


@pytest.mark.parametrize(
    ("sigma_m", "covariance"), [(0.0, 1), (0.05, 25), (0.051, 27), (0.159, 253), (0.16, 255), (3.0, 255)]
)
def test_covariance_is_square_centimetres_and_unknown_beyond_254(sigma_m: float, covariance: int) -> None:
    assert sent(encode.distance_sensor(a_range(sigma_m=sigma_m), 4, 200, 0)).covariance == covariance


def test_a_trusted_range_is_centimetres_with_its_orientation() -> None:
    message = sent(encode.distance_sensor(a_range(59.876), 4, 200, 123))
    assert (message.current_distance, message.orientation, message.time_boot_ms) == (5988, 25, 123)
    assert (message.min_distance, message.max_distance) == (400, 20_000)


@pytest.mark.parametrize("record", [a_range(3.9), a_range(201.0), a_range(trusted=False), a_range(math.nan)])
def test_alive_without_range_is_out_of_range_with_quality_one(record: CorrectedRange) -> None:
    message = sent(encode.distance_sensor(record, 4, 200, 0))
    assert (message.current_distance, message.signal_quality, message.covariance) == (20_001, 1, 255)


def test_a_range_of_the_least_distance_is_one_in_whole_centimetres() -> None:
    """4.35 m are 434.99999999999994 cm."""
    for least_cm in range(50, 10_001):
        least_m = least_cm / 100
        message = encode.distance_sensor(a_range(least_m, sigma_m=0.01, orientation=0), least_m, 200, 0)
        assert (message.current_distance, message.min_distance) == (least_cm, least_cm)


def sectors(
    distance_m: Any, known_mask: Any, clear: Any, min_m: float = 4.0, max_m: float = 100.0, time_ns: int = 0
) -> ObstacleSectors:
    distance = np.asarray(distance_m, dtype=float)
    flags = (np.asarray(known_mask, dtype=bool), np.asarray(clear, dtype=bool))
    return ObstacleSectors(time_ns, distance, np.ones(len(distance)), *flags, min_m, max_m)


def by_bearing(message: Any) -> list[int]:
    """The distances from straight ahead on, clockwise, wherever the message begins."""
    begins = round(message.angle_offset / message.increment_f)
    return [message.distances[(index - begins) % 72] for index in range(72)]


@settings(deadline=None)
@given(st.lists(st.tuples(st.one_of(ANY, NEAR), st.booleans(), st.booleans()), max_size=6), ANY, ANY, TIMES)
def test_no_sector_lies(rows: list[tuple[float, bool, bool]], min_m: float, max_m: float, time_us: int) -> None:
    rows += [(0.0, False, False)] * (72 - len(rows))
    distance, known_mask, clear = (list(column) for column in zip(*rows, strict=True))
    message = sent(encode.obstacle_distance(sectors(distance, known_mask, clear, min_m, max_m), time_us % 2**63))
    assert all(math.isfinite(number) for number in every_number(message))
    assert len(message.distances) == 72
    for sent_cm, metres, is_known, is_clear in zip(by_bearing(message), distance, known_mask, clear, strict=True):
        if is_clear:
            assert sent_cm == message.max_distance + 1
        elif is_known and math.isfinite(metres) and metres >= 0:
            assert max(message.min_distance, 1) <= sent_cm <= message.max_distance + 1
        else:
            assert sent_cm == 65535


def test_the_circle_is_full_in_body_axes_and_tells_unknown_from_clear() -> None:
    known_mask, clear, distance = [False] * 72, [False] * 72, [0.0] * 72
    known_mask[0], distance[0] = True, 12.34
    known_mask[1], distance[1] = True, 1.0
    known_mask[2], distance[2] = True, 150.0
    clear[3] = True
    message = sent(encode.obstacle_distance(sectors(distance, known_mask, clear), 5))
    assert by_bearing(message)[:5] == [1234, 400, 10_001, 10_001, 65535]
    assert (message.frame, message.increment, message.increment_f) == (12, 5, 5.0)


def old_px4_map_cm(message: Any) -> list[int]:
    """A message as a PX4 of 36 directions reads it: CollisionPrevention::_addObstacleSensorData."""
    return [
        message.distances[math.ceil((10 * k - message.angle_offset) % 360 / message.increment_f)] for k in range(36)
    ]


@pytest.mark.parametrize("sector", range(72))
def test_an_obstacle_in_any_sector_is_seen_by_a_px4_of_ten_degrees(sector: int) -> None:
    known_mask, clear, distance = [False] * 72, [True] * 72, [0.0] * 72
    known_mask[sector], clear[sector], distance[sector] = True, False, 15.0
    record = sectors(distance, known_mask, clear)
    message = sent(encode.obstacle_distance(record, 5, px4=True))
    bearings = [10 * k for k, entry in enumerate(old_px4_map_cm(message)) if entry == 1500]
    assert bearings
    assert all(abs((bearing - 5 * sector + 180) % 360 - 180) <= 5 for bearing in bearings)
    assert by_bearing(message)[sector] == 1500, "and by one that reads all"
    assert by_bearing(sent(encode.obstacle_distance(record, 5))).count(1500) == 1


def ardupilots_faces_m(message: Any) -> list[float | None]:
    """A message as AP_Proximity_MAV::handle_obstacle_distance_msg leaves it: the nearest in each 45 degrees.

    Written after its loop: a face is stored when the next one begins, and stored again if it comes a second time.
    """
    faces: list[float | None] = [None] * 8
    face, nearest = None, None
    for index, entry in enumerate(message.distances):
        if entry in (0, 65535) or not message.min_distance <= entry <= message.max_distance:
            continue
        bearing = (index * message.increment_f + message.angle_offset) % 360.0
        latest = int(((bearing + 22.5) % 360.0) / 45.0)
        if latest != face:
            if face is not None:
                faces[face] = nearest
            face, nearest = latest, None
        nearest = entry * 0.01 if nearest is None else min(nearest, entry * 0.01)
    if face is not None:
        faces[face] = nearest
    return faces


@pytest.mark.slow
@settings(deadline=None)
@given(st.lists(st.one_of(st.none(), st.floats(5.0, 90.0)), min_size=72, max_size=72))
def test_ardupilot_sees_the_nearest_obstacle_in_every_direction(distances: list[float | None]) -> None:
    known_mask = [distance is not None for distance in distances]
    metres = [distance or 0.0 for distance in distances]
    message = sent(encode.obstacle_distance(sectors(metres, known_mask, [False] * 72), 5))
    for face, seen_m in enumerate(ardupilots_faces_m(message)):
        inside = [distances[(9 * face + step) % 72] for step in range(-4, 5)]
        nearest_m = min((distance for distance in inside if distance is not None), default=None)
        assert seen_m == (None if nearest_m is None else pytest.approx(nearest_m, abs=0.006))


@given(st.text(), ANY, TIMES)
def test_a_named_value_is_finite_or_not_sent(name: str, value: float, time_ms: int) -> None:
    message = encode.named_value(name, value, time_ms)
    if message is None:
        assert not abs(value) <= 3.4028234e38
    else:
        received = sent(message)
        assert received.value == np.float32(value)
        assert len(received.name) <= 10


@given(st.integers(-10, 300), st.text(max_size=400), st.integers(0, 10**6))
def test_a_text_arrives_whole_and_ends_with_a_chunk_that_is_not_full(severity: int, text: str, identity: int) -> None:
    pieces = [sent(message) for message in encode.status_text(severity, text, identity)]
    plain = "".join(letter if " " <= letter <= "~" else "?" for letter in text)
    assert "".join(piece.text for piece in pieces).rstrip() == plain[:249].rstrip()
    assert [piece.chunk_seq for piece in pieces] == list(range(len(pieces)))
    assert all(0 <= piece.severity <= 7 for piece in pieces)
    if len(pieces) > 1:
        assert {piece.id for piece in pieces} != {0}
        assert len({piece.id for piece in pieces}) == 1
        assert len(pieces[-1].text) < 50


@pytest.mark.parametrize("health", list(Health))
def test_the_heartbeat_tells_our_health(health: Health) -> None:
    message = sent(encode.heartbeat(health))
    assert (message.type, message.autopilot) == (18, 8)
    names = {Health.BOOT: "BOOT", Health.STANDBY: "STANDBY", Health.ACTIVE: "ACTIVE", Health.CRITICAL: "CRITICAL"}
    assert message.system_status == getattr(mavlink, f"MAV_STATE_{names[health]}")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e39])
def test_the_last_gate_stops_any_message_with_a_bad_number(bad: float) -> None:
    command = mavlink.MAVLink_command_long_message(1, 1, 511, 0, 0, 0, 0, bad, 0, 0, 0)
    points = mavlink.MAVLink_distance_sensor_message(0, 0, 1, 1, 0, 0, 0, 0, quaternion=[0, 0, bad, 0])
    assert not encode.sendable(command)
    assert not encode.sendable(points)
    assert encode.sendable(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 0, 0, 0, 1.5, 0, 0, 0))


def test_a_pair_that_told_nothing_draws_no_graph() -> None:
    """A zero, and a sigma as large as the largest range, would be drawn as values."""
    complete = CorrectedRange(1, 1, 10**9, 25, 42.0, 0.1, 0.0, 1e-4, 40.0, 50, True, None)
    names = {"rng_sig_m": "range_m", "toe_mrad": "toe_sigma_rad", "rigid_m": "rigid_range_m"}
    assert [message.name for message in encode.range_graphs(complete, 7)] == list(names)
    for name, value in names.items():
        drawn = encode.range_graphs(dataclasses.replace(complete, **{value: 0.0}), 7)
        assert [message.name for message in drawn] == [other for other in names if other != name]
