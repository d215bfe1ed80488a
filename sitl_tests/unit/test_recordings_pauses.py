"""Logs whose logger paused for hours: what follows is used; a damaged stamp that leaps as far is not."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.logs.bin import BinRecording
from companion.adapters.recordings.logs.stamps_ahead import ahead_of_neighbours
from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.adapters.recordings.logs.ulog import UlogRecording
from companion.adapters.recordings.recording_factory import open_recording
from companion.evaluation.replay import foreign_inputs
from companion.params.files import load_airframe
from companion.records import (
    AutopilotParameter,
    Axis,
    ClockName,
    ImuBatch,
    Ints,
    Record,
    Rejected,
    Station,
    Tick,
    VehicleState,
)
from sitl_tests.unit import test_recordings_bin as onboard
from sitl_tests.unit import test_recordings_tlog as telemetry
from sitl_tests.unit import test_recordings_ulog as px4

AIRFRAME = load_airframe("sitl-plane")
HOUR_S = 3600
HOUR_NS = HOUR_S * 1_000_000_000
PERIOD_NS = 5_000_000


def batch(t_ns: Ints, arrived_ns: int | None = None) -> ImuBatch:
    """Samples of the root that arrived at the newest of their stamps."""
    newest = int(t_ns.max()) if arrived_ns is None else arrived_ns
    return ImuBatch(Station.ROOT, ClockName.BOOT, t_ns, np.zeros((t_ns.size, 6)), Axis.ALL, newest)


def evenly(start_ns: int, count: int) -> list[ImuBatch]:
    """Batches of four samples."""
    return [batch(start_ns + PERIOD_NS * np.arange(4 * k, 4 * k + 4)) for k in range(count // 4)]


def used(records: Iterable[Record]) -> Ints:
    """Stamps of the samples that a replay is given."""
    return np.concatenate([record.t_ns for record in foreign_inputs(records) if isinstance(record, ImuBatch)])


def refused(records: Iterable[Record]) -> int:
    return sum(record.count for record in foreign_inputs(records) if isinstance(record, Rejected))


@pytest.mark.parametrize("pause_s", [10, HOUR_S, 30 * HOUR_S])
def test_every_sample_behind_a_pause_is_used(pause_s: int) -> None:
    later_ns = 8_000_000_000 + pause_s * 1_000_000_000
    log = [*evenly(5_000_000_000, 400), *evenly(later_ns, 400)]
    assert used(log).tolist() == np.concatenate([entry.t_ns for entry in log]).tolist()
    assert refused(log) == 0
    ticks = [record.now_host_ns for record in foreign_inputs(log) if isinstance(record, Tick)]
    assert ticks == sorted(set(ticks))
    assert len(ticks) < 500 + 100 * min(pause_s, 30), "the pause itself is not flown through"


def test_flight_state_keeps_its_place_behind_a_pause() -> None:
    later_ns = 3 * HOUR_NS
    state = VehicleState(later_ns, later_ns, 0.1, 0.0, 0.0, 15.0, 0.0, 0.5, True)
    log: list[Record] = [*evenly(5_000_000_000, 40), *evenly(later_ns, 4), state, *evenly(later_ns + 20_000_000, 400)]
    replayed = [record for record in foreign_inputs(log) if not isinstance(record, Tick)]
    assert [id(record) for record in replayed] == [id(record) for record in log]


def test_damaged_stamps_are_refused_wherever_they_leap_to() -> None:
    rng = np.random.default_rng(1)
    good = evenly(5_000_000_000, 4000)
    log: list[Record] = []
    for entry in good:
        log.append(entry)
        if rng.random() < 0.3:
            log.append(batch(np.array([int(rng.integers(2 * HOUR_NS, 2**62))])))
    log += [batch(np.full(60, 2**60)), batch(2**61 + HOUR_NS * np.arange(60))]
    assert used(log).tolist() == np.concatenate([entry.t_ns for entry in good]).tolist()
    assert refused(log) == sum(entry.t_ns.size for entry in log if isinstance(entry, ImuBatch)) - 4000


def test_a_damaged_stamp_within_a_batch_costs_itself_alone() -> None:
    log = evenly(5_000_000_000, 400)
    damaged = log[50].t_ns.copy()
    damaged[2] = 2**50
    log[50] = batch(damaged)
    assert used(log).size == 399
    assert refused(log) == 1


def test_a_telemetry_log_is_read_on_behind_a_pause(tmp_path: Path) -> None:
    """Frames that came more than an hour after the frame before were stepped over to the end of the file."""
    first, again = (
        telemetry.flight(2.0),
        telemetry.flight(2.0, 30.0 + 5 * HOUR_S, telemetry.UTC_US + 5 * HOUR_NS // 1000),
    )
    (tmp_path / "a.tlog").write_bytes(first.data + again.data)
    recording = open_recording(tmp_path / "a.tlog", AIRFRAME)
    assert isinstance(recording, TlogRecording)
    assert used(recording.records()).size == 2 * 3 * 200
    gaps = [notice.text for notice in recording.notices]
    assert len([text for text in gaps if "the longest, 17998" in text]) == 3, gaps


def test_a_damaged_receive_time_is_not_followed(tmp_path: Path) -> None:
    data = telemetry.flight(2.0).data
    at = data.index(struct.pack(">Q", telemetry.UTC_US + 1_000_000))
    late = struct.pack(">Q", telemetry.UTC_US + 7 * HOUR_NS // 1000)
    (tmp_path / "a.tlog").write_bytes(data[:at] + late + data[at + 8 :])
    recording = TlogRecording(tmp_path / "a.tlog", AIRFRAME)
    stamps = [stamp_us for stamp_us, _ in recording.frames()]
    assert max(stamps) < telemetry.UTC_US + 2_000_000
    assert len(stamps) == 600
    assert any("are no frames, skipped" in notice.text for notice in recording.notices)


def test_an_onboard_log_is_read_on_behind_a_pause(tmp_path: Path) -> None:
    log = onboard.flight(600)
    for i in range(600):
        t_us = 2 * HOUR_NS // 1000 + 1000 * i
        for imu in range(3):
            log.add("ACC", t_us + 7, imu, t_us, 0.1, 0.2, -9.8)
            log.add("GYR", t_us + 7, imu, t_us, 0.01, 0.02, 0.03)
    (tmp_path / "a.BIN").write_bytes(log.data)
    recording = BinRecording(tmp_path / "a.BIN", AIRFRAME)
    assert used(recording.records()).size == 3 * 1200


def states_and_samples(records: Iterable[Record]) -> tuple[int, int, int]:
    """Number of flight states, of samples, and the latest time that any of them was received at, us."""
    batches = [record for record in records if isinstance(record, ImuBatch | VehicleState | AutopilotParameter)]
    states = sum(isinstance(batch, VehicleState) for batch in batches)
    samples = sum(batch.t_ns.size for batch in batches if isinstance(batch, ImuBatch))
    assert [batch.received_host_ns for batch in batches] == sorted(batch.received_host_ns for batch in batches)
    return states, samples, max(batch.received_host_ns for batch in batches) // 1000


LEAP_US = 3_600_000_000
DAMAGED = [("ACC", 0), ("GYR", 2), ("ATT", 0), ("PARM", 0), ("ACC", -1)]


@pytest.mark.parametrize(("name", "place"), [*DAMAGED, ("", 0)])
def test_a_damaged_stamp_of_a_dataflash_log_costs_one_message(tmp_path: Path, name: str, place: int) -> None:
    log = onboard.Log("PARM", "ACC", "GYR", "ATT", "ARSP")
    for i in range(2000):
        leap_us = LEAP_US if i == (1999 if place < 0 else 500) else 0
        t_us = 1000 + 1000 * i
        if i % 100 == 0:
            log.add("ATT", t_us + leap_us * (name == "ATT"), 1.0, 2.0, 3.0)
            log.add("PARM", t_us + leap_us * (name == "PARM"), b"INS_ACCEL_FILTER", 20.0 + i, 20.0)
        for imu in range(3):
            log.add("GYR", t_us, imu, t_us + leap_us * (name == "GYR" and imu == place), 0.01, 0.02, 0.03)
            log.add("ACC", t_us + leap_us * (name == "ACC" and imu == place % 3), imu, t_us, 0.1, 0.2, -9.8)
    (tmp_path / "a.BIN").write_bytes(log.data)
    recording = BinRecording(tmp_path / "a.BIN", AIRFRAME)
    states, samples, latest_us = states_and_samples(recording.records())
    assert states == 20 - (name == "ATT")
    assert samples == 6000 - (name == "ACC")
    assert latest_us <= 2_001_000
    texts = [notice.text for notice in recording.notices if "1 s ahead" in notice.text]
    assert len(texts) == (name != "")


@pytest.mark.parametrize("column", ["timestamp", "timestamp_sample", "attitude", ""])
def test_a_damaged_stamp_of_a_ulog_costs_one_message(tmp_path: Path, column: str) -> None:
    topics = [(name, imu) for name in ("sensor_accel", "sensor_gyro") for imu in range(3)]
    log = px4.Log(*topics, ("vehicle_attitude", 0))
    for i in range(2000):
        leap_us, t_us = LEAP_US if i == 500 else 0, 5000 + 1000 * i
        if i % 100 == 0:
            log.add("vehicle_attitude", 0, t_us + leap_us * (column == "attitude"), 1.0, 0.0, 0.0, 0.0)
        for name, imu in topics:
            damage = leap_us * (name == "sensor_accel" and imu == 1)
            stamps = t_us + damage * (column == "timestamp"), t_us + damage * (column == "timestamp_sample")
            log.add(name, imu, *stamps, 0.1, 0.2, -9.8)
    (tmp_path / "a.ulg").write_bytes(log.data)
    recording = UlogRecording(tmp_path / "a.ulg", AIRFRAME)
    states, samples, latest_us = states_and_samples(recording.records())
    assert states == 20 - (column == "attitude")
    assert samples == 6000 - column.startswith("timestamp")
    assert latest_us <= 2_005_000
    assert any("1 stamp is more than 1 s ahead" in notice.text for notice in recording.notices) is (column != "")


def test_what_follows_a_long_gap_is_kept_and_many_damaged_stamps_are_not() -> None:
    t_us = np.concatenate([np.arange(0, 10**6, 1000), np.arange(10**9, 10**9 + 10**6, 1000)])
    assert not ahead_of_neighbours(t_us).any()
    rng = np.random.default_rng(3)
    damaged = rng.random(t_us.size) < 0.1
    t_us[damaged] += rng.integers(10**10, 10**12, int(damaged.sum()))
    missed = damaged & ~ahead_of_neighbours(t_us)
    assert not missed.any()
    assert not (ahead_of_neighbours(t_us) & ~damaged).any()
