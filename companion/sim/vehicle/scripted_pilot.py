"""A simulated aeroplane that takes orders: a point mass with bank, climb and speed limits, in ArduPlane's flight modes.

It replaces the prescribed path of a :class:`~companion.sim.flight.flight.Flight` in what the autopilot says of
position,
attitude and speed, so that missions can be flown. What the inertial sensors say stays that of the prescribed flight:
orders bend no wing here. No clock, no random numbers.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass

from companion.units import GRAVITY_MPS2

HOME_AMSL_M = 440.0
"""Differs from zero so that a script that mixes up heights above sea and above home is found out (choice)."""

_RTL_HEIGHT_M = 100.0  # ArduPlane's default height of a return (RTL_ALTITUDE)
_ORBIT_M = 60.0  # ArduPlane's default radius (WP_LOITER_RAD)
_ACCEPT_M = 20.0  # chosen: a third of the orbit's radius
_CLIMB_MPS, _SINK_MPS = 5.0, 4.0  # chosen: near ArduPlane's defaults (TECS_CLMB_MAX 5, TECS_SINK_MAX 5)
# chosen: 43 degrees at 69 degrees a second, near ArduPlane's default bank of 45
_MOST_BANK_RAD, _ROLL_RATE_RADPS = 0.75, 1.2
_TRIM_PITCH_RAD = 0.05  # chosen: a wing flies with its nose 3 degrees up
_PITCH_TIME_S, _SPEED_TIME_S = 0.35, 1.5  # chosen: pitch follows at once, speed with the aeroplane's inertia
_FORCED_FOR_S = 3.0  # chosen: a script that stops asking loses its attitude after three seconds
_FREE = (0.0, -math.inf)  # convention: no angle, held until before all time
_LANDED_M = 0.3  # wheels touch below it (choice)
_LINED_UP_RAD = 0.3  # chosen: 17 degrees off, within which an approach goes on


class FlightMode(enum.IntEnum):
    """ArduPlane's mode numbers, as far as they are flown here."""

    MANUAL = 0
    FBWA = 5
    AUTO = 10
    RTL = 11
    LOITER = 12
    GUIDED = 15


class Order(enum.IntEnum):
    """MAV_CMD numbers of the mission items that are flown."""

    WAYPOINT = 16
    LOITER_UNLIM = 17
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    LOITER_TO_ALT = 31
    CHANGE_SPEED = 178


@dataclass(frozen=True, slots=True)
class Item:
    """One mission item: metres north and east of home, height above home."""

    order: Order
    north_m: float = 0.0
    east_m: float = 0.0
    height_m: float = 0.0
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


