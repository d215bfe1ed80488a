"""A real ArduPlane in lock-step: it asks for a frame, gets it, and flies; station and range finder speak MAVLink.

No clock on the wall: the autopilot's time is that of the frames. It flies a mission with take-off, circuit and landing.
"""

from __future__ import annotations

import contextlib
import math
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import DeviceError
from companion.sim.landing.aerodynamics import Controls
from sitl_tests.ardupilot.flyer import TUNING
from sitl_tests.ardupilot.physics import servo_outputs
from sitl_tests.ardupilot.steered import controls_of
from sitl_tests.ardupilot.vehicle import COMMON, HOME, Ports, Vehicle

_PATIENCE_S = 20.0
_BEAT_S, _RANGE_S, _ASK_S = 0.5, 0.1, 1.0
_LATITUDE_DEG, _LONGITUDE_DEG, _HEIGHT_M, _ = (float(value) for value in HOME.split(","))
_METRES_PER_DEG = 111_319.5
_FORCE_ARM = 21196.0
_AUTO_MODE = 10.0
_READY_S = 22.0  # of boot time, when its estimator has a position

PARAMETERS: Mapping[str, float] = {
    **TUNING, **COMMON,
    "SCHED_LOOP_RATE": 250, "ARMING_SKIPCHK": -1, "SERVO_AUTO_TRIM": 0,
    "RNGFND1_ORIENT": 25, "RNGFND_LANDING": 1,
    "AIRSPEED_CRUISE": 17, "AIRSPEED_MIN": 13, "AIRSPEED_MAX": 26, "TECS_LAND_ARSPD": 17, "TRIM_THROTTLE": 40,
    "TKOFF_ROTATE_SPD": 14, "TKOFF_THR_MAX": 100, "WP_RADIUS": 40, "LAND_PITCH_DEG": 3, "LAND_DISARMDELAY": 5,
}  # fmt: skip
"""Tuning of SITL's own model aeroplane, which fits ours, and the speeds of the approach."""


