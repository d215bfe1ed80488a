"""``spanwise setup wing``: from an installed service to the first range, each step with a figure that passes or not."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from companion.adapters.clocks import MonotonicClock
from companion.adapters.mavlink.link.link import Link, open_link
from companion.adapters.mavlink.link.signing import load_signing
from companion.calibration.boards import LEAST_SQUARES, MOST_SQUARES
from companion.cli import calibrate, run
from companion.cli.doctor import diagnose
from companion.cli.steps.airframe_check import check_airframe
from companion.cli.steps.numbers import integer, number, seconds
from companion.cli.steps.options import add_settings, read_settings
from companion.cli.steps.wing_guide import SAMPLES, GuideStep, WingGuide
from companion.cli.terminal.run_loop import run_service
from companion.cli.terminal.status_view import View
from companion.doctor.examine import Examination
from companion.errors import TO_FIX, ConfigError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.ports import Clock
from companion.records import CorrectedRange, Record
from companion.service.wiring import Service
from companion.sim.rehearsal.bench import Gesture, Handling, Miswiring, bench_flight
from companion.sim.vehicle.lockstep import LockStepClock, MemoryWire
from companion.sim.vehicle.world import World, WorldOptions

BENCH_STEPS = ("nodes", "taps", "tilts", "modes")
STEPS = (*BENCH_STEPS, "stereo", "range")
SIMULATED = "sim"
_LOOK_NS = 2_000_000  # of simulated time between two looks at the link (choice)
_PLUCKS, _PLUCK_S = 16, 3.1  # of the simulated hand, and the time between two (choice)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "--connect", action="append", required=True, metavar="LINK",
        help=f"MAVLink link (see run), may be repeated; {SIMULATED}: rehearse with a simulated aircraft and hand",
    )  # fmt: skip
    parser.add_argument("--airframe", required=True, metavar="NAME", help="name or path of an airframe file")
    parser.add_argument("--step", action="append", choices=STEPS, dest="steps", help="this one alone; may be repeated")
    parser.add_argument("--cameras", metavar="PAIR", help="as of run, for stereo and range; sim: rehearse stereo")
    parser.add_argument("--trigger", default="none", metavar="LINE", help="as of run, for the first range")
    parser.add_argument("--square-m", type=number(0.0, 10.0, "m"), metavar="M", help="side of the board's squares")
    parser.add_argument(
        "--squares", type=integer(LEAST_SQUARES, MOST_SQUARES), nargs=2, default=(10, 7), metavar="N",
        help="of the ChArUco board",
    )  # fmt: skip
    parser.add_argument("--for", type=seconds, default=10.0, metavar="SECONDS", dest="seconds", help="listen so long")
    parser.add_argument(
        "--range-within", type=seconds, default=300.0, metavar="SECONDS", help="longest wait for the first range"
    )
    parser.add_argument("--sign-key", type=Path, metavar="FILE", help="key of signed links (see run)")
    parser.add_argument("--out", type=Path, default=Path("out/wing"), metavar="FOLDER", help="where results are put")
    add_settings(parser)


def execute(options: argparse.Namespace) -> int:
    """Go through the steps; 4 where one is left to mend."""
    airframe, settings = load_airframe(options.airframe), read_settings(options)
    check_airframe(airframe, settings)
    steps = [name for name in STEPS if name in (options.steps or STEPS) and (options.steps or _can(name, options))]
    for name in steps:
        if not _can(name, options):
            raise ConfigError(f"--step {name}: needs {'--cameras and --square-m' if name == 'stereo' else '--cameras'}")
    results = _on_the_bench([name for name in steps if name in BENCH_STEPS], airframe, settings, options)
    if results and results[-1].name == SAMPLES:
        return _summary(results, steps)
    flown = options.airframe
    if "stereo" in steps:
        results += _stereo(options)
        flown = str(_calibrated(options))
    if "range" in steps:
        results += _first_range(options, flown)
    return _summary(results, steps)


def _can(step: str, options: argparse.Namespace) -> bool:
    if step == "stereo":
        return options.cameras is not None and options.square_m is not None
    return step != "range" or (options.cameras not in (None, SIMULATED) and SIMULATED not in options.connect)


def _on_the_bench(
    steps: list[str], airframe: Airframe, settings: Settings, options: argparse.Namespace
) -> list[GuideStep]:
    """Steps that need nothing but nodes, autopilot and a hand."""
    if not steps:
        return []
    clock: Clock = MonotonicClock()
    signing = None if options.sign_key is None else load_signing(options.sign_key, clock)
    if options.connect == [SIMULATED]:
        links, clock, wait = rehearsal(airframe, steps, options.seconds)
    else:
        links = [open_link(spelling, clock, n, signing) for n, spelling in enumerate(options.connect)]
        wait = _no_pause

    def examine(each: Callable[[Record], None]) -> Examination:
        return Examination(links, clock, airframe, settings, options.seconds, each, signing=signing)

    guide = WingGuide(examine, lambda held: list(diagnose(held.evidence())), airframe, clock, _ask, wait)
    results = []
    try:
        for name in steps:
            for step in getattr(guide, name)():
                _show(step)
                results.append(step)
            if results and results[-1].name == SAMPLES:
                break
    finally:
        guide.close()
    return results


def _no_pause() -> None:
    """A real link is waited for where it is read."""


def rehearsal(
    airframe: Airframe, steps: list[str], listened_s: float, miswiring: Miswiring | None = None
) -> tuple[list[Link], Clock, Callable[[], None]]:
    """Link, clock and pause of a simulated aircraft on a bench, whose person does what the guide asks for."""
    script, duration_s = _script(steps, listened_s)
    wire = MemoryWire()
    world = World(bench_flight(airframe, 1, duration_s, script, miswiring), WorldOptions(), wire)
    clock = LockStepClock(world)
    return [Link(0, SIMULATED, wire, clock)], clock, lambda: clock.sleep_until(clock.now_ns() + _LOOK_NS)


def _script(steps: list[str], listened_s: float) -> tuple[list[Handling], float]:
    """Motions of the hand at fixed times, by which the step before has ended, and when all is over, s."""
    at_s, script = 1.0 + (listened_s if "nodes" in steps else 0.0), list[Handling]()
    if "taps" in steps:
        script += [Handling(Gesture.TAP_LEFT, at_s + 4.0), Handling(Gesture.TAP_RIGHT, at_s + 8.0)]
        at_s += 11.0
    if "tilts" in steps:
        script += [Handling(Gesture.RIGHT_WING_DOWN, at_s + 3.0), Handling(Gesture.NOSE_UP, at_s + 18.0)]
        at_s += 33.0
    if "modes" in steps:
        kinds = (Gesture.PLUCK_BOTH, Gesture.PLUCK_ACROSS)
        script += [Handling(kinds[n % 2], at_s + 1.0 + _PLUCK_S * n) for n in range(_PLUCKS)]
        at_s += 1.0 + _PLUCK_S * _PLUCKS
    return script, at_s + 5.0


def _calibrated(options: argparse.Namespace) -> Path:
    """Airframe file that the stereo step writes."""
    folder: Path = options.out / "stereo"
    return folder / "airframe.toml"


def _stereo(options: argparse.Namespace) -> list[GuideStep]:
    """The calibration from a board, as ``spanwise calibrate stereo`` does it."""
    _ask("hold the board before both cameras, and follow what is said")
    words = ["stereo", "--cameras", options.cameras, "--square-m", f"{options.square_m:g}"]
    words += ["--squares", *map(str, options.squares)]
    words += ["--airframe", options.airframe, "--out", str(_calibrated(options).parent)]
    parser = argparse.ArgumentParser(prog="spanwise calibrate")
    calibrate.add_arguments(parser)
    calibrate.execute(parser.parse_args(words))
    step = GuideStep("stereo", f"calibrated; {_calibrated(options)} is the airframe file to go on with")
    _show(step)
    return [step]


def _first_range(options: argparse.Namespace, airframe: str) -> list[GuideStep]:
    """The service itself with this airframe file, until it publishes a range."""
    words = [word for link in options.connect for word in ("--connect", link)]
    words += ["--airframe", airframe, "--cameras", options.cameras, "--trigger", options.trigger]
    words += [] if options.sign_key is None else ["--sign-key", str(options.sign_key)]
    words += [] if options.settings is None else ["--settings", str(options.settings)]
    words += [word for change in options.changes for word in ("--set", change)]
    parser = argparse.ArgumentParser(prog="spanwise run")
    run.add_arguments(parser)
    config = run.service_config(parser.parse_args([*words, "--plain"]))
    clock, trusted = MonotonicClock(), list[CorrectedRange]()
    ends_ns = clock.now_ns() + round(options.range_within * 1e9)
    _ask(f"waiting at most {options.range_within:g} s for the first range that is trusted")

    def take(record: Record) -> None:
        if isinstance(record, CorrectedRange) and record.trusted:
            trusted.append(record)

    began_ns = clock.now_ns()
    view = View(f"spanwise setup wing on {', '.join(options.connect)}", options.range_within)
    run_service(Service(config), view, lambda: bool(trusted) or clock.now_ns() > ends_ns, live=False, each=take)
    took_s = (clock.now_ns() - began_ns) * 1e-9
    if trusted:
        step = GuideStep("range", f"{trusted[0].range_m:.2f} ±{trusted[0].sigma_m:.2f} m after {took_s:.0f} s")
    else:
        step = GuideStep("range", f"none in {took_s:.0f} s", "the last line above says why; config/TROUBLESHOOTING.md")
    _show(step)
    return [step]


def _ask(sentence: str) -> None:
    print(f"* {sentence}", flush=True)


def _show(step: GuideStep) -> None:
    print(f"  {'mend' if step.remedy else 'ok':8} {step.name:10} {step.figure}", flush=True)
    if step.remedy:
        print(f"{'':22}{step.remedy}", flush=True)


def _summary(results: list[GuideStep], steps: list[str]) -> int:
    wrong = [step for step in results if step.remedy]
    print(f"{len(wrong)} to mend" if wrong else f"all of {', '.join(steps)} pass")
    if "range" not in steps and not wrong:
        print("next: the trim flight, level over ground of known height (config/SETUP.md), and the first range")
    return TO_FIX if wrong else 0