class ScriptedPilot:
    """Flies; :meth:`step` is one control period.

    It begins ``height_m`` above home: airborne, armed and in LOITER, or at 0 on the ground and disarmed. ``items`` is
    the mission, whose item 0 is home and never flown. ``reached`` are item numbers and ``texts`` sentences for the
    ground; whoever sends them takes them out. ``battery`` is what remains, 0 to 1; ``wind_east_mps`` blows the
    aeroplane off its track, for tests of who watches it.
    """

    def __init__(self, height_m: float = 0.0) -> None:
        self.north_m = self.east_m = self.course_rad = 0.0
        self.height_m = height_m
        self.roll_rad, self.pitch_rad = 0.0, _TRIM_PITCH_RAD
        self.climb_mps = 0.0
        self.cruise_mps = 22.0
        self.airspeed_mps = self.cruise_mps if height_m > 0 else 0.0
        self.wanted_mps = self.cruise_mps
        self.armed = height_m > 0
        self.mode = FlightMode.LOITER if height_m > 0 else FlightMode.MANUAL
        self.items: list[Item] = [Item(Order.WAYPOINT)]
        self.current = 0
        self.reached: deque[int] = deque()
        self.texts: deque[str] = deque()
        self.battery = 0.9
        self.wind_east_mps = 0.0
        self._t_s = 0.0
        self._roll = self._pitch = _FREE
        self._goal = (0.0, 0.0, height_m)
        self._leg_from = (0.0, 0.0, height_m)
        self._since_s: float | None = None

    @property
    def airborne(self) -> bool:
        """Off the ground."""
        return self.height_m > 0.0

    def arm(self, armed: bool) -> bool:
        """Arm, or disarm on the ground; False if refused."""
        if not armed and self.airborne:
            return False
        self.armed = armed
        return True

    def set_mode(self, number: int) -> bool:
        """Change the mode as ArduPlane does: GUIDED and LOITER circle where the aeroplane is. False if unknown."""
        if number not in FlightMode._value2member_map_:
            return False
        self.mode = FlightMode(number)
        self._goal = (self.north_m, self.east_m, self.height_m)
        self._roll = self._pitch = _FREE
        if self.mode is FlightMode.AUTO:
            self.select(self.current if 0 < self.current < len(self.items) else 1)
        return True

    @property
    def over_ground_mps(self) -> tuple[float, float]:
        """Velocity over ground, north and east: through the air, and with the wind."""
        level_mps = self.airspeed_mps * math.cos(self.pitch_rad - _TRIM_PITCH_RAD)
        return level_mps * math.cos(self.course_rad), level_mps * math.sin(self.course_rad) + self.wind_east_mps

    def set_goal(self, north_m: float, east_m: float, height_m: float) -> None:
        """Circle about a place (DO_REPOSITION)."""
        self._goal = (north_m, east_m, height_m)

    def force(self, roll_rad: float | None, pitch_rad: float | None) -> None:
        """Hold roll, pitch or both for up to three seconds; taken in GUIDED alone (SET_ATTITUDE_TARGET)."""
        if self.mode is not FlightMode.GUIDED:
            return
        until_s = self._t_s + _FORCED_FOR_S
        self._roll = self._roll if roll_rad is None else (roll_rad, until_s)
        self._pitch = self._pitch if pitch_rad is None else (pitch_rad, until_s)

    def select(self, number: int) -> bool:
        """Fly this item next; False if there is none."""
        if not 0 <= number < len(self.items):
            return False
        self.current = number
        self._leg_from = (self.north_m, self.east_m, self.height_m)
        self._since_s = None
        return True

    def step(self, dt_s: float) -> None:
        """Live on for a control period."""
        self._t_s += dt_s
        if not self.armed:
            return
        if self.mode is FlightMode.AUTO:
            self._follow_mission()
        if not self.airborne and not self._taking_off():
            self.airspeed_mps = self.climb_mps = 0.0
            return
        self._move(*self._attitude(), dt_s)
        self.battery = max(self.battery - dt_s / 3600.0, 0.0)

    # ------------------------------------------------------------------------------------------ guidance

    def _taking_off(self) -> bool:
        return self.mode is FlightMode.AUTO and self._item().order is Order.TAKEOFF

    def _item(self) -> Item:
        return self.items[self.current] if self.current < len(self.items) else Item(Order.RETURN_TO_LAUNCH)

    def _follow_mission(self) -> None:
        while self.mode is FlightMode.AUTO and self._done(self._item()):
            self.reached.append(self.current)
            if self.current + 1 < len(self.items):
                self.select(self.current + 1)
            else:
                self.set_mode(FlightMode.RTL)
                self.texts.append("Mission complete, changing mode to RTL")

    def _done(self, item: Item) -> bool:
        """Whether an item has been flown; what is no place is done at once."""
        if item.order is Order.CHANGE_SPEED:
            self.change_speed(item.params[0], item.params[1])
            return True
        if item.order is Order.RETURN_TO_LAUNCH:
            self.set_mode(FlightMode.RTL)
            return False
        if item.order is Order.TAKEOFF:
            return self.height_m >= item.height_m - 1.0
        if item.order is Order.LAND:
            self._touch_down(item)
            return False
        if item.order is Order.LOITER_UNLIM:
            return False
        if item.order is Order.LOITER_TO_ALT:
            return self._high_and_lined_up(item)
        arrived = self._arrived(item)
        if item.order is Order.LOITER_TIME:
            if arrived and self._since_s is None:
                self._since_s = self._t_s
            return self._since_s is not None and self._t_s - self._since_s >= item.params[0]
        return arrived

    def _arrived(self, item: Item) -> bool:
        """Within the acceptance radius, or past the leg's end."""
        along, _, length = self._on_leg(item)
        near = math.hypot(item.north_m - self.north_m, item.east_m - self.east_m) < _ACCEPT_M
        return near or (length > 0 and along >= length)

    def _high_and_lined_up(self, item: Item) -> bool:
        """At the height, close by, and heading for the next item."""
        after = self.items[self.current + 1] if self.current + 1 < len(self.items) else item
        bearing = math.atan2(after.east_m - self.east_m, after.north_m - self.north_m)
        off = (bearing - self.course_rad + math.pi) % math.tau - math.pi
        near = math.hypot(item.north_m - self.north_m, item.east_m - self.east_m) < 2 * _ORBIT_M
        return near and abs(self.height_m - item.height_m) < 2.0 and abs(off) < _LINED_UP_RAD

    def _touch_down(self, item: Item) -> None:
        if self.airborne and self.height_m <= _LANDED_M:
            self.height_m = 0.0
            self.armed = False
            self.reached.append(self.current)
            short_m = math.hypot(self.north_m - item.north_m, self.east_m - item.east_m)
            self.texts.append(f"Distance from LAND point={short_m:.2f} meters")

    def _on_leg(self, item: Item) -> tuple[float, float, float]:
        """Metres along the leg, to the right of it, and its length."""
        north, east = item.north_m - self._leg_from[0], item.east_m - self._leg_from[1]
        length = math.hypot(north, east)
        if length < 1e-6:
            return 0.0, 0.0, 0.0
        dn, de = self.north_m - self._leg_from[0], self.east_m - self._leg_from[1]
        return (dn * north + de * east) / length, (de * north - dn * east) / length, length

    def _aim(self) -> tuple[float, float]:
        """Course and height that the mode wants."""
        if self.mode is FlightMode.RTL:
            return self._orbit(0.0, 0.0), max(self._goal[2], _RTL_HEIGHT_M)
        if self.mode in (FlightMode.LOITER, FlightMode.GUIDED):
            return self._orbit(*self._goal[:2]), self._goal[2]
        if self.mode is not FlightMode.AUTO:
            return self.course_rad, self.height_m
        item = self._item()
        if item.order is Order.TAKEOFF:
            return self.course_rad, item.height_m + 2.0
        if item.order in (Order.LOITER_UNLIM, Order.LOITER_TIME, Order.LOITER_TO_ALT):
            return self._orbit(item.north_m, item.east_m), item.height_m
        return self._along(item)

    def _along(self, item: Item) -> tuple[float, float]:
        """Follow a leg; descend along its slope, climb at once, as ArduPlane does."""
        along, right, length = self._on_leg(item)
        track = math.atan2(item.east_m - self._leg_from[1], item.north_m - self._leg_from[0])
        height = item.height_m
        if height < self._leg_from[2] and length > 0:
            height += (self._leg_from[2] - height) * (1.0 - min(max(along / length, 0.0), 1.0))
        if item.order is Order.LAND:
            height -= 1.0
        return track - math.atan2(right, 40.0), height

    def _orbit(self, north_m: float, east_m: float) -> float:
        """Course that leads onto a clockwise circle about a place."""
        dn, de = self.north_m - north_m, self.east_m - east_m
        outside = (math.hypot(dn, de) - _ORBIT_M) / (0.5 * _ORBIT_M)
        return math.atan2(de, dn) + math.pi / 2 + math.atan(outside)

    def change_speed(self, kind: float, speed_mps: float) -> bool:
        """Set the airspeed (kind 0) within the airframe's limits; -2 is the cruise speed again. False if refused."""
        if kind == 0 and speed_mps == -2.0:
            self.wanted_mps = self.cruise_mps
        elif kind == 0 and 10.0 <= speed_mps <= 35.0:
            self.wanted_mps = speed_mps
        else:
            return False
        return True

    # ------------------------------------------------------------------------------------------ motion

    def _attitude(self) -> tuple[float, float]:
        """Roll and pitch that are wanted now: the mode's own, or what is forced."""
        roll, pitch = self._guided()
        return (
            self._roll[0] if self._t_s < self._roll[1] else roll,
            self._pitch[0] if self._t_s < self._pitch[1] else pitch,
        )

    def _guided(self) -> tuple[float, float]:
        course, height = self._aim()
        off = (course - self.course_rad + math.pi) % (2 * math.pi) - math.pi
        roll = min(max(1.8 * off, -_MOST_BANK_RAD), _MOST_BANK_RAD)
        climb = min(max(0.6 * (height - self.height_m), -_SINK_MPS), _CLIMB_MPS)
        speed = max(self.airspeed_mps, 5.0)
        return roll, math.asin(min(max(climb / speed, -0.5), 0.5)) + _TRIM_PITCH_RAD

    def _move(self, roll_rad: float, pitch_rad: float, dt_s: float) -> None:
        most = _ROLL_RATE_RADPS * dt_s
        self.roll_rad += min(max(roll_rad - self.roll_rad, -most), most)
        self.pitch_rad += (pitch_rad - self.pitch_rad) * min(dt_s / _PITCH_TIME_S, 1.0)
        self.airspeed_mps += (self.wanted_mps - self.airspeed_mps) * min(dt_s / _SPEED_TIME_S, 1.0)
        speed = max(self.airspeed_mps, 1.0)
        slope = self.pitch_rad - _TRIM_PITCH_RAD
        self.climb_mps = speed * math.sin(slope)
        self.course_rad = (self.course_rad + GRAVITY_MPS2 * math.tan(self.roll_rad) / max(speed, 8.0) * dt_s) % math.tau
        north_mps, east_mps = self.over_ground_mps
        self.north_m += north_mps * dt_s
        self.east_m += east_mps * dt_s
        self.height_m = max(self.height_m + self.climb_mps * dt_s, 0.0)
