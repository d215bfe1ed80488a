"""Straight legs, level, there and back, at one height after the other: where ranges are gathered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mission_scripts.common.places import CLIMB_TO, LOITER, WAYPOINT, Place, Route

_APART_M = 160.0


@dataclass(frozen=True, slots=True)
class Leg:
    """One leg: the item that is current while it is flown, and its height above home."""

    item: int
    height_m: float


def back_and_forth(
    start: Place, bearing_deg: float, length_m: float, heights_m: Sequence[float]
) -> tuple[Route, list[Leg]]:
    """A mission of parallel legs, each at its own height; it climbs circling between them, and ends so at the last."""
    route, legs = Route(), []
    for index, height_m in enumerate(heights_m):
        right_m = _APART_M * (index % 2)
        ends = [start.toward(bearing_deg, 0.0, right_m), start.toward(bearing_deg, length_m, right_m)]
        if index % 2:
            ends.reverse()
        route.add(CLIMB_TO, ends[0], height_m, 1.0)
        legs.append(Leg(route.add(WAYPOINT, ends[1], height_m), height_m))
    route.add(LOITER, start, heights_m[-1])
    return route, legs


def flight_time_s(length_m: float, legs: int, airspeed_mps: float = 15.0) -> float:
    """A time within which such a mission must be over, wind and turns included."""
    return 60.0 + legs * (length_m + 600.0) / (0.5 * airspeed_mps)
