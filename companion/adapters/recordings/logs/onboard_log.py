"""Base of the readers of ArduPilot's and of PX4's logs: IMUs by number, flight state, parameters in boot time."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.mavlink.decode.source_map import AUTOPILOT_COMPONENT, MappedSource, build_mapping
from companion.adapters.recordings.recording import InertialStream, LoggedRecording, join, merge, rate_of, timed
from companion.params.airframe import Airframe, Sensor
from companion.records import AutopilotParameter, Axis, ClockName, Floats, Ints, Record, VehicleState
from companion.units import Severity

_IMU_OF_MESSAGE = {"RAW_IMU": 0, "HIGHRES_IMU": 0, "SCALED_IMU": 0, "SCALED_IMU2": 1, "SCALED_IMU3": 2}

RAW, FILTERED = "raw", "filtered"
LoggedAxes = tuple[Axis, Ints, Floats]
"""Axes that were logged together: their boot ns (n,), and samples (n, 6) in m/s^2 and rad/s, 0 in the other axes."""


class OnboardLog(LoggedRecording):
    """Base of the readers of an autopilot's own log; see :class:`LoggedRecording` for the shared attributes.

    The airframe's sources tell which IMU is which station: RAW_IMU, HIGHRES_IMU and SCALED_IMU are the first (the first
    two with ``instance``: that one), SCALED_IMU2 the second, SCALED_IMU3 the third.
    """

    condition = ""
    """Requirement that samples must meet to count, for the sentence that there are none."""

    def __init__(self, path: Path, airframe: Airframe) -> None:
        super().__init__(path, airframe, ClockName.BOOT)
        self.streams: list[InertialStream] = []

    @abstractmethod
    def imu_samples(self, imu: int) -> tuple[str, list[LoggedAxes]]:
        """The kind of an IMU's samples, ``RAW``, ``FILTERED`` or "" where a log has one alone, and the samples."""

    def lowpass_hz(self, sensor: Sensor) -> tuple[float, float]:
        """Corners of the low-passes of accelerometer and gyro in ``FILTERED`` samples: the airframe's."""
        return sensor.lowpass_accel_hz, sensor.lowpass_gyro_hz

    @abstractmethod
    def parameter_changes(self) -> Iterator[tuple[int, AutopilotParameter]]:
        """The parameters that a decoder of a link would pass on, with their boot time in ns."""

    @abstractmethod
    def states(self) -> Iterator[tuple[int, VehicleState]]:
        """The flight state at every logged attitude, with its boot time in ns."""

    def records(self) -> Iterator[Record]:
        """Parameters, flight state and samples, in order of time."""
        sources: list[Iterator[tuple[int, Record]]] = [self.parameter_changes(), self.states()]
        sources += map(timed, self.streams)
        yield from merge(*sources)

    def find_streams(self) -> None:
        """Take each station's samples out of the log, and put into the airframe how they were logged."""
        sensors: dict[str, Any] = {}
        for source in build_mapping(self.airframe).sources:
            sensor = self.airframe.sensor(source.station)
            stream, kind = self._stream(source, sensor)
            if stream is not None:
                self.streams.append(stream)
                sensors[source.station.name.lower()] = self._as_logged(sensor, stream, kind)
        self.airframe = dataclasses.replace(self.airframe, **sensors)

    def say_truncated(self, cut_bytes: int) -> None:
        """Note that the log ends in the middle of a message."""
        if cut_bytes:
            text = f"truncated: the last {cut_bytes} bytes are no whole message, left out"
            self.say(text, severity=Severity.INFO)

    def say_leaps(self, count: int) -> None:
        """Note that messages were left out whose stamps are far ahead."""
        if count:
            stamps = "stamp is" if count == 1 else "stamps are"
            self.say(f"{count} {stamps} more than 1 s ahead of the neighbours (damage), left out")

    def _stream(self, source: MappedSource, sensor: Sensor) -> tuple[InertialStream | None, str]:
        imu = imu_of(sensor)
        name = f"{self.path.name}: {source.station.name.lower()}"
        if imu is None:
            self.notes.add(f"{name}: {sensor.source.message} of component {source.component} is not in an onboard log")
            return None, ""
        kind, parts = self.imu_samples(imu)
        stream = stream_in_body(source, parts)
        if stream is None:
            self.notes.add(f"{name}: no samples of IMU {imu + 1}{self.condition} in this log")
            return None, kind
        self.notes.gaps(f"{name} (IMU {imu + 1}{', ' * bool(kind)}{kind})", stream.t_ns)
        return stream, kind

    def _as_logged(self, sensor: Sensor, stream: InertialStream, kind: str) -> Sensor:
        accel_hz, gyro_hz = self.lowpass_hz(sensor) if kind == FILTERED else (0.0, 0.0)
        return dataclasses.replace(
            sensor,
            rate_hz=rate_of(stream.t_ns, sensor.rate_hz),
            lowpass_accel_hz=accel_hz,
            lowpass_gyro_hz=gyro_hz,
            source=dataclasses.replace(sensor.source, stamp_offset_s=0.0),
        )


def imu_of(sensor: Sensor) -> int | None:
    """Index of the autopilot's IMU that a sensor's source names; None where it is another component's."""
    source = sensor.source
    if source.component != AUTOPILOT_COMPONENT or source.message not in _IMU_OF_MESSAGE:
        return None
    if source.message in ("RAW_IMU", "HIGHRES_IMU") and source.instance.isdigit():
        return int(source.instance)
    return _IMU_OF_MESSAGE[source.message]


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
    return np.where(np.isin(np.arange(6), (axes & source.sends).columns), values, 0.0)


def vehicle_states(t_us: Ints, **columns: Any) -> Iterator[tuple[int, VehicleState]]:
    """States at boot times in us (n,), of columns (n,) by the state's attributes, each with its boot time in ns."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    for t_ns, row in zip((t_us * 1000).tolist(), rows, strict=True):
        yield t_ns, VehicleState(t_boot_ns=t_ns, received_host_ns=t_ns, **dict(zip(columns, row, strict=True)))


def latest(table: dict[str, Any], time: str, field: str, t_us: Ints) -> Floats:
    """Last logged value (n,) of a field before each instant; 0 before the first, and where the table is empty."""
    if not table:
        return np.zeros(t_us.size)
    values = np.concatenate([[0.0], np.nan_to_num(table[field].astype(np.float64), posinf=0.0, neginf=0.0)])
    return values[np.searchsorted(table[time].astype(np.int64), t_us, side="right")]
