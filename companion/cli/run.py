"""``spanwise run``: the live service beside an autopilot."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path

from companion.adapters.triggers.mavlink import MavlinkTrigger
from companion.cli.flying import fly
from companion.cli.options import add_settings, read_settings, state_file
from companion.cli.view import View
from companion.errors import ConfigError
from companion.params.files import load_airframe
from companion.service.config import ServiceConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "--connect", action="append", required=True, metavar="LINK",
        help="MAVLink link in mavutil's spelling (udpin:0.0.0.0:14550, /dev/ttyAMA0,921600); may be repeated",
    )  # fmt: skip
    parser.add_argument("--airframe", required=True, metavar="NAME", help="name or path of an airframe file")
    parser.add_argument("--record", type=Path, metavar="FILE.mcap", help="record everything that goes in and out")
    parser.add_argument(
        "--parameters", type=Path, metavar="FILE",
        help="where what a ground station sets is kept (default: ~/.local/state/spanwise/<airframe>.parameters)",
    )  # fmt: skip
    parser.add_argument(
        "--trigger", choices=["none", "mavlink"], default="none",
        help="mavlink: the autopilot fires its own cameras at the planned instants (IMAGE_START_CAPTURE)",
    )  # fmt: skip
    parser.add_argument("--sign-key", type=Path, metavar="FILE", help="sign what is sent, accept only what is signed")
    parser.add_argument("--for", type=float, metavar="SECONDS", dest="seconds", help="stop after so long")
    parser.add_argument("--plain", action="store_true", help="a line every few seconds instead of the live view")
    add_settings(parser)


def execute(options: argparse.Namespace) -> int:
    """Run until Ctrl-C or SIGTERM (or for the given time)."""
    if options.record is not None and not options.record.parent.is_dir():
        raise ConfigError(f"--record {options.record}: no folder {options.record.parent}")
    if options.parameters is None:
        options.parameters = state_file(f"{Path(options.airframe).stem}.parameters")
    config = ServiceConfig(
        airframe=load_airframe(options.airframe),
        settings=read_settings(options),
        connections=tuple(options.connect),
        trigger=MavlinkTrigger if options.trigger == "mavlink" else None,
        recording=options.record,
        parameters=options.parameters,
        signing_key=options.sign_key,
    )
    ends = time.monotonic() + options.seconds if options.seconds else float("inf")
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stopped.append(caught))
    view = View(f"spanwise run {config.airframe.name} on {', '.join(config.connections)}")
    live = sys.stdout.isatty() and not options.plain
    began = time.monotonic()
    fly(config, view, lambda: bool(stopped) or time.monotonic() >= ends, live=live)
    print(view.line(time.monotonic() - began).strip())
    return 0
