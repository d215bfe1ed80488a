"""ArduPilot .BIN logs as recordings: the raw accelerometers and gyros where they were logged, else the filtered IMU.

Everything is in the autopilot's boot clock. Raw samples (ACC, GYR) have passed no filter of ArduPilot, so the
airframe's low-pass is taken out for them, unless INS_RAW_LOG_OPT says that they were logged behind the filter; these
and IMU messages carry INS_ACCEL_FILTER and INS_GYRO_FILTER of the log's own parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.adapters.recordings.logs.dataflash import DataflashLog
from companion.adapters.recordings.logs.onboard_log import (
    FILTERED,
    RAW,
    LoggedAxes,
    OnboardLog,
    as_floats,
    latest,
    vehicle_states,
)
from companion.errors import RecordingError
from companion.params.airframe import Airframe, Sensor
from companion.params.vehicle import VEHICLE_PARAMETERS, implausible
from companion.records import AutopilotParameter, Axis, Floats, Ints, VehicleState

_BEHIND_FILTER, _BOTH = 1 << 2, 1 << 3  # bits of INS_RAW_LOG_OPT (ArduPilot)


class BinRecording(OnboardLog):
    """An ArduPilot onboard log; see :class:`OnboardLog` for the shared attributes.

    Raises
    ------
    RecordingError
        No dataflash log, or no inertial sample of any station.
    """

    def __init__(self, path: Path, airframe: Airframe) -> None:
        super().__init__(path, airframe)
        self.log = DataflashLog(path)
        self._parameters = _parameters(self.log)
        self.find_streams()
        if not self.streams:
            raise RecordingError(f"{path}: no ACC, GYR or IMU message of any station of '{airframe.name}'")
        self._say_what_is_wrong()

    def imu_samples(self, imu: int) -> tuple[str, list[LoggedAxes]]:
        """The raw samples of an IMU, the filtered ones where there are none; see :class:`OnboardLog`."""
        options = int(self._parameters.get("INS_RAW_LOG_OPT", 0.0))
        raw = [] if options & _BOTH and imu >= _imus_logged_twice(self.log) else _raw_parts(self.log, imu)
        if not raw:
            return FILTERED, _filtered_parts(self.log, imu)
        return (FILTERED if options & _BEHIND_FILTER and not options & _BOTH else RAW), raw

    def lowpass_hz(self, sensor: Sensor) -> tuple[float, float]:
        """Corners of the low-passes of accelerometer and gyro in filtered samples."""
        return self._filter("ACCEL", sensor), self._filter("GYRO", sensor)

    def _filter(self, kind: str, sensor: Sensor) -> float:
        """The low-pass as logged; what was not, or cannot be, is said, and the airframe's taken."""
        name = f"INS_{kind}_FILTER"
        logged_hz = self._parameters.get(name)
        why = f"{name} is not in the log: the airframe's low-pass is taken out" if logged_hz is None else None
        why = why or implausible(name, logged_hz or 0.0)
        if logged_hz is not None and why is None:
            return logged_hz
        self.say(why or "")
        return sensor.lowpass_accel_hz if kind == "ACCEL" else sensor.lowpass_gyro_hz

    def _say_what_is_wrong(self) -> None:
        self.say_truncated(self.log.cut_bytes)
        if self.log.skipped_bytes:
            self.say(f"{self.log.skipped_bytes} bytes are no messages (damage), skipped")
        for name in self.log.misfits:
            self.say(f"the format of the messages {name} contradicts its own length (damage), they are left out")
        self.say_leaps(self.log.leaps)
        dropped = self.log.take("DSF", "Dp").get("Dp")
        if dropped is not None and dropped.size and dropped.max():
            self.say(f"the autopilot dropped {int(dropped.max())} messages while logging")

    def parameter_changes(self) -> Iterator[tuple[int, AutopilotParameter]]:
        """Parameters by their messages PARM."""
        table = self.log.take("PARM", "TimeUS", "Name", "Value")
        if not table:
            return
        for t_us, name, value in zip(table["TimeUS"].tolist(), table["Name"], table["Value"].tolist(), strict=True):
            text = name.decode("ascii", "replace")
            if text in VEHICLE_PARAMETERS and math.isfinite(value):
                yield t_us * 1000, AutopilotParameter(text, value, t_us * 1000)

    def states(self) -> Iterator[tuple[int, VehicleState]]:
        """States at every message ATT."""
        attitude = self.log.take("ATT", "TimeUS", "Roll", "Pitch", "Yaw")
        if not attitude:
            return
        t_us = attitude["TimeUS"].astype(np.int64)
        angles = np.radians(np.column_stack([attitude[name] for name in ("Roll", "Pitch", "Yaw")]).astype(np.float64))
        yield from vehicle_states(
            t_us,
            roll_rad=angles[:, 0],
            pitch_rad=angles[:, 1],
            yaw_rad=angles[:, 2],
            airspeed_mps=self._latest_of_first("ARSP", "Airspeed", t_us),
            climb_mps=self._latest_of_first("BARO", "CRt", t_us),
            throttle=self._latest("CTUN", "ThO", t_us) / 100.0,
            armed=self._latest("STAT", "Armed", t_us) > 0,
        )

    def _latest_of_first(self, message: str, field: str, t_us: Ints) -> Floats:
        """As :meth:`_latest` of the sensor that the autopilot uses (Pri), or else of the first one of several."""
        table = self.log.take(message, "TimeUS", "I", field)
        if not table:
            return self._latest(message, field, t_us)
        used = table["I"] == table.get("Pri", 0)
        return latest({"TimeUS": table["TimeUS"][used], field: table[field][used]}, "TimeUS", field, t_us)

    def _latest(self, message: str, field: str, t_us: Ints) -> Floats:
        return latest(self.log.take(message, "TimeUS", field), "TimeUS", field, t_us)


