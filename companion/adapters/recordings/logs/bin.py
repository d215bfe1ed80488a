"""ArduPilot .BIN logs as recordings: the raw accelerometers and gyros where they were logged, else the filtered IMU.

Everything is in the autopilot's boot clock. Raw samples (ACC, GYR) have passed no filter of ArduPilot, so the
airframe's low-pass is taken out for them; IMU messages carry INS_ACCEL_FILTER and INS_GYRO_FILTER of the log's own
parameters.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.mavlink.decode.message_records import PARAMETER_PREFIXES
from companion.adapters.mavlink.decode.source_map import AUTOPILOT_COMPONENT, MappedSource, build_mapping
from companion.adapters.recordings.logs.dataflash import DataflashLog
from companion.adapters.recordings.recording import InertialStream, LoggedRecording, join, merge, rate_of, timed
from companion.errors import RecordingError
from companion.params.airframe import Airframe, Sensor
from companion.params.vehicle import implausible
from companion.records import AutopilotParameter, Axis, ClockName, Floats, Ints, Record, VehicleState
from companion.units import Severity

_IMU_OF_MESSAGE = {"RAW_IMU": 0, "HIGHRES_IMU": 0, "SCALED_IMU": 0, "SCALED_IMU2": 1, "SCALED_IMU3": 2}


class BinRecording(LoggedRecording):
    """An ArduPilot onboard log; see :class:`LoggedRecording` for the shared attributes.

    The airframe's sources tell which IMU is which station: RAW_IMU, HIGHRES_IMU and SCALED_IMU are the first (the first
    two with ``instance``: that one), SCALED_IMU2 the second, SCALED_IMU3 the third.

    Raises
    ------
    RecordingError
        No dataflash log, or no inertial sample of any station.
    """

    def __init__(self, path: Path, airframe: Airframe) -> None:
        super().__init__(path, airframe, ClockName.BOOT)
        self.log = DataflashLog(path)
        self._parameters = _parameters(self.log)
        self.streams: list[InertialStream] = []
        sensors: dict[str, Any] = {}
        for source in build_mapping(airframe).sources:
            stream, sensor = self._station(source, airframe.sensor(source.station))
            self.streams += [] if stream is None else [stream]
            sensors[source.station.name.lower()] = sensor
        if not self.streams:
            raise RecordingError(f"{path}: no ACC, GYR or IMU message of any station of '{airframe.name}'")
        self.airframe = dataclasses.replace(airframe, **sensors)
        self._say_what_is_wrong()

    def records(self) -> Iterator[Record]:
        """Parameters, flight state and samples, in order of time."""
        sources: list[Iterator[tuple[int, Record]]] = [self._parameter_changes(), self._states()]
        sources += map(timed, self.streams)
        yield from merge(*sources)

    def _station(self, source: MappedSource, sensor: Sensor) -> tuple[InertialStream | None, Sensor]:
        number = imu_of(sensor)
        name = f"{self.path.name}: {source.station.name.lower()}"
        if number is None:
            self.notes.add(f"{name}: {sensor.source.message} of component {source.component} is not in an onboard log")
            return None, sensor
        parts = _raw_parts(self.log, number)
        raw = bool(parts)
        if not raw:
            parts = _filtered_parts(self.log, number)
        stream = stream_in_body(source, parts)
        if stream is None:
            self.notes.add(f"{name}: no samples of IMU {number + 1} in this log")
            return None, sensor
        self.notes.gaps(f"{name} (IMU {number + 1}, {'raw' if raw else 'filtered'})", stream.t_ns)
        return stream, self._as_logged(sensor, stream, raw)

    def _as_logged(self, sensor: Sensor, stream: InertialStream, raw: bool) -> Sensor:
        filters = (0.0, 0.0) if raw else (self._filter("ACCEL", sensor), self._filter("GYRO", sensor))
        return dataclasses.replace(
            sensor,
            rate_hz=rate_of(stream.t_ns, sensor.rate_hz),
            lowpass_accel_hz=filters[0],
            lowpass_gyro_hz=filters[1],
            source=dataclasses.replace(sensor.source, stamp_offset_s=0.0),
        )

    def _filter(self, kind: str, sensor: Sensor) -> float:
        """The low-pass as logged; what cannot be is said, and the airframe's taken."""
        name = f"INS_{kind}_FILTER"
        logged_hz = self._parameters.get(name, 0.0)
        why = implausible(name, logged_hz)
        if why is None:
            return logged_hz
        self.notes.add(f"{self.path.name}: {why}")
        return sensor.lowpass_accel_hz if kind == "ACCEL" else sensor.lowpass_gyro_hz

    def _say_what_is_wrong(self) -> None:
        if self.log.cut_bytes:
            text = f"{self.path.name}: truncated: the last {self.log.cut_bytes} bytes are no whole message, left out"
            self.notes.add(text, severity=Severity.INFO)
        if self.log.skipped_bytes:
            self.notes.add(f"{self.path.name}: {self.log.skipped_bytes} bytes are no messages (damage), skipped")
        dropped = self.log.take("DSF", "Dp").get("Dp")
        if dropped is not None and dropped.size and dropped.max():
            self.notes.add(f"{self.path.name}: the autopilot dropped {int(dropped.max())} messages while logging")

    def _parameter_changes(self) -> Iterator[tuple[int, AutopilotParameter]]:
        table = self.log.take("PARM", "TimeUS", "Name", "Value")
        if not table:
            return
        for t_us, name, value in zip(table["TimeUS"].tolist(), table["Name"], table["Value"].tolist(), strict=True):
            text = name.decode("ascii", "replace")
            if text.startswith(PARAMETER_PREFIXES) and math.isfinite(value):
                yield t_us * 1000, AutopilotParameter(text, value, t_us * 1000)

    def _states(self) -> Iterator[tuple[int, VehicleState]]:
        attitude = self.log.take("ATT", "TimeUS", "Roll", "Pitch", "Yaw")
        if not attitude:
            return
        t_us = attitude["TimeUS"].astype(np.int64)
        angles = np.radians(np.column_stack([attitude[name] for name in ("Roll", "Pitch", "Yaw")]).astype(np.float64))
        airspeed = _latest(self.log, "ARSP", "Airspeed", t_us)
        climb = _latest(self.log, "BARO", "CRt", t_us)
        throttle = _latest(self.log, "CTUN", "ThO", t_us) / 100.0
        armed = _latest(self.log, "STAT", "Armed", t_us) > 0
        for i, t_ns in enumerate((t_us * 1000).tolist()):
            roll_rad, pitch_rad, yaw_rad = angles[i].tolist()
            yield (
                t_ns,
                VehicleState(
                    t_boot_ns=t_ns,
                    received_host_ns=t_ns,
                    roll_rad=roll_rad,
                    pitch_rad=pitch_rad,
                    yaw_rad=yaw_rad,
                    airspeed_mps=float(airspeed[i]),
                    climb_mps=float(climb[i]),
                    throttle=float(throttle[i]),
                    armed=bool(armed[i]),
                ),
            )


