"""Time across reboots, our own TIMESYNC requests, rare messages, and replay. Frames are written by pymavlink."""

from __future__ import annotations

import math
import random

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import OUTGOING, Decoder
from companion.params.airframe import Source
from companion.records import (
    AutopilotParameter,
    ClockName,
    ClockRestart,
    ImuBatch,
    RawChunk,
    Reject,
    Station,
    TimesyncReply,
    VehicleState,
)
from sitl_tests.unit.test_mavlink_decode import (
    MS,
    S,
    Stream,
    airframe,
    batches,
    highres,
    packed,
    pilot_heartbeat,
    refusals,
)


def request(sent_ns: int) -> bytes:
    return packed(mavlink.MAVLink_timesync_message(0, sent_ns), 191)


def answer(sent_ns: int, remote_ns: int, component: int = 1) -> bytes:
    return packed(mavlink.MAVLink_timesync_message(remote_ns, sent_ns), component)


def test_only_answers_to_our_own_requests_count_once_for_each_sender() -> None:
    stream = Stream()
    stream(packed(pilot_heartbeat()))
    stream(request(777), link=OUTGOING)
    records = stream(
        answer(778, 5 * S),  # somebody else's
        answer(777, 5 * S),
        answer(777, 5 * S + 9),  # the same answer by a longer way
        answer(777, 3 * S, 200),
        answer(777, 4 * S, 158),  # a component that keeps no clock of ours
        request(999),  # a request, though of another
    )
    assert records == [
        TimesyncReply(ClockName.BOOT, 777, 5 * S, stream.now),
        TimesyncReply(ClockName.NODE_LEFT, 777, 3 * S, stream.now),
    ]


def test_a_reboot_is_told_once_and_no_stamp_of_the_other_epoch_passes() -> None:
    stream = Stream(
        airframe(left=Source("SCALED_IMU2", 1, ClockName.BOOT), right=Source("SCALED_IMU3", 1, ClockName.BOOT))
    )

    def three(t_ms: int) -> list[bytes]:
        scaled = (mavlink.MAVLink_scaled_imu2_message, mavlink.MAVLink_scaled_imu3_message)
        return [packed(highres(1000 * t_ms))] + [packed(kind(t_ms, *(9 * [1]))) for kind in scaled]

    for k in range(5):
        assert len(batches(stream(*three(60_000 + k)))) == 3
    after = [record for k in range(10) for record in stream(*three(2_000 + k))]
    restarts = [record for record in after if isinstance(record, ClockRestart)]
    assert [record.clock for record in restarts] == [ClockName.BOOT]
    restart_index = after.index(restarts[0])
    assert not batches(after[:restart_index])
    assert {batch.station for batch in batches(after[restart_index:])} == set(Station)
    assert all(batch.t_ns.max() < 3 * S for batch in batches(after[restart_index:]))


def test_a_reboot_inside_one_chunk_parts_the_batch() -> None:
    stream = Stream()
    old, new = [60_000_000 + 1000 * k for k in range(5)], [2_000_000 + 1000 * k for k in range(6)]
    records = stream(*(packed(highres(t_us), 200) for t_us in old + new))
    before, restart, after, refused = records
    assert isinstance(before, ImuBatch)
    assert isinstance(after, ImuBatch)
    assert before.t_ns.tolist() == [1000 * t_us for t_us in old]
    assert restart == ClockRestart(ClockName.NODE_LEFT, stream.now)
    assert after.t_ns.tolist() == [1000 * t_us for t_us in new[2:]]
    assert refusals([refused]) == {Reject.TIME_BACKWARDS: 2}


def test_one_late_datagram_is_no_reboot() -> None:
    stream = Stream()
    stream(packed(highres(60_000_000), 200))
    late = stream(packed(highres(50_000_000), 200), packed(highres(50_001_000), 200))
    assert refusals(late) == {Reject.TIME_BACKWARDS: 2}
    assert not batches(late)
    (batch,) = batches(stream(packed(highres(60_001_000), 200)))
    assert batch.t_ns.tolist() == [60_001 * MS]


def test_a_timesync_answer_shows_a_reboot_at_once() -> None:
    stream = Stream()
    stream(packed(pilot_heartbeat()))
    for k, remote_ns in enumerate((90 * S, 2 * S)):
        stream(request(k), link=OUTGOING)
        records = stream(answer(k, remote_ns))
    assert records == [ClockRestart(ClockName.BOOT, stream.now), TimesyncReply(ClockName.BOOT, 1, 2 * S, stream.now)]


def test_a_silent_source_joins_the_new_epoch_within_a_second() -> None:
    stream = Stream(airframe(left=Source("SCALED_IMU2", 1, ClockName.BOOT)))
    left = packed(mavlink.MAVLink_scaled_imu2_message(1_000, *(9 * [1])))
    stream(left)  # long before the root's clock steps back, and never behind it
    for t_us in (60_000_000, 1_100_000, 1_101_000, 1_102_000):
        stream(packed(highres(t_us)))
    assert not batches(stream(packed(mavlink.MAVLink_scaled_imu2_message(1_200, *(9 * [1])))))
    assert batches(stream(packed(mavlink.MAVLink_scaled_imu2_message(2_300, *(9 * [1]))), after_ns=S + MS))


