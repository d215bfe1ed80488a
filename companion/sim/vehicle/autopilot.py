"""The simulated autopilot: ArduPlane's behaviour on the link, as measured on ArduPlane 4.7.0-dev in SITL.

No sockets and no clock inside: :mod:`companion.sim.vehicle.world` tells it the time and carries its frames. It runs in
ticks of its main loop; what arrives is handled at the next tick, what it streams is stamped with the instant of
sending.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.airframe import Airframe
from companion.records import Floats, Station
from companion.sim.flight.flight import Flight
from companion.sim.flight.sensors import BackendImu
from companion.sim.vehicle.command_protocol import PERIODS_MS, CommandProtocol
from companion.sim.vehicle.faults import Faults, boot_origin_ns
from companion.sim.vehicle.mission_protocol import to_wire
from companion.sim.vehicle.proximity import Proximity
from companion.sim.vehicle.received import Received
from companion.sim.vehicle.vehicle_parameters import VehicleParameters, addressed_to_autopilot, default_parameters
from companion.sim.vehicle.wire import AUTOPILOT_ID, FrameSender, inertial_format, message_name, payloads, stamped

_NS = 1_000_000_000  # by definition: nanoseconds of a second
_TIMESYNC_NS = 10 * _NS  # convention: ArduPilot asks every ten seconds
_PARAMETER_MESSAGES = ("PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_SET")
_DEFAULT_MS = {"ATTITUDE": 100, "VFR_HUD": 250, "GLOBAL_POSITION_INT": 250, "RAW_IMU": 250, "GPS_RAW_INT": 1000}
_ECHO_MS = {"RANGEFINDER": 250, "DISTANCE_SENSOR": 250}  # while the rangefinder has data
_MAVLINK_PROXIMITY = 2  # ArduPilot's PRX1_TYPE of the MAVLink driver
_IMU_STATIONS = {"HIGHRES_IMU": Station.ROOT, "RAW_IMU": Station.ROOT, "SCALED_IMU": Station.ROOT}

Trigger = Callable[[int], None]
"""Told the boot time in ns at which the camera line rises."""


@dataclass(slots=True)
class Interval:
    """A granted stream."""

    period_ms: int
    next_ns: int


class SimAutopilot:
    """The vehicle's side of the link, component 1."""

    _kind = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA

    def __init__(
        self,
        flight: Flight,
        faults: Faults,
        parameters: Mapping[str, float] | None = None,
        on_trigger: Trigger | None = None,
        protocol: CommandProtocol | None = None,
    ) -> None:
        self.parameters = self._default_parameters(flight.real.actual, parameters or {})
        self.received = self._receiver(flight.real.actual)
        self.sender = FrameSender(AUTOPILOT_ID)
        self.granted: dict[str, int] = {}
        self.commands: list[tuple[int, int, int]] = []
        self._flight = flight
        self._faults = faults
        self.on_trigger = on_trigger
        self.protocol = protocol
        self._rng = flight.generator("autopilot")
        self._navigation = flight.navigation_error()
        self._inbox: deque[tuple[Any, int, int]] = deque()
        self._outbox: deque[tuple[int, bytes]] = deque()
        self._last_sent_ns = 0
        self._tick_ns = 0
        self._origin_ns = 0
        self._shots = 0
        self._components: set[int] = {AUTOPILOT_ID, *(s.sensor.source.component for s in flight.nodes.values())}
        self._imus = {imu.sensor.source.message: imu for imu in flight.backends.values()}
        self._packed: dict[str, list[bytes]] = {}
        self._streams: dict[str, Interval] = {}
        self._start()

    def _default_parameters(self, airframe: Airframe, changed: Mapping[str, float]) -> VehicleParameters:
        return VehicleParameters({**default_parameters(airframe), **changed})

    def _receiver(self, airframe: Airframe) -> Received:
        """Receiver of ranges, as the parameters say at the start."""
        del airframe
        get = self.parameters.get
        received = Received(int(get("RNGFND1_ORIENT")), get("RNGFND1_MIN"), get("RNGFND1_MAX"))
        if get("PRX1_TYPE") == _MAVLINK_PROXIMITY:
            received.proximity = Proximity()
        return received

    # ------------------------------------------------------------------------------------------ time

    def _loop_ns(self) -> int:
        return round(_NS / self.parameters.get("SCHED_LOOP_RATE"))

    def advance(self, now_boot_ns: int) -> list[bytes]:
        """Run the loop up to now and give the frames whose instant has come; times are flight times in ns."""
        loop_ns = self._loop_ns()
        while self._tick_ns + loop_ns <= now_boot_ns:
            self._tick_ns += loop_ns
            self._tick(self._tick_ns)
        frames = []
        while self._outbox and self._outbox[0][0] <= now_boot_ns:
            frames.append(self._outbox.popleft()[1])
        return frames

    def greeting(self) -> bytes:
        """A heartbeat out of turn, while the flight has not begun."""
        return self.sender.message(self._heartbeat())

    def receive(self, message: Any, now_boot_ns: int, host_ns: int) -> None:
        """Take a message in; it is handled at the first tick from now on, never at an earlier one."""
        self._inbox.append((message, now_boot_ns, host_ns))

    def _tick(self, tick_ns: int) -> None:
        t_s = tick_ns * 1e-9
        origin = boot_origin_ns(self._faults, tick_ns)
        if origin != self._origin_ns:
            self._origin_ns = origin
            self._outbox.clear()
            self.parameters.reboot()
            self._start()
        silent = self._faults.silent(AUTOPILOT_ID, t_s)
        said = self.protocol.advance(tick_ns) if self.protocol else []
        while self._inbox and self._inbox[0][1] <= tick_ns:
            message, _, host_ns = self._inbox.popleft()
            if not silent:
                self._handle(message, tick_ns, host_ns)
        if silent:
            return
        for message in (*self.parameters.listed(), *said):
            self._send(message, tick_ns)
        self.received.expire(tick_ns)
        self._stream(tick_ns, self._faults.stopped(AUTOPILOT_ID, t_s))

    def _start(self) -> None:
        """Boot: default streams, filters from the parameters."""
        now = self._tick_ns
        self._streams = {name: Interval(period, now) for name, period in {**_DEFAULT_MS, **_ECHO_MS}.items()}
        if self.protocol:
            self._streams.update({name: Interval(period, now) for name, period in PERIODS_MS.items()})
        self._streams["HEARTBEAT"] = Interval(1000, now)
        self._streams["TIMESYNC"] = Interval(_TIMESYNC_NS // 1_000_000, now + _NS)
        self._packed = {name: self._pack(name, imu) for name, imu in self._imus.items()}

    # ------------------------------------------------------------------------------------------ streams

    def _stream(self, tick_ns: int, inertial_stopped: bool) -> None:
        late = self._loop_ns() if self._rng.random() < 1 / 3000 else 0
        for name, interval in self._streams.items():
            if not self._due(name, interval, tick_ns):
                continue
            period_ns = interval.period_ms * 1_000_000
            interval.next_ns += period_ns
            if interval.next_ns <= tick_ns:
                interval.next_ns = tick_ns + period_ns
            if (self._is_inertial(name) and inertial_stopped) or (
                name in _ECHO_MS and not self.received.has_range_data
            ):
                continue
            sent_ns = self._instant(tick_ns + late + 100_000 + int(self._rng.exponential(50_000.0)))
            self._post(sent_ns, self._frame(name, tick_ns, sent_ns))

    def _due(self, name: str, interval: Interval, tick_ns: int) -> bool:
        del name
        return tick_ns >= interval.next_ns

    def _is_inertial(self, name: str) -> bool:
        return name in _IMU_STATIONS or name in self._imus

    def _frame(self, name: str, tick_ns: int, sent_ns: int) -> bytes:
        if self._is_inertial(name):
            return self._inertial(name, tick_ns, sent_ns)
        boot_ns = sent_ns - self._origin_ns
        if name == "HEARTBEAT":
            return self.sender.message(self._heartbeat())
        if name == "TIMESYNC":
            return self.sender.message(mavlink.MAVLink_timesync_message(tc1=0, ts1=boot_ns))
        if name in _ECHO_MS:
            return self.sender.message(self._echo(name, boot_ns // 1_000_000))
        if self.protocol and self.protocol.tells(name):
            return self.sender.message(self.protocol.telemetry(name, boot_ns // 1_000_000))
        return self.sender.message(self._motion(name, sent_ns, boot_ns // 1_000_000))

    def _inertial(self, name: str, tick_ns: int, sent_ns: int) -> bytes:
        imu = self._imus.get(name) or self._flight.backends[_IMU_STATIONS[name]]
        packed = self._packed.get(name)
        if packed is None:
            packed = self._packed[name] = self._pack(name, imu)
        form = inertial_format(name)
        rest = packed[min(tick_ns // 1_000_000, len(packed) - 1)]
        if name == "HIGHRES_IMU" and self._faults.broken(AUTOPILOT_ID, tick_ns * 1e-9):
            rest = rest[:8] + struct.pack("<f", float("nan")) + rest[12:]
        return self.sender.raw(form.kind, stamped(form, sent_ns - self._origin_ns, rest))

    def _pack(self, name: str, imu: BackendImu) -> list[bytes]:
        """Filter and pack the whole flight of one IMU, anew whenever a filter parameter changes."""
        filters = (self.parameters.get("INS_ACCEL_FILTER"), self.parameters.get("INS_GYRO_FILTER"))
        values: Floats = imu.filtered(*filters)
        source = imu.sensor.source
        if source.message != name:
            return inertial_format(name).pack(values, 0)
        return payloads(values, source)

    def _echo(self, name: str, boot_ms: int) -> Any:
        """Rangefinder reading, as ArduPilot repeats it to everyone."""
        last = self.received.rangefinder
        assert last is not None
        if name == "RANGEFINDER":
            return mavlink.MAVLink_rangefinder_message(last.distance_m, 0.0)
        limits = (round(100 * self.received.min_m), round(100 * self.received.max_m))
        return mavlink.MAVLink_distance_sensor_message(
            boot_ms, *limits, round(100 * last.distance_m), 0, 0, last.orientation, 0, signal_quality=last.quality
        )

    def _motion(self, name: str, sent_ns: int, boot_ms: int) -> Any:
        truth = self._flight.truth.series(np.array([sent_ns], dtype=np.int64))
        roll, pitch, yaw = (truth.euler_rad[0] + self._navigation.euler_rad).tolist()
        yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
        north, east, down = truth.position_ned_m[0].tolist()
        vd = float(truth.velocity_ned_mps[0, 2])
        told_mps = truth.velocity_ned_mps + self._navigation.ned_mps(np.array([1e-9 * sent_ns]))
        if name == "ATTITUDE":
            return mavlink.MAVLink_attitude_message(boot_ms, roll, pitch, yaw, *truth.body_rate_radps[0].tolist())
        heading = np.degrees(yaw) % 360.0
        if name == "VFR_HUD":
            speed = self._flight.plan.airspeed_mps
            return mavlink.MAVLink_vfr_hud_message(speed, speed, int(heading), 60, -down, -vd)
        place = (*to_wire(north, east), int(-down * 1000))
        if name == "GPS_RAW_INT":
            return self._receiver_message(1000 * boot_ms, place, told_mps[0])
        return mavlink.MAVLink_global_position_int_message(
            boot_ms, *place, int(-down * 1000), *np.rint(100.0 * told_mps[0]).astype(int).tolist(), int(heading * 100)
        )

    def _receiver_message(self, t_us: int, place: tuple[int, int, int], ned_mps: Floats) -> Any:
        """The satellite receiver's own words: fix, place, speed and course, and its accuracy of speed."""
        course = np.degrees(np.arctan2(ned_mps[1], ned_mps[0])) % 360.0
        speed_cmps = int(100.0 * np.hypot(ned_mps[0], ned_mps[1]))
        stated_mmps = round(1000.0 * self._flight.world.velocity_mps)
        return mavlink.MAVLink_gps_raw_int_message(
            t_us, mavlink.GPS_FIX_TYPE_3D_FIX, *place, 80, 120, speed_cmps, int(100.0 * course), 14, vel_acc=stated_mmps
        )

    # ------------------------------------------------------------------------------------------ messages

    def _handle(self, message: Any, tick_ns: int, host_ns: int) -> None:
        name = message.get_type()
        self._components.add(message.get_srcComponent())
        self.received.take(message, tick_ns, host_ns)
        if name == "TIMESYNC":
            if message.tc1 == 0:
                sent_ns = self._instant(tick_ns + 50_000 + int(self._rng.exponential(100_000.0)))
                answer = mavlink.MAVLink_timesync_message(tc1=tick_ns + 20_000 - self._origin_ns, ts1=message.ts1)
                self._post(sent_ns, self.sender.message(answer))
        elif not addressed_to_autopilot(message, tuple(self._components)):
            return
        elif name in _PARAMETER_MESSAGES:
            for answer in self.parameters.receive(message):
                self._send(answer, tick_ns)
            if self.parameters.changed & {"INS_ACCEL_FILTER", "INS_GYRO_FILTER"}:
                self._packed.clear()
            self.parameters.changed.clear()
        elif self.protocol and (answers := self.protocol.receive(message, tick_ns)) is not None:
            for answer in answers:
                self._send(answer, tick_ns)
        elif name in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(message, tick_ns)

    def _command(self, message: Any, tick_ns: int) -> None:
        self.commands.append((tick_ns, message.command, message.get_srcComponent()))
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            if math.isfinite(message.param1) and math.isfinite(message.param2):
                result = self._set_interval(int(message.param1), int(message.param2), tick_ns)
            else:
                result = mavlink.MAV_RESULT_DENIED
        elif message.command == mavlink.MAV_CMD_IMAGE_START_CAPTURE:
            result = self._capture(tick_ns)
        elif message.command == mavlink.MAV_CMD_DO_DIGICAM_CONTROL:
            self._capture(tick_ns)
            result = mavlink.MAV_RESULT_ACCEPTED
        else:
            result = mavlink.MAV_RESULT_UNSUPPORTED
        self._acknowledge(message, result, tick_ns)

    def _acknowledge(self, message: Any, result: int, tick_ns: int) -> None:
        acknowledgement = mavlink.MAVLink_command_ack_message(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        self._send(acknowledgement, tick_ns)

    def _set_interval(self, number: int, interval_us: int, tick_ns: int) -> int:
        """Whole milliseconds, not faster than 0.8 of the loop rate: ArduPilot's GCS_MAVLINK::set_message_interval."""
        name = message_name(number)
        sends = name in _DEFAULT_MS or (self.protocol is not None and self.protocol.tells(name))
        if not sends and name not in _IMU_STATIONS and name not in self._imus:
            return int(mavlink.MAV_RESULT_FAILED)
        if interval_us < 0:
            self._streams.pop(name, None)
            self.granted.pop(name, None)
            return int(mavlink.MAV_RESULT_ACCEPTED)
        period_ms = max(interval_us // 1000, 1) if interval_us else _DEFAULT_MS.get(name, 250)
        if period_ms < int(1e6 / self.parameters.get("SCHED_LOOP_RATE")) // 800:
            text = f"Mav rate for msg {number} too fast"
            self._send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_WARNING, text.encode()), tick_ns)
            return int(mavlink.MAV_RESULT_DENIED)
        self._streams[name] = Interval(period_ms, tick_ns)
        self.granted[name] = period_ms
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _capture(self, tick_ns: int) -> int:
        if self._flight.airframe.left_camera is None:
            return int(mavlink.MAV_RESULT_FAILED)
        if self.on_trigger is not None:
            self.on_trigger(tick_ns)
        self._shots += 1
        for camera in (0, 1):
            feedback = mavlink.MAVLink_camera_feedback_message(
                (tick_ns - self._origin_ns) // 1000, 0, camera, self._shots, 0, 0, 0, 0, 0, 0, 0, 0, 0, self._shots
            )
            self._send(feedback, tick_ns)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    # ------------------------------------------------------------------------------------------ sending

    def _send(self, message: Any, tick_ns: int) -> None:
        self._post(self._instant(tick_ns + 50_000), self.sender.message(message))

    def _instant(self, sent_ns: int) -> int:
        """A frame leaves after the one before it."""
        self._last_sent_ns = max(sent_ns, self._last_sent_ns)
        return self._last_sent_ns

    def _post(self, sent_ns: int, frame: bytes) -> None:
        self._outbox.append((sent_ns, frame))

    def _heartbeat(self) -> Any:
        if self.protocol:
            return self.protocol.heartbeat()
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_FIXED_WING,
            self._kind,
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED,
            10,
            mavlink.MAV_STATE_STANDBY if self._on_ground() else mavlink.MAV_STATE_ACTIVE,
            3,
        )

    def _on_ground(self) -> bool:
        return any(roll.from_s <= 1e-9 * self._tick_ns < roll.until_s for roll in self._flight.plan.rolls_on_ground)
