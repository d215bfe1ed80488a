"""``spanwise demo``: a simulated aircraft speaks MAVLink to the service; then its truth judges the flight.

Vehicle and service keep step: simulated time waits for both, and for the renderer, so that the figures are those of the
method on any machine, and equal for equal seeds. ``--realtime`` flies beside the live service's processes instead;
``--landing`` lets an autopilot land by the ranges.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from companion.cli.steps.demo_realtime import fly_in_real_time
from companion.cli.steps.landing_demo import land
from companion.cli.steps.live_view import add_live, live_session, read_live
from companion.cli.steps.lockstep import lock_step_service
from companion.cli.steps.numbers import flight_seconds, integer, seed
from companion.cli.steps.options import add_settings, make_folder, read_settings
from companion.cli.terminal.demo_tables import print_summary
from companion.cli.terminal.progress import say
from companion.cli.terminal.run_loop import run_service
from companion.cli.terminal.status_view import View, live_view_possible
from companion.errors import NOTHING_TO_ESTIMATE, ConfigError
from companion.evaluation.flight_evaluation import evaluate_flight
from companion.evaluation.pages.demo_picture import draw
from companion.evaluation.rendered_shots import Stage
from companion.live.about import ViewKind
from companion.live.session import Subject
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.reporting.plotting import require_report
from companion.service.config import ServiceConfig
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.world_draw import as_calibrated
from companion.sim.flight.worlds import IDEAL, WORLDS
from companion.sim.vehicle.lockstep import EPOCH_NS

_FILES = ("flight.mcap", "summary.json", "summary.png")
_MARK = "demo.txt"  # name of the file that tells a demo's folder from all others, from its beginning (convention)
_KEY = "toe_error_mrad"  # of every demo's summary, those without a mark too (convention)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--airframe", default="nadir-2m", metavar="NAME", help="an airframe with two cameras")
    parser.add_argument("--seed", type=seed, default=1, help="of the flight: gusts, true airframe, noise")
    parser.add_argument("--duration", type=flight_seconds, default=60.0, metavar="SECONDS", help="length of the flight")
    parser.add_argument("--out", type=Path, default=Path("out/demo"), metavar="FOLDER", help="where the results go")
    parser.add_argument(
        "--world",
        choices=list(WORLDS),
        default=IDEAL.name,
        help="what the aircraft flies in; the README's figures are of fair",
    )
    parser.add_argument("--json", action="store_true", help="print summary.json instead of the tables")
    parser.add_argument("--plain", action="store_true", help="a line every few seconds instead of the live view")
    parser.add_argument("--no-compare", action="store_true", help="leave out the two comparison replays")
    parser.add_argument(
        "--realtime", action="store_true",
        help="fly beside the live service's processes, in real time: figures are those of this machine, too",
    )  # fmt: skip
    parser.add_argument(
        "--landing", action="store_true",
        help="land instead: a small autopilot flies by rigid stereo, by Spanwise and by the true range",
    )  # fmt: skip
    parser.add_argument("--flights", type=integer(1, 1000), default=1, help="landings of each kind, with --landing")
    parser.add_argument(
        "--workers", type=integer(1, 256), default=os.cpu_count() or 1, help="processes, with --landing"
    )
    add_live(parser)
    add_settings(parser)


def execute(options: argparse.Namespace) -> int:
    """Fly, judge, show; or land."""
    require_report()
    airframe = load_airframe(options.airframe)
    if airframe.left_camera is None or airframe.right_camera is None:
        raise ConfigError(f"airframe '{airframe.name}' has no camera pair; the demo needs one")
    if options.flights > 1 and not options.landing:
        raise ConfigError("--flights is of --landing: give both")
    settings = read_settings(options)
    if options.landing:
        make_folder(options.out)
        return land(airframe, settings, options)
    return _fly_and_judge(airframe, settings, options)


def _fly_and_judge(airframe: Airframe, settings: Settings, options: argparse.Namespace) -> int:
    recording = options.out / "flight.mcap"
    world = WORLDS[options.world]
    airframe = as_calibrated(airframe, world)
    live = read_live(options, recording)
    make_folder(options.out)
    _check_folder(options.out)
    config = ServiceConfig(airframe, settings, (), recording=recording, live=live)
    say(f"building flight {options.seed} of {airframe.name} ({options.duration:g} s, {world.name} world) ...")
    flight = build_flight(airframe, options.seed, options.duration, world=world)
    flown = f"{options.duration:g} s of {airframe.name}, seed {options.seed}, {world.name} world"
    (options.out / _MARK).write_text(f"spanwise demo flew {flown}\n", encoding="utf-8")
    for old in _FILES:
        (options.out / old).unlink(missing_ok=True)
    start_host_ns, report = _flown(config, flight, options)
    say("judging the flight by its truth ...")
    stage = Stage.of(flight, config.settings, start_host_ns)
    summary = evaluate_flight(flight, stage, recording, report, compare=not options.no_compare, say=say)
    text = json.dumps(summary.plain, indent=2)
    (options.out / "summary.json").write_text(text + "\n", encoding="utf-8")
    judged = summary.plain["shots"]["judged"]
    if judged:
        draw(summary, options.out / "summary.png")
    print(text) if options.json else print_summary(summary.plain)
    picture = f", {options.out / 'summary.png'}" if judged else ""
    say(f"wrote {options.out / 'summary.json'}{picture} and {recording}")
    say(f"next: spanwise report {recording}, and spanwise replay {recording} --live for a browser")
    return 0 if judged else NOTHING_TO_ESTIMATE


def _check_folder(folder: Path) -> None:
    """Refuse a folder with files of these names that no demo wrote: a flight that was recorded would be lost."""
    strange = [name for name in _FILES if (folder / name).exists()]
    summary = folder / "summary.json"
    ours = (folder / _MARK).exists() or (summary.is_file() and _KEY in summary.read_text("utf-8", "replace"))
    if strange and not ours:
        raise ConfigError(f"--out {folder}: holds a {strange[0]} that no demo wrote; name a new folder")


def _flown(config: ServiceConfig, flight: Flight, options: argparse.Namespace) -> tuple[int, dict[str, Any]]:
    """Fly; give the host time of boot time 0, and what the vehicle reports."""
    view = View(f"spanwise demo {flight.airframe.name}, seed {flight.seed}")
    live = live_view_possible(plain=options.plain or options.json)
    if options.realtime:
        return fly_in_real_time(config, flight, view, live=live)
    subject = Subject(
        config.airframe, config.settings, f"demo, seed {flight.seed}", is_recording=True, kind=ViewKind.DEMO,
        began_host_ns=EPOCH_NS,
    )  # fmt: skip
    with live_session(config.live, subject) as watched:
        service = lock_step_service(config, flight, watched)
        view.progress = service.progress()

        def wait(real_s: float) -> None:
            service.wait(real_s)
            view.progress = service.progress()

        run_service(service, view, service.over, live=live, wait=wait)
    return EPOCH_NS, service.report()
