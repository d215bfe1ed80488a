"""Wire messages to records: units, axes, instances, time, refusals. Frames are written by pymavlink."""

from __future__ import annotations

import dataclasses
import math
import random
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.decode.layouts import TUNNEL_IMU_TYPE
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Source
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, RawChunk, Record, Reject, Rejected, Station, VehicleState

G = 9.80665
MS, S = 1_000_000, 1_000_000_000


def airframe(**sources: Source) -> Airframe:
    base = load_airframe("nadir-2m")
    stations = {place: dataclasses.replace(getattr(base, place), source=source) for place, source in sources.items()}
    return dataclasses.replace(base, **stations)


def packed(message: Any, component: int = 1, system: int = 1) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, system, component)))


def highres(
    t_us: int, values: tuple[float, ...] = (0.1, 0.2, -G, 0.3, 0.4, 0.5), fields: int = 63, number: int = 0
) -> Any:
    return mavlink.MAVLink_highres_imu_message(t_us, *values, 0, 0, 0, 0, 0, 0, 20, fields, number)


def pilot_heartbeat(armed: bool = False) -> Any:
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, 4, 3)


class Stream:
    """A decoder and the host time of its chunks."""

    def __init__(self, frame: Airframe | None = None) -> None:
        self.decoder = Decoder(frame or airframe(), component_id=191)
        self.now = 10 * S

    def __call__(self, *frames: bytes, link: int = 0, after_ns: int = MS) -> list[Record]:
        self.now += after_ns
        return self.decoder.decode_chunk(RawChunk(link, self.now, b"".join(frames)))


def batches(records: list[Record]) -> list[ImuBatch]:
    return [record for record in records if isinstance(record, ImuBatch)]


def refusals(records: list[Record]) -> dict[Reject, int]:
    return {record.reason: record.count for record in records if isinstance(record, Rejected)}


def _standing(stream: Stream, *frames: bytes, t_ms: int) -> bool | None:
    """The next vehicle state's word on the ground after these messages."""
    air = mavlink.MAVLink_vfr_hud_message(0.0, 0.0, 0, 0, 0.0, 0.0)
    attitude = mavlink.MAVLink_attitude_message(t_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    states = [r for r in stream(*frames, packed(air), packed(attitude)) if isinstance(r, VehicleState)]
    return states[-1].on_ground


def test_the_ground_is_known_by_landed_state_or_by_the_heartbeats_standby() -> None:
    """ArduPlane's heartbeat is in standby (3) until it flies; MAV_LANDED_STATE: 0 undefined, 1 ground, 2 air."""
    stream, armed = Stream(), mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    beats = {
        state: packed(mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, armed, 0, state, 3))
        for state in (mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_ACTIVE, mavlink.MAV_STATE_CRITICAL)
    }
    landed = [packed(mavlink.MAVLink_extended_sys_state_message(0, state)) for state in range(5)]
    assert _standing(stream, beats[mavlink.MAV_STATE_STANDBY], t_ms=1000) is True
    assert _standing(stream, beats[mavlink.MAV_STATE_CRITICAL], t_ms=2000) is True, "a failsafe tells nothing of it"
    assert _standing(stream, beats[mavlink.MAV_STATE_ACTIVE], t_ms=3000) is False
    assert _standing(stream, landed[0], t_ms=4000) is False
    assert _standing(stream, landed[1], t_ms=5000) is True, "the landed state is closer to it than the heartbeat"
    assert _standing(stream, landed[3], t_ms=6000) is False
    critical = Stream()
    assert _standing(critical, beats[mavlink.MAV_STATE_CRITICAL], t_ms=1000) is None


def test_highres_imu_becomes_one_batch_for_each_station() -> None:
    stream = Stream()
    frames = [packed(highres(1000 * k), component) for k in range(4) for component in (201, 1, 200)]
    imu_batches = batches(stream(*frames))
    assert [batch.station for batch in imu_batches] == [Station.ROOT, Station.LEFT, Station.RIGHT]
    assert [batch.clock for batch in imu_batches] == [ClockName.BOOT, ClockName.NODE_LEFT, ClockName.NODE_RIGHT]
    for batch in imu_batches:
        assert batch.t_ns.tolist() == [0, MS, 2 * MS, 3 * MS]
        assert batch.axes == Axis.ALL
        np.testing.assert_allclose(batch.values, np.tile([0.1, 0.2, -G, 0.3, 0.4, 0.5], (4, 1)), rtol=1e-6)
        assert batch.received_host_ns == stream.now


