"""The readers on real logs: against pymavlink's own readers, against each other, and against what the logs' notes say.

The data lie in ``$SPANWISE_DATA`` or in ``shared`` beside the repository.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader, mavutil
from pyulog import ULog

from companion.adapters.recordings.logs.bin import BinRecording
from companion.adapters.recordings.logs.dataflash import DataflashLog
from companion.adapters.recordings.logs.ulog_messages import UlogMessages
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.recordings.recording_factory import open_recording
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, ImuBatch, Station
from sitl_tests.replay.raw_accelerometer import raw_accelerometer
from sitl_tests.unit.recordings_help import assert_equal

DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))
RECORDINGS = DATA / "recordings"
ULOGS = DATA / "measured" / "px4-ulog"
AIRFRAME = load_airframe("sitl-plane")

needs_recordings = pytest.mark.skipif(not RECORDINGS.is_dir(), reason=f"no recorded flights in {RECORDINGS}")
needs_ulogs = pytest.mark.skipif(not ULOGS.is_dir(), reason=f"no PX4 logs in {ULOGS}")


def samples(path: Path, station: Station) -> tuple[np.ndarray, np.ndarray]:
    records = open_recording(path, AIRFRAME).records()
    batches = [entry for entry in records if isinstance(entry, ImuBatch) and entry.station is station]
    return np.concatenate([b.t_ns for b in batches]), np.concatenate([b.values for b in batches])


@needs_recordings
@pytest.mark.slow
def test_a_tlog_holds_what_pymavlink_finds_in_it() -> None:
    path = RECORDINGS / "ground.tlog"
    log = mavutil.mavlink_connection(str(path))
    theirs: list[tuple[int, int]] = []
    while message := log.recv_match(type="SCALED_IMU2"):
        if message.get_srcComponent() == 1:
            theirs.append((message.time_boot_ms, message.zacc))
    log.close()
    t_ns, values = samples(path, Station.LEFT)
    expected = np.array(theirs)
    assert ((t_ns - 500_000) // 1_000_000).tolist() == expected[:, 0].tolist()
    np.testing.assert_allclose(values[:, 2], expected[:, 1] * 9.80665e-3, rtol=1e-12)


@needs_recordings
@pytest.mark.slow
def test_an_onboard_log_holds_what_pymavlink_finds_in_it(tmp_path: Path) -> None:
    start = tmp_path / "start.BIN"
    with (RECORDINGS / "flight.BIN").open("rb") as file:
        start.write_bytes(file.read(1_500_000))
    log, theirs = DFReader.DFReader_binary(str(start)), []
    while message := log.recv_match(type="ACC"):
        theirs.append((message.I, message.SampleUS, message.AccX, message.AccY, message.AccZ))
    accelerations = DataflashLog(start).take("ACC")
    assert len(accelerations["I"]) == len(theirs) > 5000
    columns = [accelerations[name].astype(float) for name in ("I", "SampleUS", "AccX", "AccY", "AccZ")]
    assert np.array_equal(np.column_stack(columns), np.array(theirs))


@needs_recordings
@pytest.mark.slow
def test_the_tips_lag_their_raw_accelerometers_by_the_autopilots_filter() -> None:
    """INS_ACCEL_FILTER = 20 Hz, 2nd-order Butterworth: 11.71 ms at 7.3 Hz. The recording's notes say 11.55 ms for
    SCALED_IMU2 with its stamps as they are, cut to whole milliseconds; here they are 0.5 ms later."""
    log = DataflashLog(RECORDINGS / "flight.BIN")
    for station, frequency_hz in ((Station.LEFT, 7.307), (Station.RIGHT, 7.2975)):
        t_ns, values = samples(RECORDINGS / "flight.tlog", station)
        raw_ns, raw = raw_accelerometer(log, int(station))
        lags_ms = []
        for start_s in np.arange(60.0, 140.0, 4.0):
            phases = [
                _phase(t * 1e-9, z, start_s, frequency_hz) for t, z in ((t_ns, values[:, 2]), (raw_ns, raw[:, 2]))
            ]
            lag_rad = np.angle(np.exp(1j * (phases[1] - phases[0])))
            lags_ms.append(1e3 * lag_rad / (2 * np.pi * frequency_hz))
        lag_ms = float(np.median(lags_ms))
        assert lag_ms == pytest.approx(11.71, abs=0.4)
        if station is Station.LEFT:
            assert lag_ms - 0.5 == pytest.approx(11.55, abs=0.05)


def _phase(t_s: np.ndarray, z: np.ndarray, start_s: float, frequency_hz: float) -> float:
    """Phase of the sine in four seconds from ``start_s``, by least squares beside a straight line."""
    chosen = (t_s >= start_s) & (t_s < start_s + 4)
    angle, ones = 2 * np.pi * frequency_hz * t_s[chosen], np.ones(int(chosen.sum()))
    basis = np.column_stack([np.cos(angle), np.sin(angle), ones, t_s[chosen] - start_s])
    cosine, sine, *_ = np.linalg.lstsq(basis, z[chosen], rcond=None)[0]
    return float(np.arctan2(-sine, cosine))


@pytest.mark.slow
@needs_recordings
def test_a_converted_flight_is_the_same_flight(tmp_path: Path) -> None:
    source = open_recording(RECORDINGS / "flight_clean.tlog", AIRFRAME)
    records = list(source.records())
    writer = McapWriter(tmp_path / "converted.mcap", About.of(AIRFRAME, Settings(), source.hub))
    for record in records:
        writer.write(record)
    writer.close()
    copy = McapRecording(tmp_path / "converted.mcap")
    assert copy.hub is ClockName.BOOT
    back = list(copy.records())
    assert len(back) == len(records)
    for before, after in zip(records, back, strict=True):
        assert_equal(before, after)


@needs_recordings
def test_the_onboard_log_gives_all_three_imus_at_their_rates() -> None:
    recording = open_recording(RECORDINGS / "flight.BIN", AIRFRAME)
    assert isinstance(recording, BinRecording)
    rates = [recording.airframe.sensor(station).rate_hz for station in Station]
    assert rates == pytest.approx([1000.0, 800.0, 1000.0], rel=1e-4)
    assert len(recording.log.take("CAM")["Img"]) == 448


@needs_ulogs
def test_px4_logs_tell_their_gaps_and_dropouts() -> None:
    """As noted beside the logs: 250 Hz in uneven steps, 4 dropouts, 8 gaps over 10 ms, the longest 64.8 ms."""
    recording = open_recording(ULOGS / "sample.ulg", AIRFRAME)
    texts = " | ".join(notice.text for notice in recording.notices)
    assert "8 gaps longer than 10.0 ms" in texts
    assert "64.8 ms" in texts
    assert "4 dropouts" in texts
    assert "uneven steps" in texts
    assert {entry.station for entry in recording.records() if isinstance(entry, ImuBatch)} == {Station.ROOT}


@needs_ulogs
@pytest.mark.parametrize("name", ["sample.ulg", "sample_log_small.ulg"])
def test_a_px4_log_holds_what_pyulog_finds_in_it(name: str) -> None:
    theirs = ULog(str(ULOGS / name))
    log = UlogMessages(ULOGS / name, {data.name for data in theirs.data_list})
    assert log.logged == sorted((data.name, data.multi_id) for data in theirs.data_list)
    assert (log.damaged_bytes, log.cut_bytes) == (0, 0)
    for data in theirs.data_list:
        columns = log.take(data.name, data.multi_id)
        for column, values in data.data.items():
            if "." in column:  # nested, which nothing of ours asks for
                continue
            assert columns[column].tobytes() == np.ascontiguousarray(values).tobytes(), (data.name, column)
    changes = [(t_us, name, float(value)) for t_us, name, value in theirs.changed_parameters]
    start = [(theirs.start_timestamp, name, float(value)) for name, value in theirs.initial_parameters.items()]
    assert log.parameters == [*start, *changes]
    assert log.dropouts_ms == [dropout.duration for dropout in theirs.dropouts]
