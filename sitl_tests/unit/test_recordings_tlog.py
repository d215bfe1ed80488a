"""Telemetry logs: one clock, resynchronisation after damage, restarts, and what a truncated file still gives."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.adapters.recordings.recording_factory import open_recording
from companion.errors import RecordingError
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Station, VehicleState

AIRFRAME = load_airframe("sitl-plane")
UTC_US = 1_795_255_071_000_000
G = 9.80665


class Logger:
    """Writes frames as a ground station does."""

    def __init__(self) -> None:
        self.data = b""
        self._senders: dict[int, Any] = {}

    def add(self, utc_us: int, component: int, message: Any) -> None:
        sender = self._senders.setdefault(component, mavlink.MAVLink(None, srcSystem=1, srcComponent=component))
        self.data += struct.pack(">Q", utc_us) + message.pack(sender)

    def heartbeat(self, utc_us: int) -> None:
        self.add(utc_us, 1, mavlink.MAVLink_heartbeat_message(1, 3, 128, 0, 4, 3))

    def imus(self, utc_us: int, boot_us: int, z_mg: int) -> None:
        rest = (0, 0, 0, 0, 0, 0)
        self.add(utc_us, 1, mavlink.MAVLink_raw_imu_message(boot_us, 0, 0, z_mg, *rest))
        for kind in (mavlink.MAVLink_scaled_imu2_message, mavlink.MAVLink_scaled_imu3_message):
            self.add(utc_us, 1, kind(boot_us // 1000, 0, 0, z_mg, *rest))


def flight(seconds: float = 2.0, boot_s: float = 30.0, utc_us: int = UTC_US) -> Logger:
    """Three IMUs at 100 Hz whose z counts milligravities upward from -1000."""
    logger = Logger()
    logger.heartbeat(utc_us)
    for i in range(int(seconds * 100)):
        logger.imus(utc_us + i * 10_000, int(boot_s * 1e6) + i * 10_000 + 250, -1000 + i)
    return logger


def opened(tmp_path: Path, data: bytes) -> TlogRecording:
    (tmp_path / "a.tlog").write_bytes(data)
    recording = open_recording(tmp_path / "a.tlog", AIRFRAME)
    assert isinstance(recording, TlogRecording)
    return recording


def samples(recording: TlogRecording, station: Station) -> tuple[np.ndarray, np.ndarray]:
    batches = [entry for entry in recording.records() if isinstance(entry, ImuBatch) and entry.station is station]
    return np.concatenate([b.t_ns for b in batches]), np.concatenate([b.values for b in batches])


def test_samples_come_in_si_on_the_boot_clock_with_truncated_stamps_at_their_mean(tmp_path: Path) -> None:
    recording = opened(tmp_path, flight().data)
    boot_ns = 30_000_000_000 + np.arange(200) * 10_000_000
    expected_z = (-1000 + np.arange(200)) * G / 1000
    for station, late_ns in ((Station.ROOT, 250_000), (Station.LEFT, 500_000), (Station.RIGHT, 500_000)):
        t_ns, values = samples(recording, station)
        assert t_ns.tolist() == (boot_ns + late_ns).tolist()
        np.testing.assert_allclose(values[:, 2], expected_z, rtol=1e-12)
    assert recording.hub is ClockName.BOOT
    assert not recording.replayable
    assert recording.airframe == AIRFRAME


def test_arrival_is_the_newest_stamp_so_a_stepping_ground_clock_changes_nothing(tmp_path: Path) -> None:
    smooth = list(opened(tmp_path, flight().data).records())
    stepped = Logger()
    stepped.heartbeat(UTC_US)
    for i in range(200):
        utc_us = UTC_US + i * 10_000 + (1_000_000 if i > 100 else 0)
        stepped.imus(utc_us, 30_000_000 + i * 10_000 + 250, -1000 + i)
    after = list(opened(tmp_path, stepped.data).records())
    for records in (smooth, after):
        arrivals = [entry.received_host_ns for entry in records if isinstance(entry, ImuBatch)]
        assert arrivals == sorted(arrivals)
        assert all(entry.t_ns.max() <= entry.received_host_ns for entry in records if isinstance(entry, ImuBatch))
        assert arrivals[-1] == 30_000_000_000 + 199 * 10_000_000 + 500_000


def test_flight_state_is_in_the_same_clock(tmp_path: Path) -> None:
    logger = flight(1.0)
    logger.add(UTC_US + 10**6, 1, mavlink.MAVLink_vfr_hud_message(21.5, 22.0, 90, 50, 100.0, 1.5))
    logger.add(UTC_US + 10**6, 1, mavlink.MAVLink_attitude_message(30_990, 0.1, -0.2, 3.0, 0, 0, 0))
    (state,) = [entry for entry in opened(tmp_path, logger.data).records() if isinstance(entry, VehicleState)]
    assert (state.airspeed_mps, state.climb_mps, state.throttle, state.armed) == (21.5, 1.5, 0.5, True)
    assert state.t_boot_ns == 30_990_000_000
    assert state.received_host_ns == 30_990_500_000
    assert state.pitch_rad == pytest.approx(-0.2)


def test_other_senders_inertial_messages_are_not_taken(tmp_path: Path) -> None:
    logger = flight(1.0)
    for i in range(50):
        message = mavlink.MAVLink_raw_imu_message(30_000_000 + i, 0, 0, 5000, 0, 0, 0, 0, 0, 0)
        logger.add(UTC_US + 10**6, 158, message)
    _, values = samples(opened(tmp_path, logger.data), Station.ROOT)
    assert len(values) == 100
    assert values[:, 2].max() < 0


def test_a_truncated_file_gives_all_whole_frames_and_says_so(tmp_path: Path) -> None:
    data = flight().data
    recording = opened(tmp_path, data[:-7])
    assert len(samples(recording, Station.RIGHT)[0]) == 199
    assert len(samples(recording, Station.LEFT)[0]) == 200
    assert [text for notice in recording.notices if "truncated" in (text := notice.text)]


@pytest.mark.parametrize("junk", [b"", bytes(range(256)) * 3, b"\xfd" * 300, b"\0" * 9])
def test_damage_in_the_middle_costs_the_damaged_frames_only(tmp_path: Path, junk: bytes) -> None:
    tlog = flight().data
    starts = list(record_starts(tlog))
    struck = starts[300]
    damaged = tlog[: struck + 4] + junk + tlog[starts[302] :]  # two frames are gone, four bytes of stamp remain
    recording = opened(tmp_path, damaged)
    counts = [len(samples(recording, station)[0]) for station in Station]
    assert sum(counts) == 600 - 2
    assert [text for notice in recording.notices if "skipped" in (text := notice.text)]


def record_starts(data: bytes) -> Iterator[int]:
    at = 0
    while at < len(data):
        yield at
        at += 8 + 12 + data[at + 9]


def test_a_restart_of_the_autopilot_goes_on_in_one_time(tmp_path: Path) -> None:
    before = flight(2.0)
    after = flight(2.0, boot_s=3.0, utc_us=UTC_US + 10_000_000)
    recording = opened(tmp_path, before.data + after.data)
    t_ns, values = samples(recording, Station.ROOT)
    assert (np.diff(t_ns) > 0).all()
    silence_ns = int(np.diff(t_ns).max())
    assert silence_ns == pytest.approx(8e9, abs=0.1e9)
    assert len(t_ns) >= 396, "a few samples confirm the restart"
    assert values[-1, 2] == pytest.approx((-1000 + 199) * G / 1000)
    assert any("restarted" in notice.text for notice in recording.notices)


def test_a_station_without_samples_is_named_with_what_is_there(tmp_path: Path) -> None:
    logger = Logger()
    logger.heartbeat(UTC_US)
    for i in range(10):
        logger.add(UTC_US + i * 10_000, 1, mavlink.MAVLink_raw_imu_message(i * 10_000, 0, 0, -1000, 0, 0, 0, 0, 0, 0))
    recording = opened(tmp_path, logger.data)
    assert {entry.station for entry in recording.records() if isinstance(entry, ImuBatch)} == {Station.ROOT}
    notice_texts = [notice.text for notice in recording.notices if "no samples" in notice.text]
    assert len(notice_texts) == 2
    assert all("RAW_IMU of 1" in text for text in notice_texts)


def test_reading_twice_gives_the_same(tmp_path: Path) -> None:
    recording = opened(tmp_path, flight().data)
    first, notices = [repr(entry) for entry in recording.records()], list(recording.notices)
    assert [repr(entry) for entry in recording.records()] == first
    assert recording.notices == notices


def test_only_sent_axes_are_there(tmp_path: Path) -> None:
    batch = next(entry for entry in opened(tmp_path, flight().data).records() if isinstance(entry, ImuBatch))
    assert batch.axes == Axis.Z
    assert not batch.values[:, [0, 1, 3, 4, 5]].any()


def test_what_is_no_tlog_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "empty.tlog").write_bytes(b"")
    (tmp_path / "noise.tlog").write_bytes(np.random.default_rng(1).bytes(5000))
    (tmp_path / "notes.txt").write_text("this is no recording at all")
    for name, words in (("empty.tlog", "is empty"), ("noise.tlog", "no MAVLink frame")):
        with pytest.raises(RecordingError, match=rf"{name}: {words}"):
            open_recording(tmp_path / name, AIRFRAME)
    with pytest.raises(RecordingError, match=r"notes\.txt: not a recording that can be read; known are \.mcap"):
        open_recording(tmp_path / "notes.txt", AIRFRAME)
    (tmp_path / "a.tlog").write_bytes(flight(0.1).data)
    with pytest.raises(RecordingError, match=r"left and right sensor on another clock.* Give the \.mcap"):
        open_recording(tmp_path / "a.tlog", load_airframe("nadir-2m"))
    with pytest.raises(RecordingError, match="give its airframe"):
        open_recording(tmp_path / "a.tlog")


def test_what_is_no_tlog_is_called_so_before_the_airframe_is_looked_at(tmp_path: Path) -> None:
    """The demo's airframe has nodes with clocks of their own, which no tlog could hold."""
    path = tmp_path / "rubbish.tlog"
    path.write_bytes(np.random.default_rng(1).bytes(20_000))
    with pytest.raises(RecordingError, match="not a tlog"):
        TlogRecording(path, load_airframe("nadir-2m"))
