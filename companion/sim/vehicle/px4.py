"""The simulated autopilot with PX4's habits on the link, where they differ from ArduPilot's.

After PX4's sources (src/modules/mavlink, src/modules/sensors/vehicle_imu, src/drivers/camera_trigger): inertial
messages are means over the integration interval of IMU_INTEG_RATE, stamped with the interval's end; a rate beyond that
is granted and not delivered; TIMESYNC is answered when it arrives, and asked ten times a second; whole-number
parameters travel as the bytes of an int32; the camera trigger knows DO_DIGICAM_CONTROL and looks for it twenty times a
second.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.airframe import Airframe
from companion.records import Floats
from companion.sim.flight.sensors import BACKEND_HZ, BackendImu
from companion.sim.vehicle.autopilot import Interval, SimAutopilot
from companion.sim.vehicle.received import Received
from companion.sim.vehicle.vehicle_parameters import VehicleParameters
from companion.sim.vehicle.wire import inertial_format, message_name, payloads, stamped

_TICK_NS = 1_000_000  # chosen: fine enough for every integration interval of PX4
_TIMESYNC_MS = 100  # convention: PX4 asks ten times a second
_ONBOARD_MS = 20  # convention: PX4's onboard stream sends HIGHRES_IMU at 50 Hz
_FARTHEST_M = 655.34  # convention: largest current_distance that is a distance, uint16 in cm (MAVLink common.xml)
_TRIGGER_POLL_NS = 50_000_000  # convention: PX4's camera_trigger looks twenty times a second
_INTEGERS = ("IMU_INTEG_RATE", "MAV_SYS_ID", "EKF2_RNG_CTRL")
_UNSUPPORTED = (mavlink.MAV_CMD_IMAGE_START_CAPTURE, mavlink.MAV_CMD_DO_REPEAT_RELAY, mavlink.MAV_CMD_DO_REPEAT_SERVO)


def px4_parameters() -> dict[str, float]:
    """PX4's defaults of what matters here."""
    return {
        "MAV_SYS_ID": 1.0,
        "IMU_INTEG_RATE": 200.0,
        "IMU_ACCEL_CUTOFF": 30.0,
        "IMU_GYRO_CUTOFF": 40.0,
        "EKF2_RNG_CTRL": 1.0,
    }


class Px4Parameters(VehicleParameters):
    """Whole numbers as the bytes of an int32; a PARAM_SET of another type than the parameter's is not taken."""

    reboot_required = frozenset({"IMU_INTEG_RATE", "MAV_SYS_ID"})

    def _set(self, message: Any) -> bool:
        integer = message.param_id in _INTEGERS
        if message.param_type != (mavlink.MAV_PARAM_TYPE_INT32 if integer else mavlink.MAV_PARAM_TYPE_REAL32):
            return False
        value = message.param_value
        self.change(message.param_id, float(struct.unpack("<i", struct.pack("<f", value))[0]) if integer else value)
        return True

    def _encoded(self, name: str, value: float) -> tuple[float, int]:
        if name in _INTEGERS:
            return struct.unpack("<f", struct.pack("<i", round(value)))[0], mavlink.MAV_PARAM_TYPE_INT32
        return value, mavlink.MAV_PARAM_TYPE_REAL32