def test_a_boot_time_of_32_bits_that_wraps_is_no_reboot() -> None:
    """After 49.7 days SCALED_IMU2 begins anew at 0; RAW_IMU and TIMESYNC have 64 bits."""
    sources = {"root": Source("RAW_IMU", 1, ClockName.BOOT), "left": Source("SCALED_IMU2", 1, ClockName.BOOT)}
    stream, wrap_ms = Stream(airframe(**sources)), 1 << 32
    came: list[ImuBatch] = []
    for t_ms in range(wrap_ms - 3000, wrap_ms + 60_000, 20):
        raw = mavlink.MAVLink_raw_imu_message(1000 * t_ms, *(9 * [1]))
        scaled = mavlink.MAVLink_scaled_imu2_message(t_ms % wrap_ms, *(9 * [1]))
        records = stream(packed(raw), packed(scaled), after_ns=20 * MS)
        came += batches(records)
        assert len(batches(records)) == len(records)
    for station in (Station.ROOT, Station.LEFT):
        t_ns = np.concatenate([batch.t_ns for batch in came if batch.station is station])
        assert np.diff(t_ns).tolist() == [20 * MS] * (len(t_ns) - 1)
    reboot = [packed(mavlink.MAVLink_scaled_imu2_message(5_000 + k, *(9 * [1]))) for k in range(3)]
    assert ClockRestart(ClockName.BOOT, stream.now + MS) in stream(*reboot), "a minute after the wrap"


def test_flight_state_and_parameters_come_from_the_autopilot_alone() -> None:
    stream = Stream()
    attitude = mavlink.MAVLink_attitude_message(4000, 0.1, -0.2, 0.3, 0, 0, 0)
    air = mavlink.MAVLink_vfr_hud_message(17.5, 18, 90, 55, 120, -1.5)
    loop = mavlink.MAVLink_param_value_message(b"SCHED_LOOP_RATE", 400.0, 9, 1, 5)
    other = mavlink.MAVLink_param_value_message(b"ARSPD_TYPE", 1.0, 9, 1, 5)
    sick = mavlink.MAVLink_param_value_message(b"INS_ACC_ID", math.nan, 9, 1, 5)  # nobody uses it
    records = stream(*map(packed, (pilot_heartbeat(armed=True), air, attitude, loop, other, sick)), packed(loop, 200))
    state, parameter = records
    assert isinstance(state, VehicleState)
    assert (state.t_boot_ns, state.armed, state.throttle) == (4 * S, True, 0.55)
    np.testing.assert_allclose([state.roll_rad, state.pitch_rad, state.yaw_rad], [0.1, -0.2, 0.3], rtol=1e-6)
    assert (state.airspeed_mps, state.climb_mps) == (17.5, -1.5)
    assert parameter == AutopilotParameter("SCHED_LOOP_RATE", 400.0, stream.now)


def test_flight_state_is_thinned_to_fifty_a_second() -> None:
    stream = Stream()
    stream(packed(pilot_heartbeat()), packed(mavlink.MAVLink_vfr_hud_message(17, 18, 90, 55, 120, 0)))
    frames = [packed(mavlink.MAVLink_attitude_message(3 * k, 0, 0, 0, 0, 0, 0)) for k in range(334)]
    states = [record for record in stream(*frames) if isinstance(record, VehicleState)]
    assert 45 <= len(states) <= 50


def test_our_own_frames_that_come_back_are_not_heard() -> None:
    stream = Stream()
    stream(packed(pilot_heartbeat()))
    chunk = RawChunk(0, stream.now, packed(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), 191))
    assert not stream.decoder.decode(chunk).heard
    assert stream.decoder.echoes == 1


def test_replaying_the_chunks_gives_the_same_records() -> None:
    rng = random.Random(1)
    chunks = []
    for k in range(200):
        t_us = 1_000_000 + 1000 * k if k < 150 else 1000 * k - 150_000
        frames = [packed(highres(t_us), component) for component in (1, 200, 201, 158)]
        frames += [packed(pilot_heartbeat()), answer(k - 1, t_us * 1000), rng.randbytes(20)]
        chunks += [RawChunk(OUTGOING, k * 5 * MS, request(k)), RawChunk(0, k * 5 * MS + MS, b"".join(frames))]
    runs = []
    for _ in range(2):
        decoder = Decoder(airframe(), 191)
        runs.append([repr(record) for chunk in chunks for record in decoder.decode_chunk(chunk)])
    assert runs[0] == runs[1]
    assert any("ClockRestart" in record for record in runs[0])
    assert any("TimesyncReply" in record for record in runs[0])
