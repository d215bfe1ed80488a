"""Climb sweep: level legs from low to high, to see what range and wing do over distance and load.

Each leg is straight; the turns and climbs between the legs load the wing. At the end a table says, for each height, how
many ranges were trusted and how far they were from the height above ground that the autopilot believes. The recording
has gusts, turns and pull-ups for ``spanwise identify`` and ``diagnose``. Ranges are not needed (``--no-ranges``).
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Sequence

from mission_scripts.common.flight import Flight
from mission_scripts.common.legs import Leg, back_and_forth, flight_time_s
from mission_scripts.common.options import degrees, height, metres, parser_for
from mission_scripts.common.outcome import Exit
from mission_scripts.common.run import run
from mission_scripts.common.watch import Range

_LEVEL_RAD = math.radians(8.0)
_HEIGHT_OFF_M = 5.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_for("climb_sweep", __doc__ or "")
    parser.add_argument("--heights", type=height, nargs="+", default=[30.0, 50.0, 70.0, 100.0], metavar="M")
    parser.add_argument("--bearing", type=degrees, metavar="DEG", help="of the legs (default: the present heading)")
    parser.add_argument("--length", type=metres, default=350.0, metavar="M", help="of each leg")
    parser.add_argument("--ground", type=height, default=0.0, metavar="M", help="height of the ground above home")
    parser.add_argument("--no-ranges", action="store_true", help="fly without a service that sends ranges")
    options = parser.parse_args(arguments)
    if not options.floor < min(options.heights) <= max(options.heights) < options.ceiling:
        parser.error(f"--heights must lie between --floor {options.floor:g} and --ceiling {options.ceiling:g}")
    return run(options, sweep)


def sweep(flight: Flight) -> Exit:
    """The mission."""
    options, watch = flight.options, flight.watch
    if not options.no_ranges:
        flight.need_ranges()
    flight.be_airborne()
    bearing = watch.heading_deg if options.bearing is None else options.bearing
    route, legs = back_and_forth(watch.place, bearing, options.length, options.heights)
    flight.vehicle.upload(route)
    flight.say(f"{len(legs)} legs of {options.length:g} m, bearing {bearing:.0f} degrees, {route.last} items uploaded")
    spans: dict[int, list[float]] = {}
    flight.begin()
    flight.follow(
        route, flight_time_s(options.length, len(legs)), {leg.item: f"leg at {leg.height_m:g} m" for leg in legs},
        each=lambda item: spans.setdefault(item, []).append(time.monotonic()),
    )  # fmt: skip
    flight.leave()
    if options.no_ranges:
        return Exit.DONE
    trusted_counts = [_summarise_leg(flight, leg, spans.get(leg.item, [])) for leg in legs]
    return Exit.DONE if any(trusted_counts) else Exit.NOTHING


def _summarise_leg(flight: Flight, leg: Leg, span: list[float]) -> int:
    """One row of the table; gives the number of trusted ranges."""
    began, ended = (span[0], span[-1]) if span else (math.inf, -math.inf)
    on_leg = [entry for entry in flight.watch.ranges_since(began) if entry.at_s <= ended and _level(entry, leg)]
    good = [entry for entry in on_leg if entry.trusted]
    if not good:
        flight.say(f"{leg.height_m:6.0f} m: {len(on_leg)} ranges, none trusted")
        return 0
    errors = [r.distance_m - (r.height_m - flight.options.ground) / math.cos(r.tilt_rad) for r in good]
    sigmas = [r.sigma_m for r in good if math.isfinite(r.sigma_m)]
    sigma = f"{statistics.median(sigmas):.2f} m" if sigmas else "not told"
    flight.say(
        f"{leg.height_m:6.0f} m: {len(good)} of {len(on_leg)} ranges trusted, range - height "
        f"{statistics.median(errors):+.2f} m (spread {statistics.pstdev(errors):.2f} m), own sigma {sigma}"
    )
    return len(good)


def _level(entry: Range, leg: Leg) -> bool:
    return entry.tilt_rad < _LEVEL_RAD and abs(entry.height_m - leg.height_m) < _HEIGHT_OFF_M


if __name__ == "__main__":
    sys.exit(main())