class SimPx4(SimAutopilot):
    """The vehicle's side of the link, as PX4."""

    _kind = mavlink.MAV_AUTOPILOT_PX4
    _single_shot = False

    def _default_parameters(self, airframe: Airframe, changed: Mapping[str, float]) -> VehicleParameters:
        del airframe
        return Px4Parameters({**px4_parameters(), **changed})

    def _receiver(self, airframe: Airframe) -> Received:
        """Any distance is taken with the limits that it comes with."""
        return Received(airframe.orientation, 0.0, _FARTHEST_M)

    def _loop_ns(self) -> int:
        return _TICK_NS

    def _start(self) -> None:
        super()._start()
        del self._streams["RAW_IMU"]  # PX4 has none
        self._streams["HIGHRES_IMU"] = Interval(_ONBOARD_MS, self._tick_ns)
        self._streams["TIMESYNC"] = Interval(_TIMESYNC_MS, self._tick_ns + 1_000_000_000)
        self._offered_ms = {name: interval.period_ms for name, interval in self._streams.items()}
        self._sent_windows: dict[str, int] = {}

    def receive(self, message: Any, now_boot_ns: int, host_ns: int) -> None:
        """Answer TIMESYNC at once, from the receiving thread; leave the rest to the loop."""
        if message.get_type() == "TIMESYNC" and message.tc1 == 0:
            if not self._faults.silent(self.sender.component, now_boot_ns * 1e-9):
                read_ns = now_boot_ns + int(self._rng.exponential(100_000.0))
                answer = mavlink.MAVLink_timesync_message(tc1=read_ns - self._origin_ns, ts1=message.ts1)
                self._post(self._instant(read_ns + 50_000), self.sender.message(answer))
            return
        super().receive(message, now_boot_ns, host_ns)

    def _tick(self, tick_ns: int) -> None:
        super()._tick(tick_ns)
        if self._single_shot and tick_ns % _TRIGGER_POLL_NS < _TICK_NS:
            self._single_shot = False
            if self.on_trigger is not None:
                self.on_trigger(tick_ns)

    # ------------------------------------------------------------------------------------------ streams

    @property
    def _window_ns(self) -> int:
        return round(1e9 / self.parameters.get("IMU_INTEG_RATE"))

    def _due(self, name: str, interval: Interval, tick_ns: int) -> bool:
        """An inertial message needs a new mean as well."""
        if tick_ns < interval.next_ns:
            return False
        if not self._is_inertial(name):
            return True
        window = tick_ns // self._window_ns
        # a window that ended before this boot is none of its own
        if self._sent_windows.get(name) == window or window * self._window_ns < self._origin_ns:
            return False
        self._sent_windows[name] = window
        return True

    def _inertial(self, name: str, tick_ns: int, sent_ns: int) -> bytes:
        del sent_ns
        form, packed = inertial_format(name), self._packed[name]
        window = min(tick_ns // self._window_ns, len(packed) - 1)
        return self.sender.raw(form.kind, stamped(form, window * self._window_ns - self._origin_ns, packed[window]))

    def _pack(self, name: str, imu: BackendImu) -> list[bytes]:
        """Means over the integration intervals; row k is of the interval that ends at k."""
        del name
        return payloads(interval_means(imu.filtered(0.0, 0.0), self._window_ns), imu.sensor.source)

    # ------------------------------------------------------------------------------------------ commands

    def _command(self, message: Any, tick_ns: int) -> None:
        fires = message.command == mavlink.MAV_CMD_DO_DIGICAM_CONTROL
        if not fires and message.command not in _UNSUPPORTED:
            super()._command(message, tick_ns)
            return
        self.commands.append((tick_ns, message.command, message.get_srcComponent()))
        if fires:
            self._single_shot = message.param5 == 1.0
        result = mavlink.MAV_RESULT_ACCEPTED if fires else mavlink.MAV_RESULT_UNSUPPORTED
        self._acknowledge(message, result, tick_ns)

    def _set_interval(self, number: int, interval_us: int, tick_ns: int) -> int:
        """Whatever there is a stream of is granted; below 0 it ends, 0 is its rate of the start."""
        name = message_name(number)
        if name not in self._offered_ms and name not in self._imus:
            return int(mavlink.MAV_RESULT_FAILED)
        if interval_us < 0:
            self._streams.pop(name, None)
            self.granted.pop(name, None)
            return int(mavlink.MAV_RESULT_ACCEPTED)
        period_ms = max(round(interval_us / 1000), 1) if interval_us else self._offered_ms.get(name, _ONBOARD_MS)
        self._streams[name] = Interval(period_ms, tick_ns)
        self.granted[name] = period_ms
        return int(mavlink.MAV_RESULT_ACCEPTED)


def interval_means(values: Floats, window_ns: int) -> Floats:
    """Trapezoidal means (n, 6) of samples at the backend's rate over intervals that end at multiples of the window."""
    steps = np.zeros_like(values)
    steps[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]), axis=0)
    sample_ns = 1e9 / BACKEND_HZ
    ends = np.minimum((np.arange(int(len(values) * sample_ns // window_ns)) * window_ns / sample_ns), len(values) - 1)
    at = np.stack([np.interp(ends, np.arange(len(values)), steps[:, axis]) for axis in range(values.shape[1])], axis=1)
    means = np.empty_like(at)
    means[1:] = np.diff(at, axis=0) * sample_ns / window_ns
    means[0] = values[0]
    return means