@pytest.mark.parametrize("name", ["RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"])
def test_integer_messages_are_milli_g_and_milliradians(name: str) -> None:
    counts = (1000, -500, 250, 1000, -2000, 32767)
    if name == "RAW_IMU":
        message = mavlink.MAVLink_raw_imu_message(5_000_000, *counts, 1, 2, 3)
    else:
        message = getattr(mavlink, f"MAVLink_{name.lower()}_message")(5000, *counts, 1, 2, 3)
    stream = Stream(airframe(root=Source(name, 1, ClockName.BOOT, stamp_offset_s=0.0005)))
    (batch,) = batches(stream(packed(message)))
    assert batch.t_ns.tolist() == [5_000_500_000]
    np.testing.assert_allclose(batch.values[0], [G, -G / 2, G / 4, 1.0, -2.0, 32.767], rtol=1e-12)


def test_axes_and_signs_turn_acceleration_and_rate_alike() -> None:
    stream = Stream(airframe(left=Source("HIGHRES_IMU", 200, ClockName.NODE_LEFT, axes=("y", "-x", "z"))))
    (batch,) = batches(stream(packed(highres(1, (1, 2, 3, 4, 5, 6)), 200)))
    np.testing.assert_array_equal(batch.values[0], [2, -1, 3, 5, -4, 6])


def test_fields_updated_names_the_axes_in_body_directions() -> None:
    stream = Stream(airframe(left=Source("HIGHRES_IMU", 200, ClockName.NODE_LEFT, axes=("y", "-x", "z"))))
    sensor_x_and_gyro_z = 1 | 32
    frames = [packed(highres(k, (1, 2, 3, 4, 5, 6), sensor_x_and_gyro_z if k > 1 else 63), 200) for k in range(4)]
    all_axes, two_axes = batches(stream(*frames))
    assert (len(all_axes.t_ns), all_axes.axes) == (2, Axis.ALL)
    assert two_axes.axes == Axis.Y | Axis.R
    np.testing.assert_array_equal(two_axes.values, [[0, -1, 0, 0, 0, 6]] * 2)
    nothing = stream(packed(highres(10, fields=0), 200))
    assert not batches(nothing)
    assert refusals(nothing) == {Reject.STALE: 1}


def test_axes_that_the_sensor_does_not_send_are_zero_and_not_judged() -> None:
    base = airframe()
    frame = dataclasses.replace(base, left=dataclasses.replace(base.left, sends="z"))
    (batch,) = batches(Stream(frame)(packed(highres(1, (math.nan, 1, -G, math.inf, 1, 1)), 200)))
    assert batch.axes == Axis.Z
    np.testing.assert_allclose(batch.values, [[0, 0, -G, 0, 0, 0]], rtol=1e-6)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_refused_and_its_neighbours_are_kept(bad: float) -> None:
    stream = Stream()
    records = stream(*(packed(highres(k, (0, 0, bad if k == 2 else -G, 0, 0, 0)), 200) for k in range(1, 5)))
    (batch,) = batches(records)
    assert batch.t_ns.tolist() == [1000, 3000, 4000]
    assert refusals(records) == {Reject.NOT_FINITE: 1}


def test_a_stamp_beyond_any_clock_is_refused() -> None:
    stream = Stream()
    records = stream(packed(highres(2**64 - 1), 200), packed(highres(5), 200))
    (batch,) = batches(records)
    assert batch.t_ns.tolist() == [5000]
    assert refusals(records) == {Reject.INCONSISTENT: 1}


def test_a_component_that_is_not_mapped_is_ignored_and_counted() -> None:
    stream = Stream()
    records = stream(packed(highres(1), 158), packed(highres(2), 158))
    assert not batches(records)
    assert records == [Rejected(Reject.FOREIGN_SOURCE, "HIGHRES_IMU of 1/158", stream.now, 2)]
    assert not stream(packed(highres(3), 158))  # reported once a second at most
    (later,) = stream(packed(highres(4), 158), after_ns=S)
    assert isinstance(later, Rejected)
    assert later.count == 2
    assert not stream(packed(mavlink.MAVLink_raw_imu_message(1, *(9 * [1])), 158), after_ns=S)


