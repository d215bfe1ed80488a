"""ArduPilot onboard logs, written here byte by byte from the published format: every letter, damage, cuts, stations."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.adapters.recordings.logs.bin import BinRecording
from companion.adapters.recordings.logs.dataflash import DataflashLog
from companion.adapters.recordings.recording_factory import open_recording
from companion.doctor.examine import read_log
from companion.doctor.ranging import check_ranging
from companion.errors import RecordingError
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.params.vehicle import VEHICLE_PARAMETERS
from companion.records import AutopilotParameter, Axis, ClockName, ImuBatch, Station, VehicleState

AIRFRAME = load_airframe("sitl-plane")
FORMATS = {
    "PARM": (32, "QNff", "TimeUS,Name,Value,Default", "<Q16sff"),
    "ACC": (162, "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ", "<QBQfff"),
    "GYR": (163, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ", "<QBQfff"),
    "IMU": (164, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "<QBffffff"),
    "ATT": (72, "Qfff", "TimeUS,Roll,Pitch,Yaw", "<Qfff"),
    "ARSP": (112, "QBf", "TimeUS,I,Airspeed", "<QBf"),
    "TST": (200, "cCeELbhHiIdgaZ", "a,b,c,d,e,f,g,h,i,j,k,l,m,n", "<hHiIibhHiIde64s64s"),
}
HEAD = b"\xa3\x95"


class Log:
    def __init__(self, *names: str) -> None:
        self.data = b""
        for name in names:
            number, letters, fields, layout = FORMATS[name]
            length = 3 + struct.calcsize(layout)
            body = struct.pack("<BB4s16s64s", number, length, name.encode(), letters.encode(), fields.encode())
            self.data += HEAD + bytes([128]) + body

    def add(self, name: str, *values: object) -> None:
        self.data += HEAD + bytes([FORMATS[name][0]]) + struct.pack(FORMATS[name][3], *values)


def flight(n: int = 100, gyro_shift_us: int = 0) -> Log:
    log = Log("PARM", "ACC", "GYR", "ATT", "ARSP")
    log.add("PARM", 500, b"INS_ACCEL_FILTER", 20.0, 20.0)
    log.add("PARM", 500, b"RTL_RADIUS", 90.0, 90.0)
    log.add("ARSP", 900, 0, 17.5)
    for i in range(n):
        t_us = 1000 + 1000 * i
        for imu in range(3):
            log.add("ACC", t_us + 7, imu, t_us, 0.1, 0.2, -9.8 - imu - 0.01 * i)
            log.add("GYR", t_us + 7, imu, t_us + gyro_shift_us, 0.001 * i, 0.02, 0.03)
    log.add("ATT", 50_000, 90.0, -45.0, 180.0)
    return log


def count(log: DataflashLog, name: str) -> int:
    return len(log.take(name).get("TimeUS", ()))


def write(tmp_path: Path, data: bytes) -> Path:
    (tmp_path / "a.BIN").write_bytes(data)
    return tmp_path / "a.BIN"


def test_raw_imus_become_stations_without_the_mavlink_low_pass(tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path, flight().data), AIRFRAME)
    assert isinstance(recording, BinRecording)
    batches = [entry for entry in recording.records() if isinstance(entry, ImuBatch)]
    for station in Station:
        station_batches = [batch for batch in batches if batch.station is station]
        assert np.concatenate([b.t_ns for b in station_batches]).tolist() == [1_000_000 * (1 + i) for i in range(100)]
        z = np.concatenate([b.values for b in station_batches])[:, 2]
        np.testing.assert_allclose(z, np.float32([-9.8 - station - 0.01 * i for i in range(100)]), rtol=1e-6)
        assert {batch.axes for batch in station_batches} == {Axis.Z}
        sensor = recording.airframe.sensor(station)
        assert (sensor.lowpass_accel_hz, sensor.source.stamp_offset_s) == (0.0, 0.0)
        assert sensor.rate_hz == pytest.approx(1000.0)
    assert recording.hub is ClockName.BOOT


def test_parameters_and_flight_state_come_in_si_and_in_time_order(tmp_path: Path) -> None:
    records = list(open_recording(write(tmp_path, flight().data), AIRFRAME).records())
    assert records[0] == AutopilotParameter("INS_ACCEL_FILTER", 20.0, 500_000)
    assert not [entry for entry in records if isinstance(entry, AutopilotParameter) and "RTL" in entry.name]
    (state,) = [entry for entry in records if isinstance(entry, VehicleState)]
    assert (state.roll_rad, state.pitch_rad, state.yaw_rad) == pytest.approx((np.pi / 2, -np.pi / 4, np.pi))
    assert state.airspeed_mps == 17.5
    times = [entry.received_host_ns for entry in records]  # type: ignore[union-attr]
    assert times == sorted(times)


def test_every_parameter_that_the_doctor_judges_is_read(tmp_path: Path) -> None:
    """A second range finder, cameras and the landing were left out: the doctor was silent on them."""
    log = flight()
    for row in VEHICLE_PARAMETERS.values():
        log.add("PARM", 600, row.name.encode(), row.high, row.high)
    path = write(tmp_path, log.data)
    evidence = read_log(open_recording(path, AIRFRAME), AIRFRAME, Settings())
    assert evidence.parameters == pytest.approx({name: row.high for name, row in VEHICLE_PARAMETERS.items()})
    log.add("PARM", 700, b"RNGFND2_TYPE", 20.0, 20.0)
    log.add("PARM", 700, b"RNGFND2_ORIENT", 25.0, 25.0)
    downward = load_airframe("nadir-2m")
    assert downward.orientation == 25
    rival = read_log(open_recording(write(tmp_path, log.data), downward), downward, Settings())
    rival.parameters.pop("IMU_ACCEL_CUTOFF")  # PX4's
    assert any("RNGFND2 looks to 25 too" in finding.text for finding in check_ranging(rival))


@pytest.mark.parametrize("is_mended", [False, True])
def test_a_format_that_contradicts_itself_costs_its_messages_alone(tmp_path: Path, is_mended: bool) -> None:
    """A letter of ARSP's format is damaged; ArduPilot may write the format once more."""
    log = flight()
    formats = Log("ARSP").data
    assert log.data.count(formats) == 1
    damaged = formats.replace(b"QBf", b"QBd")
    data = log.data.replace(formats, damaged + formats * is_mended)
    records = list((recording := BinRecording(write(tmp_path, data), AIRFRAME)).records())
    assert sum(record.t_ns.size for record in records if isinstance(record, ImuBatch)) == 300
    (state,) = [record for record in records if isinstance(record, VehicleState)]
    assert state.airspeed_mps == (17.5 if is_mended else 0.0)
    notes = [notice.text for notice in recording.notices]
    assert any("messages ARSP contradicts its own length" in text for text in notes) is not is_mended
    assert not any("are no messages" in text for text in notes)