def _imus_logged_twice(log: DataflashLog) -> int:
    """Number of IMUs where each was logged before the filter and, under a number beyond all, behind it."""
    table = log.take("ACC", "SampleUS", "I") or log.take("GYR", "SampleUS", "I")
    return len(np.unique(table["I"])) // 2 if table else 0


def _raw(log: DataflashLog, name: str, imu: int) -> tuple[Ints, Floats]:
    fields = [f"{name.capitalize()}{axis}" for axis in "XYZ"]
    table = log.take(name, "SampleUS", "I", *fields)
    if not table:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    selected = table["I"] == imu
    values = as_floats([table[field][selected] for field in fields])
    return table["SampleUS"][selected].astype(np.int64) * 1000, values


def _raw_parts(log: DataflashLog, imu: int) -> list[LoggedAxes]:
    accel_ns, accel = _raw(log, "ACC", imu)
    gyro_ns, gyro = _raw(log, "GYR", imu)
    if np.array_equal(accel_ns, gyro_ns):
        return [(Axis.ALL, accel_ns, np.hstack([accel, gyro]))] if accel_ns.size else []
    parts = [
        (Axis.ACCEL, accel_ns, np.hstack([accel, np.zeros_like(accel)])),
        (Axis.GYRO, gyro_ns, np.hstack([np.zeros_like(gyro), gyro])),
    ]
    return [segment for segment in parts if segment[1].size]


def _filtered_parts(log: DataflashLog, imu: int) -> list[LoggedAxes]:
    names = [f"{kind}{axis}" for kind in ("Acc", "Gyr") for axis in "XYZ"]
    table = log.take("IMU", "TimeUS", "I", *names)
    if not table or not (table["I"] == imu).any():
        return []
    selected = table["I"] == imu
    values = as_floats([table[name][selected] for name in names])
    return [(Axis.ALL, table["TimeUS"][selected].astype(np.int64) * 1000, values)]


def _parameters(log: DataflashLog) -> dict[str, float]:
    table = log.take("PARM", "Name", "Value")
    if not table:
        return {}
    return {
        name.decode("ascii", "replace"): float(value) for name, value in zip(table["Name"], table["Value"], strict=True)
    }