def test_another_vehicle_is_foreign_once_ours_is_known() -> None:
    stream = Stream()
    stream(packed(pilot_heartbeat(), 1, 7))
    assert stream.decoder.system_id == 7
    assert refusals(stream(packed(highres(1), 200, 1))) == {Reject.FOREIGN_SOURCE: 1}
    assert len(batches(stream(packed(highres(1), 200, 7)))) == 1


def test_another_vehicle_is_foreign_from_the_start_where_ours_is_configured() -> None:
    stream = Stream()
    stream.decoder = Decoder(airframe(), component_id=191, system=7)
    assert refusals(stream(packed(pilot_heartbeat(), 1, 1), packed(highres(1), 200, 1))) == {Reject.FOREIGN_SOURCE: 1}
    assert len(batches(stream(packed(highres(1), 200, 7)))) == 1


def test_ground_stations_and_companions_are_not_the_autopilot() -> None:
    stream = Stream()
    station = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
    companion = mavlink.MAVLink_heartbeat_message(18, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    stream(packed(station, 1, 255), packed(companion, 1, 9), packed(pilot_heartbeat(), 50, 8))
    assert stream.decoder.system_id is None


def test_instances_tell_equal_messages_apart() -> None:
    frame = airframe(
        left=Source("HIGHRES_IMU", 200, ClockName.NODE_LEFT, instance="1"),
        right=Source("HIGHRES_IMU", 200, ClockName.NODE_LEFT, instance="2"),
    )
    imu_batches = batches(Stream(frame)(*(packed(highres(10 + k, number=k % 3), 200) for k in range(9))))
    assert [(batch.station, batch.t_ns.tolist()) for batch in imu_batches] == [
        (Station.LEFT, [11_000, 14_000, 17_000]),
        (Station.RIGHT, [12_000, 15_000, 18_000]),
    ]


def float_array(name: bytes, t_us: int, period_us: int, samples: np.ndarray[Any, Any]) -> bytes:
    data = [float(len(samples)), *samples.ravel().tolist()]
    message = mavlink.MAVLink_debug_float_array_message(t_us, name, period_us, data + [0.0] * (58 - len(data)))
    return packed(message, 200)


def tunnel(
    t_us: int, period_us: int, counts: np.ndarray[Any, Any], scales: tuple[float, float], number: int = 0
) -> bytes:
    payload = struct.pack("<QHBBff", t_us, period_us, len(counts), number, *scales) + counts.astype("<i2").tobytes()
    fields = list(payload.ljust(128, b"\0"))
    return packed(mavlink.MAVLink_tunnel_message(1, 191, TUNNEL_IMU_TYPE, len(payload), fields), 200)


@pytest.mark.parametrize("count", [1, 4, 9])
def test_float_array_batches_are_laid_out_in_time(count: int) -> None:
    samples = np.random.default_rng(count).normal(size=(count, 6)).astype(np.float32)
    stream = Stream(airframe(left=Source("DEBUG_FLOAT_ARRAY", 200, ClockName.NODE_LEFT, instance="tip")))
    records = stream(
        float_array(b"tip", 5000, 1000, samples),
        float_array(b"other", 0, 1000, samples),
        float_array(b"tip", 5000 + 1000 * count, 1000, samples),
    )
    (batch,) = batches(records)
    assert batch.t_ns.tolist() == [5 * MS + k * MS for k in range(2 * count)]
    np.testing.assert_array_equal(batch.values, np.concatenate([samples, samples]).astype(float))


@pytest.mark.parametrize("count", [0.0, 10.0, 2.5, math.nan, math.inf, -1.0])
def test_float_arrays_of_an_unknown_size_are_refused(count: float) -> None:
    stream = Stream(airframe(left=Source("DEBUG_FLOAT_ARRAY", 200, ClockName.NODE_LEFT, instance="tip")))
    message = mavlink.MAVLink_debug_float_array_message(5000, b"tip", 1000, [count] + 57 * [1.0])
    records = stream(packed(message, 200))
    assert not batches(records)
    assert refusals(records) == {Reject.INCONSISTENT: 1}


def test_tunnel_batches_carry_their_scales() -> None:
    counts = np.random.default_rng(0).integers(-32768, 32767, size=(9, 6))
    stream = Stream(airframe(left=Source("TUNNEL", 200, ClockName.NODE_LEFT)))
    other = packed(mavlink.MAVLink_tunnel_message(1, 191, 40_000, 4, [1] * 128), 200)
    (batch,) = batches(stream(other, tunnel(7000, 500, counts, (0.005, 0.001)), tunnel(1, 1, counts, (1, 1), number=3)))
    assert batch.t_ns.tolist() == [7 * MS + k * MS // 2 for k in range(9)]
    np.testing.assert_allclose(batch.values, counts * ([0.005] * 3 + [0.001] * 3), rtol=1e-6)


@pytest.mark.parametrize("scale", [math.nan, math.inf])
def test_a_tunnel_scale_that_is_not_finite_is_refused(scale: float) -> None:
    stream = Stream(airframe(left=Source("TUNNEL", 200, ClockName.NODE_LEFT)))
    records = stream(tunnel(7000, 500, np.zeros((2, 6)), (scale, 1.0)))
    assert not batches(records)
    assert refusals(records) == {Reject.NOT_FINITE: 2}


def test_debug_vect_is_one_accelerometer() -> None:
    stream = Stream(airframe(left=Source("DEBUG_VECT", 200, ClockName.NODE_LEFT, instance="tip")))
    frames = [packed(mavlink.MAVLink_debug_vect_message(name, 9, 1, 2, 3), 200) for name in (b"tip", b"mag")]
    (batch,) = batches(stream(*frames))
    assert batch.axes == Axis.ACCEL
    assert batch.t_ns.tolist() == [9000]
    np.testing.assert_array_equal(batch.values, [[1, 2, 3, 0, 0, 0]])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 60))
