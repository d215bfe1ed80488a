"""Places on the ground and mission items between them; flat earth, good to a few centimetres within a kilometre."""

from __future__ import annotations

import math
from argparse import ArgumentTypeError
from dataclasses import dataclass
from typing import Any

from mission_scripts.common.sdk import MissionItem

_DEGREE_M = math.pi * 6378137.0 / 180.0
_RELATIVE_FRAME = 6  # MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
_HOME_FRAME = 5  # MAV_FRAME_GLOBAL_INT (MAVLink common.xml)
WAYPOINT, LOITER, LAND, TAKEOFF, CLIMB_TO = 16, 17, 21, 22, 31
"""CLIMB_TO circles at a place until the height is reached, then leaves toward the next item (param1 = 1)."""


@dataclass(frozen=True, slots=True)
class Place:
    """A point on the ground, degrees WGS84."""

    latitude_deg: float
    longitude_deg: float

    def offset(self, north_m: float, east_m: float) -> Place:
        """The place so far away."""
        narrow = math.cos(math.radians(self.latitude_deg))
        return Place(self.latitude_deg + north_m / _DEGREE_M, self.longitude_deg + east_m / (_DEGREE_M * narrow))

    def toward(self, bearing_deg: float, ahead_m: float, right_m: float = 0.0) -> Place:
        """The place ``ahead_m`` along a bearing and ``right_m`` to the right of it."""
        cos, sin = math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))
        return self.offset(ahead_m * cos - right_m * sin, ahead_m * sin + right_m * cos)

    def to(self, other: Place) -> tuple[float, float]:
        """Metres north and east to another place."""
        narrow = math.cos(math.radians(self.latitude_deg))
        north = (other.latitude_deg - self.latitude_deg) * _DEGREE_M
        return north, (other.longitude_deg - self.longitude_deg) * _DEGREE_M * narrow

    def distance_m(self, other: Place) -> float:
        """Distance over the ground."""
        return math.hypot(*self.to(other))

    def off_way_m(self, start: Place, end: Place) -> float:
        """Distance from the straight way between two places."""
        (north, east), (n, e) = start.to(end), start.to(self)
        length_m = math.hypot(north, east)
        if length_m == 0.0:
            return math.hypot(n, e)
        along_m = min(max((n * north + e * east) / length_m, 0.0), length_m)
        return math.hypot(n - north * along_m / length_m, e - east * along_m / length_m)


def parse_place(text: str) -> Place:
    """``LAT,LON`` in degrees; ArgumentTypeError, whose sentence argparse prints, if it is not that."""
    latitude, _, longitude = text.partition(",")
    try:
        place = Place(float(latitude), float(longitude))
    except ValueError:
        raise ArgumentTypeError(f"'{text}' is no place: give LAT,LON in degrees, such as 47.5,8.25") from None
    if not (-90 <= place.latitude_deg <= 90 and -180 <= place.longitude_deg <= 180):
        raise ArgumentTypeError(f"'{text}' is no place: latitudes are -90 to 90, longitudes -180 to 180 degrees")
    return place


class Route:
    """A mission under construction; item 0 is the home position, as ArduPilot wants it."""

    def __init__(self) -> None:
        self.items: list[Any] = [_item(0, _HOME_FRAME, WAYPOINT, 0, 0, 0.0)]
        self.places: list[Place | None] = [None]

    @property
    def last(self) -> int:
        """Number of the last item."""
        return len(self.items) - 1

    def add(self, command: int, place: Place, height_m: float, *params: float) -> int:
        """Append an item at a place and height above home; gives its number."""
        x, y = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
        self.items.append(_item(len(self.items), _RELATIVE_FRAME, command, x, y, height_m, *params))
        self.places.append(place)
        return self.last

    def off_track_m(self, number: int, here: Place) -> float | None:
        """Distance from the leg that leads to an item; None where there is no leg."""
        start = next((place for place in reversed(self.places[:number]) if place is not None), None)
        end = self.places[number] if number < len(self.places) else None
        if start is None or end is None:
            return None
        return here.off_way_m(start, end) if start.distance_m(end) >= 1.0 else None

    def circles(self, number: int, here: Place, within_m: float) -> bool:
        """Whether an item is flown in circles about its place (as wide as the vehicle flies them), and that is near."""
        place = self.places[number] if number < len(self.places) else None
        return place is not None and self.items[number].command == CLIMB_TO and here.distance_m(place) < within_m


def _item(number: int, frame: int, command: int, x: int, y: int, z: float, *params: float) -> Any:
    p = [*params, *[0.0] * (4 - len(params))]
    return MissionItem(number, frame, command, int(number == 0), 1, *p, x, y, z, 0)