def test_gyro_samples_at_other_stamps_are_interpolated_to_the_accelerometers(tmp_path: Path) -> None:
    recording = BinRecording(write(tmp_path, flight(gyro_shift_us=250).data), load_airframe("nadir-2m"))
    (stream,) = recording.streams  # the nodes of nadir-2m are not in an onboard log
    assert stream.axes == Axis.ALL
    assert stream.t_ns.size == 99, "the first accelerometer sample comes before any gyro sample"
    np.testing.assert_allclose(stream.values[:, 3], 0.001 * (np.arange(1, 100) - 0.25), rtol=1e-5)
    assert len([notice for notice in recording.notices if "not in an onboard log" in notice.text]) == 2


def test_filtered_imus_stand_in_with_the_logs_own_filter(tmp_path: Path) -> None:
    log = Log("PARM", "IMU")
    log.add("PARM", 0, b"INS_ACCEL_FILTER", 35.0, 20.0)
    for i in range(50):
        log.add("IMU", 2500 * i, 0, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0)
    recording = BinRecording(write(tmp_path, log.data), load_airframe("nadir-2m"))
    (stream,) = recording.streams
    np.testing.assert_allclose(stream.values[0], [1, 2, 3, 0.1, 0.2, 0.3], rtol=1e-6)
    assert recording.airframe.root.lowpass_accel_hz == 35.0
    assert recording.airframe.root.lowpass_gyro_hz == load_airframe("nadir-2m").root.lowpass_gyro_hz
    assert any("INS_GYRO_FILTER is not in the log" in notice.text for notice in recording.notices)
    assert recording.airframe.root.rate_hz == pytest.approx(400.0)


@pytest.mark.parametrize(("option", "lowpass_hz"), [(0.0, 0.0), (1.0, 0.0), (4.0, 20.0), (8.0, 0.0), (12.0, 0.0)])
def test_samples_that_were_logged_behind_the_filter_have_its_low_pass(
    tmp_path: Path, option: float, lowpass_hz: float
) -> None:
    log = flight()
    log.add("PARM", 500, b"INS_RAW_LOG_OPT", option, option)
    recording = BinRecording(write(tmp_path, log.data), AIRFRAME)
    assert recording.airframe.root.lowpass_accel_hz == lowpass_hz


def test_a_copy_behind_the_filter_is_no_further_imu(tmp_path: Path) -> None:
    """Two of four numbers are those of the first two IMUs behind the filter."""
    log = Log("PARM", "ACC", "GYR")
    log.add("PARM", 500, b"INS_RAW_LOG_OPT", 8.0, 8.0)
    for i in range(100):
        for imu in range(4):
            log.add("ACC", 1007 + 1000 * i, imu, 1000 + 1000 * i, 0.0, 0.0, -9.8 - imu)
            log.add("GYR", 1007 + 1000 * i, imu, 1000 + 1000 * i, 0.0, 0.0, 0.0)
    recording = BinRecording(write(tmp_path, log.data), AIRFRAME)
    assert [stream.station for stream in recording.streams] == [Station.ROOT, Station.LEFT]
    assert any("no samples of IMU 3" in notice.text for notice in recording.notices)


