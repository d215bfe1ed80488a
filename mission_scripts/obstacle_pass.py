"""Fly past an obstacle of known place with a pair that looks ahead, and watch what the service makes of it.

The aircraft flies a straight level leg that passes the obstacle at ``--aside`` metres. Trusted ranges are compared with
the distance to the known place while it is in view. If anything is nearer ahead than ``--least``, on the way to the
start too, the flight is broken off and the aircraft climbs away home (RTL): it is meant for obstacles that are lower
than RTL_ALTITUDE. A way to the start that itself leads past the obstacle is refused.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from argparse import ArgumentTypeError
from collections.abc import Sequence

from companion.units import Orientation
from mission_scripts.common.flight import Flight
from mission_scripts.common.options import degrees, height, metres, parser_for
from mission_scripts.common.outcome import Aborted, Exit, Refused, Response
from mission_scripts.common.places import CLIMB_TO, LOITER, WAYPOINT, Place, Route, parse_place
from mission_scripts.common.run import run
from mission_scripts.common.watch import Range

_FRESH_S = 0.5
_IN_VIEW_DEG = 18.0
_LINE_UP_M = 150.0
_SAME_M, _SAME_FRACTION = 5.0, 0.1


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_for("obstacle_pass", __doc__ or "")
    parser.set_defaults(airframe="forward-2m")
    parser.add_argument("--obstacle", type=parse_place, required=True, metavar="LAT,LON", help="where it stands")
    parser.add_argument("--bearing", type=degrees, required=True, metavar="DEG", help="of the pass")
    parser.add_argument(
        "--aside", type=_aside, default=30.0, metavar="M", help="clearance; the aircraft stays on its left"
    )
    parser.add_argument("--length", type=metres, default=300.0, metavar="M", help="before and after the obstacle")
    parser.add_argument("--height", type=height, metavar="M", help="above home (default: where it is)")
    parser.add_argument("--least", type=metres, default=30.0, metavar="M", help="nearest range ahead that is allowed")
    return run(parser.parse_args(arguments), fly_past)


def _aside(text: str) -> float:
    value = metres(text)
    if value < 15:
        raise ArgumentTypeError("less than 15 m is no pass but a collision course")
    return value


def fly_past(flight: Flight) -> Exit:
    """The mission."""
    options, watch = flight.options, flight.watch
    if flight.airframe.orientation != Orientation.FORWARD:
        raise Refused(
            f"airframe '{flight.airframe.name}' looks to orientation {flight.airframe.orientation}, not ahead (0)"
        )
    flight.need_ranges()
    flight.be_airborne()
    height_m = options.height or watch.height_m
    route = Route()
    ends = [options.obstacle.toward(options.bearing, along_m, -options.aside)
            for along_m in (-options.length - _LINE_UP_M, -options.length, options.length)]  # fmt: skip
    flight.need_clear_way(ends[0], options.obstacle, options.aside)
    route.add(CLIMB_TO, ends[0], height_m, 1.0)
    route.add(WAYPOINT, ends[1], height_m)
    passing = route.add(WAYPOINT, ends[2], height_m)
    route.add(LOITER, ends[2], height_m)
    flight.vehicle.upload(route)
    ahead = Ahead(flight, passing)
    flight.guard.more = ahead.check
    flight.begin()
    flight.follow(route, 120.0 + 4 * options.length / 10.0, {1: "to the start", passing: "the pass"})
    flight.guard.more = None
    flight.leave()
    return ahead.conclude()


class Ahead:
    """Every trusted range, held to the least distance as it comes; those of the pass are compared with the place."""

    def __init__(self, flight: Flight, passing: int) -> None:
        self._flight, self._passing = flight, passing
        self._from_s = time.monotonic()
        self._off_m: list[float] = []
        self._nearest_m = math.inf
        self._first_m = 0.0

    def check(self) -> None:
        """Look at what came since the last look (called by the guard)."""
        watch, options = self._flight.watch, self._flight.options
        for entry in watch.ranges_since(self._from_s):
            self._from_s = math.nextafter(entry.at_s, math.inf)
            if not entry.trusted:
                continue
            if watch.item == self._passing:
                self._take(entry, options.obstacle)
            if entry.distance_m < options.least and time.monotonic() - entry.at_s < _FRESH_S:
                raise Aborted(f"{entry.distance_m:.1f} m ahead, least {options.least:g} m", Response.RETURN)

    def _take(self, entry: Range, obstacle: Place) -> None:
        self._nearest_m = min(self._nearest_m, entry.distance_m)
        ahead_m = _depth(entry, obstacle, self._flight.options.bearing)
        if ahead_m is None or abs(entry.distance_m - ahead_m) > _SAME_M + _SAME_FRACTION * ahead_m:
            return  # something else than our obstacle
        self._first_m = self._first_m or ahead_m
        self._off_m.append(entry.distance_m - ahead_m)

    def conclude(self) -> Exit:
        """Say what was seen of the obstacle."""
        say = self._flight.say
        if not self._off_m:
            say("the obstacle was never ranged where it stands")
            return Exit.NOTHING
        say(
            f"obstacle first ranged at {self._first_m:.0f} m, {len(self._off_m)} trusted ranges of it, "
            f"range - distance {statistics.median(self._off_m):+.2f} m, "
            f"spread {statistics.pstdev(self._off_m):.2f} m, nearest range of all {self._nearest_m:.0f} m"
        )
        return Exit.DONE


def _depth(entry: Range, obstacle: Place, bearing_deg: float) -> float | None:
    """Distance of the obstacle along the line of flight; None outside the field of view."""
    north, east = entry.place.to(obstacle)
    cos, sin = math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg))
    along, across = north * cos + east * sin, east * cos - north * sin
    return along if along > 0 and abs(math.degrees(math.atan2(across, along))) < _IN_VIEW_DEG else None


if __name__ == "__main__":
    sys.exit(main())
