"""Calibrate the pair against a known distance: compare what is published with what is true, and say what to write.

Three kinds of target. ``--ground H``: level ground at H metres above home, for a pair that looks down; the aircraft
flies straight level legs at ``--heights``. ``--still D``: a target at a measured distance of D metres, nothing is
commanded (bench, field); may be given for one distance at a time. ``--mark LAT,LON``: an obstacle of known place, for a
pair that looks ahead; the aircraft flies at it along ``--bearing`` and turns off at ``--turn-off`` metres. No range
guards that run: keep its line free of everything else. A way to its start that leads past the mark is refused.

The wing that was calibrated on the ground is not the wing that flies: ``--still`` holds for the mounting of a pair that
looks ahead, never for the trim bend of one that looks down.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Sequence

from companion.cli.steps.numbers import seconds
from companion.params.airframe import Airframe
from companion.units import Orientation
from mission_scripts.common.airframe_advice import advise, baseline_m
from mission_scripts.common.convergence import Group, estimate, group
from mission_scripts.common.flight import Flight
from mission_scripts.common.legs import back_and_forth, flight_time_s
from mission_scripts.common.options import degrees, height, metres, parser_for
from mission_scripts.common.outcome import Exit, Refused
from mission_scripts.common.places import CLIMB_TO, LOITER, WAYPOINT, Place, Route, parse_place
from mission_scripts.common.run import run
from mission_scripts.common.watch import Range

_LEVEL_RAD = math.radians(6.0)
_HEIGHT_OFF_M = 5.0
_LEAST = 10  # ranges of a group: the median of fewer wanders
_SLOW_RAD = 0.0003
_LINE_UP_M = 150.0
_LEAST_TURN_OFF_M = 50.0  # chosen: one and a half radii of a turn at 18 m/s and 45 degrees of bank

Reference = Callable[[Range], tuple[float, float]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_for("calibrate_target", __doc__ or "")
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("--ground", type=height, metavar="M", help="height of the level ground above home")
    target.add_argument("--still", type=metres, metavar="M", help="measured distance; nothing is commanded")
    target.add_argument("--mark", type=parse_place, metavar="LAT,LON", help="place of an obstacle")
    parser.add_argument("--known-sigma", type=metres, default=0.3, metavar="M", help="of the known distance, 1 sigma")
    parser.add_argument("--heights", type=height, nargs="+", default=[40.0, 60.0, 90.0], metavar="M", help="above home")
    parser.add_argument("--bearing", type=degrees, metavar="DEG", help="of the legs (default: the present heading)")
    parser.add_argument("--length", type=metres, default=350.0, metavar="M", help="of each leg")
    parser.add_argument(
        "--turn-off",
        type=metres,
        default=60.0,
        metavar="M",
        help=f"with --mark: nearest approach, {_LEAST_TURN_OFF_M:g} or more",
    )
    parser.add_argument("--seconds", type=seconds, default=30.0, metavar="S", help="with --still: how long to gather")
    options = parser.parse_args(arguments)
    if options.turn_off < _LEAST_TURN_OFF_M:
        parser.error(f"--turn-off {options.turn_off:g}: {_LEAST_TURN_OFF_M:g} m at least, a turn needs that room")
    return run(options, calibrate)


def calibrate(flight: Flight) -> Exit:
    """The mission."""
    try:
        base_m = baseline_m(flight.airframe)
    except ValueError as error:
        raise Refused(str(error)) from error
    _need_view(flight.airframe, flight.options)
    flight.need_ranges()
    gather = _still if flight.options.still is not None else _mark if flight.options.mark is not None else _ground
    groups = gather(flight)
    for entry in groups:
        flight.say(
            f"known {entry.known_m:7.2f} +- {entry.known_sigma_m:.2f} m   published {entry.read_m:7.2f} m   "
            f"scatter {entry.scatter_m:.2f} m   {entry.count} ranges"
        )
    if not groups:
        flight.say(f"nowhere {_LEAST} trusted ranges: nothing to calibrate with")
        return Exit.NOTHING
    return _conclude(flight, groups, base_m)


def _need_view(airframe: Airframe, options: argparse.Namespace) -> None:
    """Refuse a target that the pair does not look at: its ranges would be held against a distance to something else."""
    targets = (("ground", Orientation.DOWN, "down", "mark"), ("mark", Orientation.FORWARD, "ahead", "ground"))
    for option, needed, where, other in targets:
        if getattr(options, option) is not None and airframe.orientation != needed:
            raise Refused(
                f"--{option} needs a pair that looks {where} (orientation {needed:d}), airframe '{airframe.name}' has "
                f"orientation {airframe.orientation}: give --{other} or --still"
            )


def _conclude(flight: Flight, groups: list[Group], base_m: float) -> Exit:
    offset = estimate(groups, base_m, _SLOW_RAD, one_run=flight.options.mark is not None)
    flight.say(
        f"convergence offset {1e3 * offset.toe_rad:+.2f} +- {1e3 * offset.sigma_rad:.2f} mrad (positive: diverges)"
    )
    if not math.isfinite(offset.scale_sigma):
        flight.say("one distance cannot tell an offset from a wrong focal length or baseline; fly a second one")
    advice = advise(flight.airframe, offset)
    for line in advice.lines:
        flight.say(f"  {line}")
    result = {
        "toe_mrad": 1e3 * offset.toe_rad,
        "toe_sigma_mrad": 1e3 * offset.sigma_rad,
        "scale": offset.scale,
        "scale_sigma": offset.scale_sigma if math.isfinite(offset.scale_sigma) else None,
        "write": advice.values,
    }
    path = flight.options.out / "calibration.json"
    path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    flight.say(f"wrote {path}")
    return Exit.DONE


def _ground(flight: Flight) -> list[Group]:
    """Level legs over level ground."""
    options, watch = flight.options, flight.watch
    flight.be_airborne()
    bearing = watch.heading_deg if options.bearing is None else options.bearing
    route, legs = back_and_forth(watch.place, bearing, options.length, options.heights)
    flight.vehicle.upload(route)
    names = {leg.item: f"leg at {leg.height_m:g} m" for leg in legs}
    spans: dict[int, list[float]] = {}
    flight.begin()
    flight.follow(
        route, flight_time_s(options.length, len(legs)), names,
        each=lambda item: spans.setdefault(item, []).append(time.monotonic()),
    )  # fmt: skip
    flight.leave()
    groups = []
    for leg in legs:
        began, ended = spans.get(leg.item, [0.0])[0], spans.get(leg.item, [0.0])[-1]
        on_leg = [entry for entry in watch.ranges_since(began) if entry.at_s <= ended
                  and abs(entry.height_m - leg.height_m) < _HEIGHT_OFF_M]  # fmt: skip
        groups.append(
            _grouped(on_leg, lambda r: ((r.height_m - options.ground) / math.cos(r.tilt_rad), options.known_sigma))
        )
    return [entry for entry in groups if entry is not None]


def _still(flight: Flight) -> list[Group]:
    """A target that does not move; neither do we."""
    options = flight.options
    flight.guard.floor_m = -math.inf  # on a bench, most likely
    began_s = time.monotonic()
    flight.wait(
        "gathering", lambda: time.monotonic() - began_s >= options.seconds, options.seconds + 5.0,
        tell=lambda: f"{len(flight.watch.ranges_since(began_s))} ranges",
    )  # fmt: skip
    measured = _grouped(flight.watch.ranges_since(began_s), lambda _: (options.still, options.known_sigma), level=False)
    return [measured] if measured is not None else []


def _mark(flight: Flight) -> list[Group]:
    """Fly at an obstacle, and turn off in time; neighbouring ranges are put together."""
    options, watch = flight.options, flight.watch
    mark: Place = options.mark
    flight.be_airborne()
    bearing = watch.heading_deg if options.bearing is None else options.bearing
    height_m = options.heights[0]
    route = Route()
    run_m = options.turn_off + options.length
    start = mark.toward(bearing, -run_m - _LINE_UP_M)
    flight.need_clear_way(start, mark, options.turn_off)
    route.add(CLIMB_TO, start, height_m, 1.0)
    route.add(WAYPOINT, mark.toward(bearing, -run_m), height_m)
    approach = route.add(WAYPOINT, mark.toward(bearing, -options.turn_off), height_m)
    aside = mark.toward(bearing, -options.turn_off, 3.0 * options.turn_off)
    route.add(WAYPOINT, aside, height_m)
    route.add(LOITER, aside, height_m)
    flight.vehicle.upload(route)
    flight.begin()
    spans: list[float] = []
    flight.follow(
        route, flight_time_s(options.length, 2), {approach: "toward the mark"},
        each=lambda item: spans.append(time.monotonic()) if item == approach else None,
    )  # fmt: skip
    flight.leave()
    on_run = [entry for entry in watch.ranges_since(spans[0] if spans else math.inf) if entry.at_s <= spans[-1]]
    good = sorted((entry for entry in on_run if _usable(entry)), key=lambda entry: entry.place.distance_m(mark))
    batches = [good[at : at + _LEAST] for at in range(0, len(good) - _LEAST + 1, _LEAST)]
    groups = [_grouped(ranges, lambda r: (r.place.distance_m(mark), options.known_sigma)) for ranges in batches]
    return [entry for entry in groups if entry is not None]


def _grouped(ranges: Sequence[Range], reference: Reference, *, level: bool = True) -> Group | None:
    """Group of the usable ranges; None where they are too few."""
    good = [entry for entry in ranges if _usable(entry, level=level)]
    if len(good) < _LEAST:
        return None
    return group([reference(entry) for entry in good], [entry.distance_m for entry in good])


def _usable(entry: Range, *, level: bool = True) -> bool:
    """Trusted, and of level flight."""
    return entry.trusted and (not level or entry.tilt_rad < _LEVEL_RAD)


if __name__ == "__main__":
    sys.exit(main())
