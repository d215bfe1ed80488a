"""The mission protocol of the simulated autopilot: upload, download, clear, as ArduPilot's AP_Mission answers."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.sim.vehicle.scripted_pilot import HOME_AMSL_M, Item, Order, ScriptedPilot

HOME_LATITUDE_DEG, HOME_LONGITUDE_DEG = 47.0, 8.0  # chosen: a place where a degree of longitude is not one of latitude
DEGREE_M = math.pi * 6378137.0 / 180.0  # of a sphere with WGS 84's equatorial radius (derived)
_ASK_AGAIN_NS = 1_000_000_000  # chosen: a lost item is asked for again before a ground station gives up
_GIVE_UP_NS = 8_000_000_000  # convention: ArduPilot's AP_Mission ends an upload that stalls for so long
_SEA_LEVEL = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)


def to_wire(north_m: float, east_m: float) -> tuple[int, int]:
    """Latitude and longitude in 1e-7 degrees of a place given in metres from home."""
    narrow = math.cos(math.radians(HOME_LATITUDE_DEG))
    latitude, longitude = HOME_LATITUDE_DEG + north_m / DEGREE_M, HOME_LONGITUDE_DEG + east_m / DEGREE_M / narrow
    return round(latitude * 1e7), round(longitude * 1e7)


def from_wire(latitude: int, longitude: int) -> tuple[float, float]:
    """Metres north and east of home."""
    narrow = math.cos(math.radians(HOME_LATITUDE_DEG))
    north = (latitude * 1e-7 - HOME_LATITUDE_DEG) * DEGREE_M
    return north, (longitude * 1e-7 - HOME_LONGITUDE_DEG) * DEGREE_M * narrow


class MissionServer:
    """Keeps the mission of a pilot; :meth:`receive` and :meth:`advance` give the messages to answer with.

    ``speed`` is how many times faster than real the flight is: whoever uploads lives in real time, and is given that.
    """

    def __init__(self, pilot: ScriptedPilot, speed: float = 1.0) -> None:
        self._pilot = pilot
        self._ask_again_ns, self._give_up_ns = round(_ASK_AGAIN_NS * speed), round(_GIVE_UP_NS * speed)
        self._raw: list[Any] = []
        self._coming: list[Any] = []
        self._expected = 0
        self._peer = (0, 0)
        self._asked_ns = self._began_ns = 0

    def receive(self, message: Any, now_ns: int) -> list[Any] | None:
        """Answer one message; None if it is none of the mission protocol."""
        handler = getattr(self, f"_{message.get_type().lower()}", None)
        if handler is None or not message.get_type().startswith("MISSION_"):
            return None
        self._peer = (message.get_srcSystem(), message.get_srcComponent())
        if getattr(message, "mission_type", 0) != mavlink.MAV_MISSION_TYPE_MISSION:
            return [self._ack(mavlink.MAV_MISSION_UNSUPPORTED, message.mission_type)]
        answers: list[Any] = handler(message, now_ns)
        return answers

    def advance(self, now_ns: int) -> list[Any]:
        """Ask again for an item that did not come, and give up after a while."""
        if not self._expected or now_ns - self._asked_ns < self._ask_again_ns:
            return []
        if now_ns - self._began_ns > self._give_up_ns:
            self._expected = 0
            return [self._ack(mavlink.MAV_MISSION_OPERATION_CANCELLED)]
        return [self._ask(now_ns)]

    # ------------------------------------------------------------------------------------------ upload

    def _mission_count(self, message: Any, now_ns: int) -> list[Any]:
        self._coming, self._expected, self._began_ns = [], message.count, now_ns
        if message.count == 0:
            return self._mission_clear_all(message, now_ns)
        return [self._ask(now_ns)]

    def _mission_item_int(self, message: Any, now_ns: int) -> list[Any]:
        if not self._expected or message.seq != len(self._coming):
            return []
        self._began_ns = now_ns
        if message.seq > 0 and _item(message) is None:
            self._expected = 0
            return [self._ack(mavlink.MAV_MISSION_UNSUPPORTED)]
        self._coming.append(message)
        if len(self._coming) < self._expected:
            return [self._ask(now_ns)]
        self._expected = 0
        self._raw = self._coming
        self._pilot.items = [Item(Order.WAYPOINT), *(item for m in self._raw[1:] if (item := _item(m)) is not None)]
        self._pilot.current = min(self._pilot.current, len(self._raw) - 1)
        return [self._ack(mavlink.MAV_MISSION_ACCEPTED)]

    def _ask(self, now_ns: int) -> Any:
        self._asked_ns = now_ns
        return mavlink.MAVLink_mission_request_int_message(*self._peer, len(self._coming))

    # ------------------------------------------------------------------------------------------ the rest

    def _mission_request_list(self, message: Any, now_ns: int) -> list[Any]:
        del message, now_ns
        return [mavlink.MAVLink_mission_count_message(*self._peer, len(self._raw))]

    def _mission_request_int(self, message: Any, now_ns: int) -> list[Any]:
        del now_ns
        if not 0 <= message.seq < len(self._raw):
            return [self._ack(mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        item = self._raw[message.seq]
        names = item.get_fieldnames()[2:]
        values = [getattr(item, name) for name in names]
        if message.seq == 0:
            values[names.index("x") :] = [*to_wire(0.0, 0.0), HOME_AMSL_M, 0]
        return [mavlink.MAVLink_mission_item_int_message(*self._peer, *values)]

    def _mission_clear_all(self, message: Any, now_ns: int) -> list[Any]:
        del message, now_ns
        self._raw, self._expected = [], 0
        self._pilot.items = [Item(Order.WAYPOINT)]
        self._pilot.current = 0
        return [self._ack(mavlink.MAV_MISSION_ACCEPTED)]

    def _mission_set_current(self, message: Any, now_ns: int) -> list[Any]:
        del now_ns
        self._pilot.select(message.seq)
        return [self.current()]

    def _mission_ack(self, message: Any, now_ns: int) -> list[Any]:
        del message, now_ns
        return []

    def current(self) -> Any:
        """MISSION_CURRENT."""
        return mavlink.MAVLink_mission_current_message(self._pilot.current, max(len(self._raw) - 1, 0))

    def _ack(self, result: int, kind: int = mavlink.MAV_MISSION_TYPE_MISSION) -> Any:
        return mavlink.MAVLink_mission_ack_message(*self._peer, result, kind)


def _item(message: Any) -> Item | None:
    """An item as the pilot flies it, or None if this autopilot does not know it."""
    if message.command not in Order._value2member_map_ or not math.isfinite(message.z):
        return None
    north, east = from_wire(message.x, message.y)
    height = message.z - HOME_AMSL_M if message.frame in _SEA_LEVEL else message.z
    return Item(
        Order(message.command), north, east, height, (message.param1, message.param2, message.param3, message.param4)
    )