def imu_of(sensor: Sensor) -> int | None:
    """Index of the autopilot's IMU that a sensor's source names; None where it is another component's."""
    source = sensor.source
    if source.component != AUTOPILOT_COMPONENT or source.message not in _IMU_OF_MESSAGE:
        return None
    if source.message in ("RAW_IMU", "HIGHRES_IMU") and source.instance.isdigit():
        return int(source.instance)
    return _IMU_OF_MESSAGE[source.message]


def raw_accelerometer(log: DataflashLog, imu: int) -> tuple[Ints, Floats]:
    """Raw accelerometer of IMU 0, 1 or 2, unfiltered: boot ns (n,), and specific force (n, 3) in m/s^2, body FRD."""
    return _raw(log, "ACC", imu)


def _raw(log: DataflashLog, name: str, imu: int) -> tuple[Ints, Floats]:
    fields = [f"{name.capitalize()}{axis}" for axis in "XYZ"]
    table = log.take(name, "SampleUS", "I", *fields)
    if not table:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    selected = table["I"] == imu
    values = as_floats([table[field][selected] for field in fields])
    return table["SampleUS"][selected].astype(np.int64) * 1000, values


def _raw_parts(log: DataflashLog, imu: int) -> list[tuple[Axis, Ints, Floats]]:
    accel_ns, accel = _raw(log, "ACC", imu)
    gyro_ns, gyro = _raw(log, "GYR", imu)
    if np.array_equal(accel_ns, gyro_ns):
        return [(Axis.ALL, accel_ns, np.hstack([accel, gyro]))] if accel_ns.size else []
    parts = [
        (Axis.ACCEL, accel_ns, np.hstack([accel, np.zeros_like(accel)])),
        (Axis.GYRO, gyro_ns, np.hstack([np.zeros_like(gyro), gyro])),
    ]
    return [segment for segment in parts if segment[1].size]


def _filtered_parts(log: DataflashLog, imu: int) -> list[tuple[Axis, Ints, Floats]]:
    names = [f"{kind}{axis}" for kind in ("Acc", "Gyr") for axis in "XYZ"]
    table = log.take("IMU", "TimeUS", "I", *names)
    if not table or not (table["I"] == imu).any():
        return []
    selected = table["I"] == imu
    values = as_floats([table[name][selected] for name in names])
    return [(Axis.ALL, table["TimeUS"][selected].astype(np.int64) * 1000, values)]


def as_floats(columns: list[Any]) -> Floats:
    """Columns as (n, columns) float64; a not-a-number of any kind stays one, for the tracker to refuse."""
    with np.errstate(invalid="ignore"):
        return np.column_stack(columns).astype(np.float64)


def stream_in_body(source: MappedSource, parts: Sequence[tuple[Axis, Ints, Floats]]) -> InertialStream | None:
    """One stream in body axes of what was logged apart: axes, boot ns (n,), samples (n, 6); None without any sent."""
    wanted = [
        InertialStream(source.station, ClockName.BOOT, axes & source.sends, t_ns, _in_body(values, source, axes))
        for axes, t_ns, values in parts
        if axes & source.sends
    ]
    return join(wanted) if wanted else None


def _in_body(values: Floats, source: MappedSource, axes: Axis) -> Floats:
    """Turn samples (n, 6) into body axes as the airframe's source says, and zero the columns that are not sent."""
    if source.body_from_sensor is not None:
        values = np.hstack([values[:, :3] @ source.body_from_sensor.T, values[:, 3:] @ source.body_from_sensor.T])
    axis_sent = [bool((axes & source.sends) >> i & 1) for i in range(6)]
    return np.where(axis_sent, values, 0.0)


def _latest(log: DataflashLog, message: str, field: str, t_us: Ints) -> Floats:
    """Last logged value before each instant; 0 before the first, and where the log has none."""
    table = log.take(message, "TimeUS", field)
    if not table:
        return np.zeros(t_us.size)
    values = np.concatenate([[0.0], np.nan_to_num(table[field].astype(np.float64), posinf=0.0, neginf=0.0)])
    return values[np.searchsorted(table["TimeUS"].astype(np.int64), t_us, side="right")]


def _parameters(log: DataflashLog) -> dict[str, float]:
    table = log.take("PARM", "Name", "Value")
    if not table:
        return {}
    return {
        name.decode("ascii", "replace"): float(value) for name, value in zip(table["Name"], table["Value"], strict=True)
    }