class PlaneLink:
    """The running executable and its links. A context manager."""

    def __init__(self, executable: Path, folder: Path, parameters: Mapping[str, float], mission: list[Any]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        ports = Ports.free()
        values = {**PARAMETERS, **parameters}
        self._limits_m = (values["RNGFND1_MIN"], values["RNGFND1_MAX"])
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", ports.physics))
        self._socket.settimeout(_PATIENCE_S)
        station, finder = (f"udpin:127.0.0.1:{port}" for port in (ports.station, ports.service))
        self._station = mavutil.mavlink_connection(station, source_system=255, source_component=190)
        self._finder = mavutil.mavlink_connection(finder, source_system=1, source_component=191)
        self._mission = mission
        self._due_s = {"beat": 0.0, "range": 0.0, "ask": _READY_S}
        self._accepted = False
        self._range_m: float | None = None
        self.frames = 0
        self.armed = False
        self.texts: list[tuple[float, str]] = []
        self.reached = 0
        self._vehicle = Vehicle(executable, folder, ports, values, lock_step=True)

    def __enter__(self) -> PlaneLink:
        return self

    def __exit__(self, *_: object) -> None:
        self._vehicle.end()
        for link in (self._socket, self._station, self._finder):
            link.close()

    def exchange(self, line: bytes) -> Controls:
        """Give the next frame to the autopilot, which waits for it; what its servos command before it."""
        while True:
            try:
                data, peer = self._socket.recvfrom(256)
            except TimeoutError:
                self._vehicle.check()
                raise DeviceError(f"ArduPlane asks for no frame; its words: {self._vehicle.console}") from None
            servos = servo_outputs(data)
            if servos is not None:
                break
        self._socket.sendto(line, peer)
        self.frames += 1
        return controls_of(servos)

    def talk(self, t_s: float, range_m: float | None) -> None:
        """Beat, hand on a range, upload the mission and arm when it is time, and hear what is said."""
        if self._is_due("beat", t_s, _BEAT_S):
            none = mavlink.MAV_AUTOPILOT_INVALID
            self._station.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, none, 0, 0, 4)
            self._finder.mav.heartbeat_send(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, none, 0, 0, 4)
        if range_m != self._range_m or self._is_due("range", t_s, _RANGE_S):
            self._range_m = range_m
            self._say_range(t_s)
        if not self.armed and self._is_due("ask", t_s, _ASK_S):
            self._ask()
        self._hear(t_s)

    def _say_range(self, t_s: float) -> None:
        """Hand on the range, or that there is none, as Spanwise says it: one centimetre beyond the largest.

        A range finder that falls silent is believed for half a second more, in which the ground seems to stay away.
        """
        least_cm, most_cm = (round(100.0 * self._limits_m[end]) for end in (0, 1))
        distance_cm = most_cm + 1 if self._range_m is None else round(100.0 * self._range_m)
        down, kind = mavlink.MAV_SENSOR_ROTATION_PITCH_270, mavlink.MAV_DISTANCE_SENSOR_UNKNOWN
        self._finder.mav.distance_sensor_send(round(1e3 * t_s), least_cm, most_cm, distance_cm, kind, 0, down, 0)

    def _is_due(self, what: str, t_s: float, every_s: float) -> bool:
        if t_s < self._due_s[what]:
            return False
        self._due_s[what] = t_s + every_s
        return True

    def _ask(self) -> None:
        if not self._accepted:
            self._station.mav.mission_count_send(1, 1, len(self._mission), 0)
            return
        mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self._station.mav.command_long_send(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, mode, _AUTO_MODE, 0, 0, 0, 0, 0)
        self._station.mav.command_long_send(1, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, _FORCE_ARM, 0, 0, 0, 0, 0)

    def _hear(self, t_s: float) -> None:
        with contextlib.suppress(ConnectionError):
            while self._finder.recv_match(blocking=False) is not None:
                pass
            while (message := self._station.recv_match(blocking=False)) is not None:
                kind = message.get_type()
                if kind == "STATUSTEXT":
                    self.texts.append((t_s, message.text))
                elif kind == "HEARTBEAT" and message.get_srcComponent() == 1:
                    self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                elif kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                    self._station.mav.send(self._mission[message.seq])
                elif kind == "MISSION_ACK":
                    self._accepted = message.type == mavlink.MAV_MISSION_ACCEPTED
                elif kind == "MISSION_ITEM_REACHED":
                    self.reached = int(message.seq)


def circuit(final_m: float, slope_m: float, height_m: float, ground_m: float) -> list[Any]:
    """Mission: take-off to the north, a left-hand circuit, and a landing at the origin.

    Parameters
    ----------
    final_m : float
        How far before the landing point the final leg begins.
    slope_m : float
        Length over ground of the slope.
    height_m : float
        Height of the circuit above home.
    ground_m : float
        Height at which the landing point lies, as the mission has it.
    """
    way, take_off, land = mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_NAV_LAND
    legs = [
        (way, 0.0, 0.0, 0.0), (take_off, 0.0, 0.0, 0.7 * height_m), (way, 400.0, 0.0, height_m),
        (way, 400.0, -300.0, height_m), (way, -final_m, -300.0, height_m), (way, -final_m, 0.0, height_m),
        (way, -slope_m, 0.0, height_m), (land, 0.0, 0.0, ground_m),
    ]  # fmt: skip
    return [_item(number, *leg) for number, leg in enumerate(legs)]


def _item(number: int, command: int, north_m: float, east_m: float, height_m: float) -> Any:
    latitude_deg = _LATITUDE_DEG + north_m / _METRES_PER_DEG
    longitude_deg = _LONGITUDE_DEG + east_m / (_METRES_PER_DEG * math.cos(math.radians(_LATITUDE_DEG)))
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT if number else mavlink.MAV_FRAME_GLOBAL
    pitch_deg = 12.0 if command == mavlink.MAV_CMD_NAV_TAKEOFF else 0.0
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, number, frame, command, 0, 1, pitch_deg, 0.0, 0.0, 0.0, round(1e7 * latitude_deg),
        round(1e7 * longitude_deg), height_m if number else _HEIGHT_M, 0,
    )  # fmt: skip