def test_the_samples_do_not_depend_on_where_the_chunks_were_cut(seed: int, pieces: int) -> None:
    rng = random.Random(seed)
    data = b"".join(
        packed(highres(1000 * k, tuple(rng.uniform(-50, 50) for _ in range(6))), component)
        for k in range(20)
        for component in (1, 200, 201)
    )
    borders = sorted(rng.randint(0, len(data)) for _ in range(pieces))
    uncut, cut = Stream(), Stream()
    expected = batches(uncut(data))
    parts = [record for a, b in zip([0, *borders], [*borders, len(data)], strict=True) for record in cut(data[a:b])]
    for batch in expected:
        station_batches = [piece for piece in batches(parts) if piece.station == batch.station]
        np.testing.assert_array_equal(np.concatenate([piece.t_ns for piece in station_batches]), batch.t_ns)
        np.testing.assert_array_equal(np.concatenate([piece.values for piece in station_batches]), batch.values)


@pytest.mark.parametrize(
    ("source", "says"),
    [
        (Source("HIGHRES_IMU", 201, ClockName.NODE_RIGHT), "same source as left"),
        (Source("HIGHRES_IMU", 201, ClockName.NODE_RIGHT, instance="0"), "same source as left"),
        (Source("VIBRATION", 201, ClockName.NODE_RIGHT), "not an inertial message"),
        (Source("DEBUG_VECT", 201, ClockName.NODE_RIGHT), "needs 'instance'"),
        (Source("RAW_IMU", 201, ClockName.NODE_LEFT), "two clocks"),
        (Source("RAW_IMU", 202, ClockName.NODE_LEFT, axes=("x", "x", "z")), "each of x, y, z once"),
        (Source("RAW_IMU", 202, ClockName.NODE_LEFT, axes=("x", "up", "z")), "must be x, y or z"),
        (Source("RAW_IMU", 202, ClockName.NODE_LEFT, axes=("x", "y", "-z")), "mirror"),
    ],
)
def test_a_wrong_mapping_is_named(source: Source, says: str) -> None:
    left = Source("HIGHRES_IMU", 201, ClockName.NODE_RIGHT)
    with pytest.raises(ConfigError, match=r"nadir-2m.*right") as caught:
        Decoder(airframe(left=left, right=source), 191)
    assert says in str(caught.value)
