"""PX4 ULog files as recordings: sensor_accel and sensor_gyro, vehicle_imu, or sensor_combined.

Everything is in the autopilot's boot clock. These topics come before PX4's cutoff filters, so the airframe's low-pass
is taken out. Samples of vehicle_imu and sensor_combined are means over the integration time that ends at their stamp:
they are stamped in its middle, and IMU_INTEG_RATE, by which the same is done to MAVLink messages, is not passed on.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.adapters.recordings.logs.onboard_log import LoggedAxes, OnboardLog, as_floats, latest, vehicle_states
from companion.adapters.recordings.logs.ulog_messages import UlogMessages
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.params.vehicle import VEHICLE_PARAMETERS
from companion.records import AutopilotParameter, Axis, Floats, Ints, VehicleState

_LEAST_RATE_HZ = 50.0  # slower topics are logged for plots alone (choice)
_NO_TIME = 0x7FFFFFFF  # RELATIVE_TIMESTAMP_INVALID (PX4 msg/SensorCombined.msg)
_ARMED = 2  # arming_state of vehicle_status (PX4 msg/VehicleStatus.msg)
_INTEGRATION_RATE = "IMU_INTEG_RATE"
_TOPICS = [
    "sensor_accel",
    "sensor_gyro",
    "sensor_combined",
    "vehicle_imu",
    "vehicle_attitude",
    "vehicle_local_position",
    "vehicle_status",
    "vehicle_land_detected",
    "airspeed",
    "airspeed_validated",
]


class UlogRecording(OnboardLog):
    """A PX4 log; see :class:`OnboardLog` for the shared attributes.

    Instance 0 of a sensor topic is the first IMU, as in :class:`~companion.adapters.recordings.logs.bin.BinRecording`;
    sensor_combined stands for the first IMU where that was not logged fast enough.

    Raises
    ------
    RecordingError
        No ULog, or no inertial samples of any station at 50 Hz or more.
    """

    condition = f" at {_LEAST_RATE_HZ:.0f} Hz or more"

    def __init__(self, path: Path, airframe: Airframe) -> None:
        super().__init__(path, airframe)
        self._log = UlogMessages(path, _TOPICS)
        self.find_streams()
        self._say_what_is_wrong()
        if not self.streams:
            logged = ", ".join(f"{name}[{instance}]" for name, instance in self._log.logged) or "nothing"
            raise RecordingError(f"{path}: no inertial samples at {_LEAST_RATE_HZ:.0f} Hz or more; it has {logged}")

    def imu_samples(self, imu: int) -> tuple[str, list[LoggedAxes]]:
        """The samples of the first topic that was logged fast enough; see :class:`OnboardLog`."""
        choices = [self._sensor_topics(imu), self._vehicle_imu(imu), self._combined() if imu == 0 else []]
        return "", next((parts for parts in choices if parts and all(_fast(t_ns) for _, t_ns, _ in parts)), [])

    def _sensor_topics(self, imu: int) -> list[LoggedAxes]:
        names = ("x", "y", "z")
        accel, gyro = (self._log.take(topic, imu, "timestamp", *names) for topic in ("sensor_accel", "sensor_gyro"))
        parts = []
        if accel:
            parts.append(_logged_axes(Axis.ACCEL, _sample_time(accel), [accel[name] for name in names]))
        if gyro:
            parts.append(_logged_axes(Axis.GYRO, _sample_time(gyro), [gyro[name] for name in names]))
        return parts

    def _vehicle_imu(self, imu: int) -> list[LoggedAxes]:
        kinds = ((Axis.ACCEL, "delta_velocity", "delta_velocity_dt"), (Axis.GYRO, "delta_angle", "delta_angle_dt"))
        needed = [name for _, field, period in kinds for name in (*(f"{field}[{i}]" for i in range(3)), period)]
        table = self._log.take("vehicle_imu", imu, "timestamp", *needed)
        if not table:
            return []
        parts = []
        for axes, field, period in kinds:
            seconds = table[period] * 1e-6
            good = seconds > 0
            columns = [table[f"{field}[{i}]"][good] / seconds[good] for i in range(3)]
            parts.append(_logged_axes(axes, _sample_time(table)[good] - _half_us(table, period), columns))
        return parts

    def _combined(self) -> list[LoggedAxes]:
        vectors = [f"{name}[{i}]" for name in ("accelerometer_m_s2", "gyro_rad") for i in range(3)]
        table = self._log.take("sensor_combined", 0, "timestamp", "accelerometer_timestamp_relative", *vectors)
        if not table:
            return []
        t_us = table["timestamp"].astype(np.int64)
        relative = table["accelerometer_timestamp_relative"].astype(np.int64)
        valid = relative != _NO_TIME
        accel = [table[f"accelerometer_m_s2[{i}]"][valid] for i in range(3)]
        gyro = [table[f"gyro_rad[{i}]"] for i in range(3)]
        accel_us = t_us + relative - _half_us(table, "accelerometer_integral_dt")
        gyro_us = t_us - _half_us(table, "gyro_integral_dt")
        return [_logged_axes(Axis.ACCEL, accel_us[valid], accel), _logged_axes(Axis.GYRO, gyro_us, gyro)]

    def _say_what_is_wrong(self) -> None:
        dropouts = self._log.dropouts_ms
        if dropouts:
            lost_ms = sum(dropouts)
            many = f"{len(dropouts)} dropout{'s' if len(dropouts) > 1 else ''}"
            self.say(f"the logger reports {many} of {lost_ms} ms in all")
        if self._log.damaged_bytes:
            self.say(f"{self._log.damaged_bytes} bytes are damaged and were left out")
        self.say_leaps(self._log.leaps)
        self.say_truncated(self._log.cut_bytes)

    def parameter_changes(self) -> Iterator[tuple[int, AutopilotParameter]]:
        """Parameters, less IMU_INTEG_RATE: see the module."""
        for t_us, name, value in self._log.parameters:
            if name in VEHICLE_PARAMETERS and name != _INTEGRATION_RATE and math.isfinite(value):
                yield t_us * 1000, AutopilotParameter(name, value, t_us * 1000)

    def states(self) -> Iterator[tuple[int, VehicleState]]:
        """States at every vehicle_attitude; PX4 does not log the throttle in these topics."""
        attitude = self._log.take("vehicle_attitude", 0, "timestamp", *(f"q[{i}]" for i in range(4)))
        if not attitude:
            return
        t_us = attitude["timestamp"].astype(np.int64)
        angles = _euler(*(attitude[f"q[{i}]"].astype(np.float64) for i in range(4)))
        airspeed = self._latest("airspeed_validated", "true_airspeed_m_s", t_us)
        if not airspeed.any():
            airspeed = self._latest("airspeed", "true_airspeed_m_s", t_us)
        ned_mps = np.column_stack([self._latest("vehicle_local_position", axis, t_us) for axis in ("vx", "vy", "vz")])
        navigates = self._latest("vehicle_local_position", "v_xy_valid", t_us) > 0
        detected = bool(self._log.take("vehicle_land_detected", 0, "timestamp", "landed"))
        yield from vehicle_states(
            t_us,
            roll_rad=angles[:, 0],
            pitch_rad=angles[:, 1],
            yaw_rad=angles[:, 2],
            airspeed_mps=airspeed,
            climb_mps=-ned_mps[:, 2],
            throttle=np.zeros(t_us.size),
            armed=self._latest("vehicle_status", "arming_state", t_us) == _ARMED,
            velocity_ned_mps=_triples(ned_mps, navigates),
            **({"on_ground": self._latest("vehicle_land_detected", "landed", t_us) > 0} if detected else {}),
        )

    def _latest(self, topic: str, field: str, t_us: Ints) -> Floats:
        return latest(self._log.take(topic, 0, "timestamp", field), "timestamp", field, t_us)


def _triples(values: Floats, valid: NDArray[np.bool_]) -> NDArray[np.object_]:
    """Rows (n, 3) as n triples of floats, None where they are not valid."""
    triples = np.full(len(values), None, dtype=object)
    for i in np.flatnonzero(valid):
        triples[i] = tuple(values[i].tolist())
    return triples


def _logged_axes(axes: Axis, t_us: Ints, columns: list[Any]) -> LoggedAxes:
    values = np.zeros((t_us.size, 6))
    first = 0 if axes & Axis.ACCEL else 3
    values[:, first : first + 3] = as_floats(columns)
    order = np.argsort(t_us, kind="stable")
    return axes, (t_us * 1000)[order], values[order]


def _sample_time(table: dict[str, Any]) -> Ints:
    stamps: Ints = table.get("timestamp_sample", table["timestamp"]).astype(np.int64)
    return stamps if stamps.all() else table["timestamp"].astype(np.int64)


def _half_us(table: dict[str, Any], period: str) -> int:
    """Half the usual integration time; old logs have it in seconds, some not at all."""
    if period not in table or not table[period].size:
        return 0
    unit_us = 1.0 if table[period].dtype.kind in "iu" else 1e6
    return round(0.5 * unit_us * float(np.nanmedian(table[period])))


def _fast(t_ns: Ints) -> bool:
    return t_ns.size > 2 and bool(np.median(np.diff(t_ns)) <= 1e9 / _LEAST_RATE_HZ)


def _euler(w: Floats, x: Floats, y: Floats, z: Floats) -> Floats:
    """Roll, pitch, yaw (n, 3) of the quaternion that takes body FRD to NED (PX4's vehicle_attitude)."""
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.column_stack([roll, pitch, yaw])
