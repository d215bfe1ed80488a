"""Options that all missions share."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.steps.numbers import integer, number, seconds
from companion.params.links import LinkAddress, parse_link
from mission_scripts.common.guard import Limits
from mission_scripts.common.outcome import MEANING, Response

# chosen: what an aircraft with these cameras can fly; a value beyond is a slip, and one that is no number no limit
metres = number(0.0, 1e5, "m")
height = number(-1e3, 1e4, "m")
degrees = number(-360.0, 360.0, "degrees")
speed = number(0.0, 300.0, "m/s")
millimetres = number(0.0, 1e4, "mm")
fullness = number(0.0, 1.0, "of full")
count = integer(1, 1000)
component = integer(1, 255)


def parser_for(name: str, text: str) -> argparse.ArgumentParser:
    """The command line of one mission, with the shared options in it; ``text`` is the script's docstring."""
    parser = argparse.ArgumentParser(
        prog=f"python -m mission_scripts.{name}", description=text, epilog=MEANING, allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument(
        "--connect", required=True, type=_link, metavar="LINK",
        help="MAVLink link: udpin:0.0.0.0:14540, tcp:host:port, /dev/ttyUSB0,57600 (or as MAVSDK spells it)",
    )  # fmt: skip
    parser.add_argument("--airframe", default="nadir-2m", metavar="NAME", help="name or path of the airframe file")
    parser.add_argument("--companion", type=component, default=191, metavar="ID", help="the service's component")
    parser.add_argument("--wait", type=seconds, default=15.0, metavar="S", help="for the autopilot to appear")
    _recording(parser.add_argument_group("recording"), name)
    _limits(parser.add_argument_group("limits; leaving them aborts"))
    parser.add_argument(
        "--on-abort", type=Response, default=Response.HOLD, choices=list(Response), metavar="hold|rtl",
        help="after Ctrl-C and the like; lost link, battery, failsafe and floor always mean rtl",
    )  # fmt: skip
    parser.add_argument(
        "--take-off", type=metres, metavar="M",
        help="arm and climb to this height first (AUTO take-off): above 1.1 times --floor, below --ceiling",
    )  # fmt: skip
    return parser


def _link(text: str) -> LinkAddress:
    try:
        return parse_link(text)
    except Exception as error:  # argparse prints this sentence, and no other kind of exception's
        raise argparse.ArgumentTypeError(str(error)) from error


def _recording(group: argparse._ArgumentGroup, name: str) -> None:
    group.add_argument("--out", type=Path, default=Path("out/missions") / name, metavar="FOLDER")
    group.add_argument("--no-tap", action="store_true", help="do not write flight.tlog from this link")
    group.add_argument(
        "--service", metavar="LINK",
        help="also run `spanwise run --record` on this link for the length of the mission",
    )  # fmt: skip


def _limits(group: argparse._ArgumentGroup) -> None:
    base = Limits()
    group.add_argument("--floor", type=height, default=base.floor_m, metavar="M", help="lowest height above home")
    group.add_argument("--ceiling", type=metres, default=base.ceiling_m, metavar="M", help="greatest height above home")
    group.add_argument("--radius", type=metres, default=base.radius_m, metavar="M", help="from where it began")
    group.add_argument("--off-track", type=metres, default=base.off_track_m, metavar="M", help="from the leg flown")
    group.add_argument("--battery", type=fullness, default=base.battery, metavar="0..1", help="least charge")
    group.add_argument("--link-loss", type=seconds, default=base.link_s, metavar="S", help="silence that is a loss")


def limits_from(options: argparse.Namespace) -> Limits:
    """The limits that were asked for."""
    return Limits(options.floor, options.ceiling, options.radius, options.battery, options.link_loss, options.off_track)