@pytest.mark.parametrize(("last", "used_mps"), [("Pri", 0.3), ("Oth", 18.0)])
def test_the_airspeed_is_that_of_the_sensor_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: str, used_mps: float
) -> None:
    """Two sensors in one instant, of which the second is the primary one; else the first counts."""
    monkeypatch.setitem(FORMATS, "ARSP", (112, "QBfB", f"TimeUS,I,Airspeed,{last}", "<QBfB"))
    log = Log("ACC", "GYR", "ATT", "ARSP")
    for i in range(10):
        log.add("ACC", 1007 + 1000 * i, 0, 1000 + 1000 * i, 0.0, 0.0, -9.8)
        log.add("GYR", 1007 + 1000 * i, 0, 1000 + 1000 * i, 0.0, 0.0, 0.0)
    log.add("ARSP", 2000, 0, 18.0, 1)
    log.add("ARSP", 2000, 1, 0.3, 1)
    log.add("ATT", 50_000, 0.0, 0.0, 0.0)
    records = BinRecording(write(tmp_path, log.data), AIRFRAME).records()
    (state,) = [entry for entry in records if isinstance(entry, VehicleState)]
    assert state.airspeed_mps == pytest.approx(used_mps)


def test_every_letter_of_the_format_has_its_type_and_scale(tmp_path: Path) -> None:
    log = Log("TST")
    array = np.arange(32, dtype="<i2") - 5
    log.add(
        "TST",
        -150,
        65000,
        -2_000_000,
        4_000_000_000,
        -353632610,
        -7,
        -300,
        60000,
        -70000,
        4_000_000_000,
        1.25,
        0.5,
        array.tobytes(),
        b"text",
    )
    table = DataflashLog(write(tmp_path, log.data)).take("TST")
    scaled = [float(table[name][0]) for name in "abcdefghijkl"]
    expected = [-1.5, 650.0, -20_000.0, 40_000_000.0, -35.363261, -7, -300, 60000, -70000, 4e9, 1.25, 0.5]
    assert scaled == pytest.approx(expected, rel=1e-12)
    assert table["m"][0].tolist() == array.tolist()
    assert table["n"][0] == b"text"


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(400, 3000))
def test_a_cut_log_gives_every_whole_message(cut: int, tmp_path: Path) -> None:
    data = flight(30).data
    size = 3 + struct.calcsize(FORMATS["ACC"][3])
    preamble = len(Log("PARM", "ACC", "GYR", "ATT", "ARSP").data) + 2 * 35 + 16
    cut = max(cut, preamble + 6 * size)
    log = DataflashLog(write(tmp_path, data[:cut]))
    message_count = (min(cut, len(data)) - preamble) // size
    assert count(log, "ACC") + count(log, "GYR") == min(message_count, 180)
    assert log.skipped_bytes == 0


def test_a_header_pattern_inside_a_message_is_not_taken_for_one(tmp_path: Path) -> None:
    log = flight(3)
    (tricky,) = struct.unpack("<f", HEAD + bytes([162, 0x41]))
    for i in range(20):
        log.add("ACC", 10_000 + i, 0, 10_000 + i, tricky, tricky, tricky)
    parsed = DataflashLog(write(tmp_path, log.data))
    assert count(parsed, "ACC") == 9 + 20
    assert (parsed.skipped_bytes, parsed.cut_bytes) == (0, 0)
    assert parsed.take("ACC")["AccX"][-1] == np.float32(tricky)


def test_damage_inside_is_skipped_and_counted(tmp_path: Path) -> None:
    data = flight(30).data
    size = 3 + struct.calcsize(FORMATS["ACC"][3])
    at = len(data) - 90 * size
    recording = BinRecording(write(tmp_path, data[:at] + bytes(size) + data[at + size :]), AIRFRAME)
    assert recording.log.skipped_bytes == size
    assert count(recording.log, "ACC") + count(recording.log, "GYR") == 179
    assert any("damage" in notice.text for notice in recording.notices)


def test_a_cut_log_says_so(tmp_path: Path) -> None:
    recording = BinRecording(write(tmp_path, flight(30).data[:-5]), AIRFRAME)
    assert any("truncated" in notice.text for notice in recording.notices)


def test_logs_without_samples_and_other_files_are_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"a\.BIN: no ACC, GYR or IMU message"):
        open_recording(write(tmp_path, Log("ATT").data), AIRFRAME)
    with pytest.raises(RecordingError, match=r"a\.BIN: not a recording that can be read"):
        open_recording(write(tmp_path, b"\0" * 100), AIRFRAME)
    with pytest.raises(RecordingError, match="not an ArduPilot"):
        DataflashLog(write(tmp_path, b"\0" * 100))
    with pytest.raises(RecordingError, match="no whole message"):
        DataflashLog(write(tmp_path, flight(1).data[:50]))
