"""Serve the simulated vehicle on UDP, to fly mission_scripts against it: it takes orders and may run faster than real.

``python -m tools.simulated_vehicle --link udpout:127.0.0.1:14540 --ranges`` and, in another shell, any mission with
``--connect udpin:127.0.0.1:14540``. With ``spanwise run`` on a second ``--link`` (at speed 1, without ``--ranges``)
the real service is in the loop; it has no cameras there, so no ranges either.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading

from companion.errors import SpanwiseError
from companion.params.files import load_airframe
from companion.sim.flight.flight import build_flight
from companion.sim.rehearsal.vehicle import RehearsalVehicle
from companion.sim.vehicle.world import VehicleLink


def main() -> int:
    """Run until Ctrl-C; 2 where something is wrong, with one sentence."""
    parser = argparse.ArgumentParser(prog="python -m tools.simulated_vehicle", description=__doc__)
    parser.add_argument(
        "--link", action="append", metavar="LINK", help="udpout:host:port or udpin:host:port; may be repeated"
    )
    parser.add_argument("--airframe", default="sitl-plane", metavar="NAME")
    parser.add_argument("--height", type=float, default=60.0, metavar="M", help="at the start; 0: on the ground")
    parser.add_argument("--speed", type=float, default=1.0, help="flight seconds per real second")
    parser.add_argument("--seconds", type=float, default=60.0, help="of inertial data; afterwards they stand still")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ranges", action="store_true", help="a stand-in for the service sends DISTANCE_SENSOR")
    parser.add_argument("--obstacle", type=float, nargs=2, metavar=("NORTH", "EAST"), help="a pole, metres from home")
    options = parser.parse_args()
    try:
        _fly(options)
    except SpanwiseError as error:
        print(f"simulated_vehicle: {error}", file=sys.stderr)
        return 2
    return 0


def _fly(options: argparse.Namespace) -> None:
    links = options.link or ["udpout:127.0.0.1:14540"]
    airframe = load_airframe(options.airframe)
    for link in links:  # before the flight is built, which takes a while
        VehicleLink(link).close()
    print(f"building {options.seconds:g} s of {options.airframe} ...", flush=True)
    flight = build_flight(airframe, options.seed, options.seconds)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    vehicle = RehearsalVehicle(
        flight,
        links,
        height_m=options.height,
        speed=options.speed,
        ranges=options.ranges,
        obstacle_m=tuple(options.obstacle) if options.obstacle else None,
    )
    print("the vehicle is alive; Ctrl-C ends it", flush=True)
    vehicle.run(stop.is_set)


if __name__ == "__main__":
    raise SystemExit(main())
