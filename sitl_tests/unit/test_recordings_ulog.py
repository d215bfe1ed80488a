"""PX4 logs, written here byte by byte from the published format."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.logs.ulog import UlogRecording
from companion.adapters.recordings.recording_factory import open_recording
from companion.errors import RecordingError
from companion.params.files import load_airframe
from companion.records import AutopilotParameter, Axis, ClockName, ImuBatch, Station, VehicleState

AIRFRAME = load_airframe("sitl-plane")
SIX_AXES = load_airframe("nadir-2m")
MAGIC_AND_START = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)
FORMATS = {
    "sensor_accel": "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;",
    "sensor_gyro": "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;",
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;int32_t accelerometer_timestamp_relative;"
    "float[3] accelerometer_m_s2;",
    "vehicle_imu": "uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;float[3] delta_velocity;"
    "uint32_t delta_angle_dt;uint32_t delta_velocity_dt;",
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "vehicle_land_detected": "uint64_t timestamp;bool landed;",
}
LAYOUTS = {
    "sensor_accel": "<QQfff",
    "sensor_gyro": "<QQfff",
    "sensor_combined": "<Qfffifff",
    "vehicle_imu": "<QQ6fII",
    "vehicle_attitude": "<Qffff",
    "vehicle_land_detected": "<Q?",
}


class Log:
    def __init__(self, *topics: tuple[str, int], parameters: dict[str, float] | None = None) -> None:
        self.data = MAGIC_AND_START
        for name in dict.fromkeys(name for name, _ in topics):
            self._message(b"F", f"{name}:{FORMATS[name]}".encode())
        for name, value in (parameters or {}).items():
            key = f"float {name}".encode()
            self._message(b"P", bytes([len(key)]) + key + struct.pack("<f", value))
        self._ids = {topic: number for number, topic in enumerate(topics)}
        for (name, instance), number in self._ids.items():
            self._message(b"A", struct.pack("<BH", instance, number) + name.encode())

    def _message(self, kind: bytes, body: bytes) -> None:
        self.data += struct.pack("<H", len(body)) + kind + body

    def add(self, name: str, instance: int, *values: float) -> None:
        self._message(b"D", struct.pack("<H", self._ids[name, instance]) + struct.pack(LAYOUTS[name], *values))

    def dropout(self, duration_ms: int) -> None:
        self._message(b"O", struct.pack("<H", duration_ms))


def opened(tmp_path: Path, data: bytes, airframe: object = AIRFRAME) -> UlogRecording:
    (tmp_path / "a.ulg").write_bytes(data)
    recording = open_recording(tmp_path / "a.ulg", airframe)  # type: ignore[arg-type]
    assert isinstance(recording, UlogRecording)
    return recording


def three_imus(n: int = 100) -> Log:
    log = Log(*(("sensor_accel", i) for i in range(3)), *(("sensor_gyro", i) for i in range(3)))
    for k in range(n):
        for i in range(3):
            log.add("sensor_accel", i, 5000 + 1000 * k + 300, 5000 + 1000 * k, 0.0, 0.0, -9.0 - i)
            log.add("sensor_gyro", i, 5000 + 1000 * k + 300, 5000 + 1000 * k, 0.1, 0.2, 0.3)
    return log


def test_sensor_instances_become_stations_at_their_sample_time(tmp_path: Path) -> None:
    recording = opened(tmp_path, three_imus().data)
    for stream in recording.streams:
        assert stream.t_ns.tolist() == [5_000_000 + 1_000_000 * k for k in range(100)]
        assert stream.values[:, 2].tolist() == [-9.0 - stream.station] * 100
        assert stream.axes == Axis.Z
    assert [stream.station for stream in recording.streams] == list(Station)
    assert recording.hub is ClockName.BOOT
    assert recording.airframe.left.lowpass_accel_hz == 0.0
    assert recording.airframe.left.source.stamp_offset_s == 0.0
    assert recording.airframe.left.rate_hz == pytest.approx(1000.0)


def test_the_combined_topic_stands_for_the_first_imu_with_both_its_times(tmp_path: Path) -> None:
    log = Log(("sensor_combined", 0), parameters={"IMU_GYRO_CUTOFF": 40.0, "EKF2_RNG_CTRL": 0.0, "MPC_XY_P": 1.0})
    for k in range(100):
        log.add("sensor_combined", 0, 10_000 + 4000 * k, 0.001 * k, 0.0, 0.0, -1000, 1.0, 2.0, 3.0)
    recording = opened(tmp_path, log.data, SIX_AXES)
    (stream,) = recording.streams
    assert stream.axes == Axis.ALL
    # accelerometer 1 ms before the gyro: the gyro is interpolated to it, and the first sample has no gyro before it
    assert stream.t_ns.tolist() == [9_000_000 + 4_000_000 * k for k in range(1, 100)]
    np.testing.assert_allclose(stream.values[:, 3], 0.001 * (np.arange(1, 100) - 0.25), rtol=1e-5)
    assert stream.values[0, :3].tolist() == [1.0, 2.0, 3.0]
    parameters = [entry for entry in recording.records() if isinstance(entry, AutopilotParameter)]
    assert [(entry.name, entry.value) for entry in parameters] == [("IMU_GYRO_CUTOFF", 40.0), ("EKF2_RNG_CTRL", 0.0)]


def test_integrated_samples_are_divided_by_their_time(tmp_path: Path) -> None:
    log = Log(("vehicle_imu", 0), parameters={"IMU_INTEG_RATE": 200.0})
    for k in range(20):
        log.add("vehicle_imu", 0, 5000 * k + 9, 5000 * (k + 1), 0.01, 0.0, 0.0, 0.0, 0.0, -0.049, 5000, 5000)
    recording = opened(tmp_path, log.data, SIX_AXES)
    (stream,) = recording.streams
    np.testing.assert_allclose(stream.values[:, 2], -9.8, rtol=1e-6)
    np.testing.assert_allclose(stream.values[:, 3], 2.0, rtol=1e-6)
    assert stream.t_ns.tolist() == [5_000_000 * k + 2_500_000 for k in range(20)], "in the middle, and once only"
    assert not [entry for entry in recording.records() if isinstance(entry, AutopilotParameter)]


def test_attitude_of_a_known_quaternion(tmp_path: Path) -> None:
    log = Log(("sensor_combined", 0), ("vehicle_attitude", 0))
    for k in range(10):
        log.add("sensor_combined", 0, 4000 * k, 0.0, 0.0, 0.0, 0, 0.0, 0.0, -9.8)
    # yaw 90 deg, then pitch 30 deg, then roll -60 deg
    half = np.radians([-60.0, 30.0, 90.0]) / 2
    (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    log.add("vehicle_attitude", 0, 36_000, *q)
    (state,) = [entry for entry in opened(tmp_path, log.data, SIX_AXES).records() if isinstance(entry, VehicleState)]
    angles = np.degrees([state.roll_rad, state.pitch_rad, state.yaw_rad])
    np.testing.assert_allclose(angles, [-60.0, 30.0, 90.0], atol=1e-4)


def test_gaps_and_dropouts_are_told_and_nothing_is_invented_in_them(tmp_path: Path) -> None:
    log = Log(("sensor_combined", 0))
    for k in [k for k in range(200) if not 50 <= k < 80]:
        if k == 80:
            log.dropout(120)
        log.add("sensor_combined", 0, 4000 * k, 0.0, 0.0, 0.0, 0, 0.0, 0.0, -9.8)
    recording = opened(tmp_path, log.data, SIX_AXES)
    texts = [notice.text for notice in recording.notices]
    assert any("1 gap longer than 10.0 ms" in text and "124.0 ms" in text for text in texts)
    assert any("1 dropout of 120 ms" in text for text in texts)
    stamps = np.concatenate([entry.t_ns for entry in recording.records() if isinstance(entry, ImuBatch)])
    assert stamps.size == 170
    assert not ((stamps > 49 * 4_000_000) & (stamps < 80 * 4_000_000)).any()


def test_a_cut_log_gives_what_is_whole(tmp_path: Path) -> None:
    data = three_imus().data
    recording = opened(tmp_path, data[: len(data) * 2 // 3])
    counts = [stream.t_ns.size for stream in recording.streams]
    assert all(55 < count < 70 for count in counts)


def test_slow_or_missing_sensors_are_named(tmp_path: Path) -> None:
    log = Log(("sensor_accel", 0))
    for k in range(20):
        log.add("sensor_accel", 0, 10**6 * k, 10**6 * k, 0.0, 0.0, -9.8)
    with pytest.raises(RecordingError, match=r"no inertial samples at 50 Hz or more; it has sensor_accel\[0\]"):
        opened(tmp_path, log.data)
    with pytest.raises(RecordingError, match="cannot be read as a ULog"):
        opened(tmp_path, b"ULog\x01\x12\x35\x01\0\0")


def test_whether_it_is_on_the_ground_is_what_px4_detected(tmp_path: Path) -> None:
    log = Log(("sensor_combined", 0), ("vehicle_attitude", 0), ("vehicle_land_detected", 0))
    for k in range(40):
        log.add("sensor_combined", 0, 10_000 + 1000 * k, 0.1, 0.2, 0.3, -500, 0.0, 0.0, -9.8)
    log.add("vehicle_land_detected", 0, 11_000, True)
    log.add("vehicle_attitude", 0, 20_000, 1.0, 0.0, 0.0, 0.0)
    log.add("vehicle_land_detected", 0, 25_000, False)
    log.add("vehicle_attitude", 0, 36_000, 1.0, 0.0, 0.0, 0.0)
    recording = opened(tmp_path, log.data)
    assert [state.on_ground for state in recording.records() if isinstance(state, VehicleState)] == [True, False]
