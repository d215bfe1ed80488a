"""Landing approach with the range watched against barometer or terrain; a go-around wherever it cannot be relied on.

The aircraft flies from the initial point down a slope toward the aim point. From the gate down the published range must
be there, trusted, without jumps, and in agreement with the height above ground that the autopilot believes; otherwise
the script orders a go-around (the mission's own climb-out), and RTL if the aircraft does not climb. Without ``--land``
it ends with a low pass and a climb-out at the decision height, which is what to fly first. With ``--land`` a range that
is stale, not trusted or jumping ends the approach below the decision height too, down to 3 m, but for ranges that end
because the ground has come nearer than can be measured.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Sequence

from companion.cli.steps.numbers import seconds
from companion.units import Orientation
from mission_scripts.common.flight import Flight
from mission_scripts.common.monitor import RangeMonitor, Tolerance
from mission_scripts.common.options import degrees, height, metres, parser_for
from mission_scripts.common.outcome import Aborted, Exit, HandsOff, Refused, Response
from mission_scripts.common.places import CLIMB_TO, LAND, LOITER, WAYPOINT, Route, parse_place
from mission_scripts.common.run import run
from mission_scripts.common.vehicle import NotAccepted
from mission_scripts.common.watch import Range

_OUT_M = 400.0
_BELOW_M, _SINKS_M = 8.0, 20.0  # chosen: floor below the decision height, below the ground where it lands
_CLIMB_MPS, _CLIMBING_S = 0.5, 10.0
_ON_GROUND_M = 3.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    base = Tolerance()
    parser = parser_for("landing_approach", __doc__ or "")
    parser.add_argument("--aim", type=parse_place, metavar="LAT,LON", help="aim point (default: where it is)")
    parser.add_argument("--bearing", type=degrees, metavar="DEG", help="of the approach (default: the present heading)")
    parser.add_argument("--slope", type=degrees, default=5.0, metavar="DEG", help="of the descent")
    parser.add_argument("--height", type=metres, default=80.0, metavar="M", help="where the descent begins")
    parser.add_argument("--gate", type=metres, default=55.0, metavar="M", help="below it the range must be good")
    parser.add_argument("--decision", type=metres, default=20.0, metavar="M", help="low pass, or go-around height")
    parser.add_argument(
        "--ground", type=height, default=0.0, metavar="M",
        help="height of the ground above home; the other heights of the approach are above this ground",
    )  # fmt: skip
    parser.add_argument("--terrain", action="store_true", help="expect TERRAIN_REPORT's height instead of home's")
    parser.add_argument("--land", action="store_true", help="land, the ranges watched down to 3 m above the ground")
    parser.add_argument("--stale", type=seconds, default=base.stale_s, metavar="S", help="silence that ends it")
    parser.add_argument("--blind", type=seconds, default=base.blind_s, metavar="S", help="without trusted range")
    parser.add_argument("--jump", type=metres, default=base.jump_m, metavar="M", help="that ends it")
    parser.add_argument(
        "--apart", type=metres, default=base.apart_m, metavar="M", help="from what is expected, plus 5 %%"
    )
    options = parser.parse_args(arguments)
    if not 10.0 <= options.decision < options.gate < options.height:
        parser.error("heights must be 10 m <= --decision < --gate < --height")
    if not options.floor < options.ground + options.height < options.ceiling:
        parser.error("--ground plus --height must lie between --floor and --ceiling, which are above home")
    if not 2.0 <= options.slope <= 10.0:
        parser.error("--slope between 2 and 10 degrees")
    return run(options, approach)


def approach(flight: Flight) -> Exit:
    """The mission."""
    if flight.airframe.orientation != Orientation.DOWN:
        raise Refused(f"airframe '{flight.airframe.name}' does not look down (orientation 25)")
    flight.need_ranges()
    flight.be_airborne()
    lander = Lander(flight)
    flight.vehicle.upload(lander.route)
    flight.guard.floor_m = lander.floor_m
    flight.begin()
    try:
        return lander.fly()
    except Aborted as error:
        if lander.committed:
            raise HandsOff(f"{error}; below {_ON_GROUND_M:g} m the landing is the autopilot's") from error
        if lander.lands_unseen:  # when the link is back it may stand, and any mode but AUTO lets its motor run
            raise HandsOff(f"{error}; the landing is the autopilot's and its failsafe's") from error
        if error.response is None and lander.descending:
            lander.go_around(str(error))
            raise Aborted(f"went around: {error}", Response.HOLD, error.code) from error
        raise


class Lander:
    """The approach: its route, its monitor, and the way out; ``committed`` once it is on the ground or just above.

    The options' heights are above the ground of the approach; the route's and the floor's are above home.
    """

    def __init__(self, flight: Flight) -> None:
        options = flight.options
        self._flight = flight
        self.route = Route()
        aim = options.aim or flight.watch.place
        bearing = flight.watch.heading_deg if options.bearing is None else options.bearing
        high_m = options.ground + options.height
        low_m = options.ground + (0.0 if options.land else options.decision)
        self.floor_m = low_m - (_SINKS_M if options.land else _BELOW_M)
        run_m = (high_m - low_m) / math.tan(math.radians(options.slope))
        self.route.add(CLIMB_TO, aim.toward(bearing, -run_m - 150.0), high_m, 1.0)
        self.route.add(WAYPOINT, aim.toward(bearing, -run_m), high_m)
        self._final = self.route.add(LAND if options.land else WAYPOINT, aim, low_m)
        self._out = self.route.add(WAYPOINT, aim.toward(bearing, _OUT_M), high_m)
        self.route.add(LOITER, aim.toward(bearing, _OUT_M), high_m)
        tolerance = Tolerance(options.stale, options.blind, options.jump, options.apart)
        self._monitor = RangeMonitor(self._expected_m, tolerance)
        self._from_s = time.monotonic()
        self._decided = False
        self.committed = False

    @property
    def descending(self) -> bool:
        """Whether the slope is being flown."""
        return self._flight.watch.item == self._final

    @property
    def lands_unseen(self) -> bool:
        """Whether it flies its landing, and nothing recent is known of it."""
        return bool(self._flight.options.land) and self.descending and self._flight.watch.out_of_sight

    def fly(self) -> Exit:
        """Until the low pass is over, or the aircraft stands."""
        flight, options = self._flight, self._flight.options
        names = {1: "to the initial point", self._final: "descent", self._out: "climb-out"}
        if options.land:
            self._until_landed(names)
            return self._conclude("landed")
        flight.follow(self.route, 300.0, names, each=self._look)
        flight.guard.floor_m = flight.guard.limits.floor_m
        flight.leave()
        return self._conclude("low pass")

    def _until_landed(self, names: dict[int, str]) -> None:
        flight, watch = self._flight, self._flight.watch
        flight.say(f"{names[1]}, then down to land (item {self._final})")

        def down() -> bool:
            low = watch.height_m - flight.options.ground < _ON_GROUND_M
            if self.descending and (low or watch.on_ground):
                self.committed = True  # no order from here on: it would start the motor on the ground
                flight.guard.mode = None  # the autopilot disarms by itself
            self._look(watch.item)
            return self.committed and not watch.armed

        flight.wait("landing", down, 400.0)

    def _look(self, item: int) -> None:
        """Feed the monitor, and act on it below the gate; at the decision height say how it stands.

        A landing goes on being watched from there, until it is committed.
        """
        watch, options = self._flight.watch, self._flight.options
        for entry in watch.ranges_since(self._from_s):
            self._from_s = math.nextafter(entry.at_s, math.inf)
            self._monitor.take(entry)
        above_m = watch.height_m - options.ground
        landing = bool(options.land) and item == self._final and not self.committed
        if (self._decided and not landing) or item not in (self._final, self._out) or above_m > options.gate:
            return
        trouble = self._monitor.trouble(time.monotonic(), low=self._decided)
        if trouble and item == self._final:
            raise Aborted(trouble)
        # a waypoint counts as reached some way before it: a low pass may turn up before it is quite down
        if not self._decided and (above_m <= options.decision + 1.0 or item == self._out):
            self._decided = True
            verdict = trouble or f"range good, {self._monitor.apart_m[-1]:+.2f} m from what is expected"
            self._flight.say(f"decision height ({above_m:.0f} m): {verdict}")

    def go_around(self, why: str) -> None:
        """Order the climb-out and watch the aircraft climb; Aborted with RTL if it does not."""
        flight = self._flight
        flight.say(f"GO AROUND at {flight.watch.height_m:.0f} m: {why}")
        flight.guard.more = None
        flight.guard.interrupted.clear()
        try:
            flight.vehicle.fly_item(self._out)
            flight.wait("climb", lambda: flight.watch.climb_mps > _CLIMB_MPS, _CLIMBING_S)
            flight.say(f"climbing at {flight.watch.climb_mps:.1f} m/s")
            gate_m = flight.options.ground + flight.options.gate
            flight.wait("climb-out", lambda: flight.watch.height_m > gate_m, 60.0)
        except (Aborted, NotAccepted) as error:
            raise Aborted(f"the go-around failed: {error}", Response.RETURN) from error

    def _expected_m(self, entry: Range) -> float:
        """Distance along the camera axis to level ground, as barometer or terrain data have it."""
        above_m: float = entry.height_m - self._flight.options.ground
        if self._flight.options.terrain:
            terrain_m = self._flight.watch.terrain_m(entry.height_m)
            if terrain_m is None:
                raise Aborted("no terrain data")
            above_m = terrain_m
        return above_m / math.cos(entry.tilt_rad)

    def _conclude(self, what: str) -> Exit:
        apart = self._monitor.apart_m
        if not apart:
            self._flight.say(f"{what}; no trusted range on the way")
            return Exit.NOTHING
        self._flight.say(
            f"{what}; {len(apart)} trusted ranges, range - expected {statistics.median(apart):+.2f} m "
            f"(spread {statistics.pstdev(apart):.2f} m)"
        )
        return Exit.DONE


if __name__ == "__main__":
    sys.exit(main())
