"""Flight commands, modes and telemetry between a ground station and the simulated autopilot."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.sim.vehicle.mission_protocol import MissionServer, from_wire, to_wire
from companion.sim.vehicle.scripted_pilot import HOME_AMSL_M, FlightMode, ScriptedPilot
from companion.sim.vehicle.wire import message_name

PERIODS_MS = {
    "SYS_STATUS": 500,
    "MISSION_CURRENT": 500,
    "GPS_RAW_INT": 500,
    "BATTERY_STATUS": 1000,
    "EXTENDED_SYS_STATE": 1000,
    "HOME_POSITION": 2000,
}
"""Streams that a vehicle with a pilot sends besides the others."""
_MOTION = ("ATTITUDE", "VFR_HUD", "GLOBAL_POSITION_INT")
_STEP_NS = 20_000_000  # chosen: ArduPlane's main loop at its default 50 Hz
_CELL_MV, _CELLS = 3800, 4  # chosen: a four-cell lithium battery that is half full
_ACCEPTED, _DENIED, _FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED


class CommandProtocol:
    """The flying side of the autopilot: a :class:`ScriptedPilot`, its mission, and the messages of both."""

    def __init__(self, height_m: float, speed: float = 1.0) -> None:
        self.pilot = ScriptedPilot(height_m)
        self.missions = MissionServer(self.pilot, speed)
        self.commands: list[tuple[int, int]] = []
        self._stepped_ns = 0

    @property
    def flown_ns(self) -> int:
        """Boot time up to which the pilot has flown."""
        return self._stepped_ns

    # ------------------------------------------------------------------------------------------ from the ground

    def receive(self, message: Any, now_ns: int) -> list[Any] | None:
        """Answer a message about flying; None if it is about something else."""
        name = message.get_type()
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            return self._command(message, now_ns)
        if name == "SET_MODE":
            self.pilot.set_mode(message.custom_mode)
            return []
        if name == "SET_ATTITUDE_TARGET":
            self._attitude(message)
            return []
        return self.missions.receive(message, now_ns)

    def _command(self, message: Any, now_ns: int) -> list[Any] | None:
        handler = _HANDLERS.get(message.command)
        if handler is None:
            return None
        self.commands.append((now_ns, message.command))
        try:
            answers = handler(self, message)
        except (ValueError, OverflowError):  # a parameter that is no number
            answers = [_DENIED]
        result = answers.pop(0)
        peer = (message.get_srcSystem(), message.get_srcComponent())
        return [mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *peer), *answers]

    def _arm(self, message: Any) -> list[Any]:
        return [_ACCEPTED if self.pilot.arm(message.param1 > 0.5) else _FAILED]

    def _mode(self, message: Any) -> list[Any]:
        return [_ACCEPTED if self.pilot.set_mode(int(message.param2)) else _DENIED]

    def _change_to(self, mode: FlightMode) -> list[Any]:
        self.pilot.set_mode(mode)
        return [_ACCEPTED]

    def _start(self, _message: Any) -> list[Any]:
        return [_ACCEPTED if len(self.pilot.items) > 1 and self.pilot.set_mode(FlightMode.AUTO) else _FAILED]

    def _select(self, message: Any) -> list[Any]:
        return [_ACCEPTED if self.pilot.select(int(message.param1)) else _FAILED, self.missions.current()]

    def _speed(self, message: Any) -> list[Any]:
        return [_ACCEPTED if self.pilot.change_speed(message.param1, message.param2) else _FAILED]

    def _reposition(self, message: Any) -> list[Any]:
        """COMMAND_INT only, as ArduPlane; bit 0 of param2 changes to GUIDED."""
        if message.get_type() != "COMMAND_INT" or not math.isfinite(message.z):
            return [_DENIED]
        if int(message.param2) & 1:
            self.pilot.set_mode(FlightMode.GUIDED)
        if self.pilot.mode is not FlightMode.GUIDED:
            return [_DENIED]
        above_sea = message.frame in (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
        self.pilot.set_goal(*from_wire(message.x, message.y), message.z - (HOME_AMSL_M if above_sea else 0.0))
        return [_ACCEPTED]

    def _request(self, message: Any) -> list[Any]:
        """REQUEST_MESSAGE for what can be told here."""
        name = message_name(int(message.param1))
        if name == "AUTOPILOT_VERSION":
            return [_ACCEPTED, _version()]
        if name in PERIODS_MS or name in _MOTION:
            return [_ACCEPTED, self.telemetry(name, self._stepped_ns // 1_000_000)]
        return [_FAILED]

    def _attitude(self, message: Any) -> None:
        """Roll and pitch from the quaternion, where the attitude bit or those of their rates say so (as ArduPlane)."""
        used = ~message.type_mask & 0xFF
        w, x, y, z = message.q
        if not all(math.isfinite(entry) for entry in message.q):
            return
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
        self.pilot.force(roll if used & 0b10000001 else None, pitch if used & 0b10000010 else None)

    # ------------------------------------------------------------------------------------------ to the ground

    def advance(self, now_ns: int) -> list[Any]:
        """Fly up to now; give what is to be said unasked."""
        while self._stepped_ns + _STEP_NS <= now_ns:
            self._stepped_ns += _STEP_NS
            self.pilot.step(_STEP_NS * 1e-9)
        out = self.missions.advance(now_ns)
        while self.pilot.reached:
            out.append(mavlink.MAVLink_mission_item_reached_message(self.pilot.reached.popleft()))
        while self.pilot.texts:
            text = self.pilot.texts.popleft()[:50].encode()
            out.append(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_INFO, text))
        return out

    def heartbeat(self) -> Any:
        """HEARTBEAT with the mode and the arming state."""
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self.pilot.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        flying = mavlink.MAV_STATE_ACTIVE if self.pilot.armed else mavlink.MAV_STATE_STANDBY
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, self.pilot.mode, flying, 3
        )

    def tells(self, name: str) -> bool:
        """Whether a stream is told by the pilot."""
        return name in PERIODS_MS or name in _MOTION

    def telemetry(self, name: str, boot_ms: int) -> Any:
        """One message of a stream."""
        return getattr(self, f"_encode_{name.lower()}")(boot_ms)

    def _encode_attitude(self, boot_ms: int) -> Any:
        p = self.pilot
        yaw = (p.course_rad + math.pi) % math.tau - math.pi
        return mavlink.MAVLink_attitude_message(boot_ms, p.roll_rad, p.pitch_rad, yaw, 0.0, 0.0, 0.0)

    def _encode_vfr_hud(self, boot_ms: int) -> Any:
        del boot_ms
        p = self.pilot
        heading = int(math.degrees(p.course_rad)) % 360
        return mavlink.MAVLink_vfr_hud_message(
            p.airspeed_mps, math.hypot(*p.over_ground_mps), heading, 60, p.height_m + HOME_AMSL_M, p.climb_mps
        )

    def _encode_global_position_int(self, boot_ms: int) -> Any:
        p = self.pilot
        north, east = p.over_ground_mps
        return mavlink.MAVLink_global_position_int_message(
            boot_ms,
            *to_wire(p.north_m, p.east_m),
            int((p.height_m + HOME_AMSL_M) * 1000),
            int(p.height_m * 1000),
            int(north * 100),
            int(east * 100),
            int(-p.climb_mps * 100),
            int(math.degrees(p.course_rad) * 100) % 36000,
        )

    def _encode_gps_raw_int(self, boot_ms: int) -> Any:
        p = self.pilot
        north, east = p.over_ground_mps
        speed, course = int(math.hypot(north, east) * 100), math.degrees(math.atan2(east, north)) % 360.0
        altitude = int((p.height_m + HOME_AMSL_M) * 1000)
        return mavlink.MAVLink_gps_raw_int_message(
            boot_ms * 1000, 4, *to_wire(p.north_m, p.east_m), altitude, 80, 80, speed, int(course * 100), 16
        )

    def _encode_sys_status(self, boot_ms: int) -> Any:
        del boot_ms
        remaining_percent = round(100 * self.pilot.battery)
        return mavlink.MAVLink_sys_status_message(
            0, 0, 0, 300, _CELL_MV * _CELLS, 800, remaining_percent, 0, 0, 0, 0, 0, 0
        )

    def _encode_battery_status(self, boot_ms: int) -> Any:
        del boot_ms
        cells = [_CELL_MV] * _CELLS + [65535] * (10 - _CELLS)
        remaining_percent = round(100 * self.pilot.battery)
        return mavlink.MAVLink_battery_status_message(0, 0, 0, 2500, cells, 800, 500, -1, remaining_percent)

    def _encode_extended_sys_state(self, boot_ms: int) -> Any:
        del boot_ms
        landed = mavlink.MAV_LANDED_STATE_IN_AIR if self.pilot.airborne else mavlink.MAV_LANDED_STATE_ON_GROUND
        return mavlink.MAVLink_extended_sys_state_message(0, landed)

    def _encode_mission_current(self, boot_ms: int) -> Any:
        del boot_ms
        return self.missions.current()

    def _encode_home_position(self, boot_ms: int) -> Any:
        del boot_ms
        level = [1.0, 0.0, 0.0, 0.0]
        return mavlink.MAVLink_home_position_message(
            *to_wire(0.0, 0.0), int(HOME_AMSL_M * 1000), 0.0, 0.0, 0.0, level, 0.0, 0.0, 0.0
        )


_HANDLERS: dict[int, Callable[[CommandProtocol, Any], list[Any]]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: CommandProtocol._arm,
    mavlink.MAV_CMD_DO_SET_MODE: CommandProtocol._mode,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda protocol, _: protocol._change_to(FlightMode.RTL),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda protocol, _: protocol._change_to(FlightMode.LOITER),
    mavlink.MAV_CMD_MISSION_START: CommandProtocol._start,
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: CommandProtocol._select,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: CommandProtocol._speed,
    mavlink.MAV_CMD_DO_REPOSITION: CommandProtocol._reposition,
    mavlink.MAV_CMD_REQUEST_MESSAGE: CommandProtocol._request,
}


def _version() -> Any:
    able = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(able, 0x040700FF, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0)
