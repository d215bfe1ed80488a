"""``spanwise doctor``: look at a live vehicle or a log, say what is wrong, and the exact fix.

Exit codes beside those of every command: 0 nothing to fix, 4 something is to be fixed.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from companion.adapters.clocks import MonotonicClock
from companion.adapters.mavlink.link.link import open_link
from companion.adapters.mavlink.link.signing import load_signing
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.steps.airframe_check import check_airframe
from companion.cli.steps.numbers import seconds
from companion.cli.steps.options import add_settings, read_settings
from companion.cli.terminal.progress import say
from companion.doctor.clipping import check_clipping
from companion.doctor.evidence import Evidence, Finding, FindingLevel, Fix
from companion.doctor.examine import Examination, read_log
from companion.doctor.link import check_computer, check_link
from companion.doctor.parameters import check_parameters
from companion.doctor.ranging import check_ranging
from companion.doctor.timing import check_clocks, check_filters, check_rates
from companion.doctor.wing import check_cameras, check_nodes
from companion.errors import TO_FIX, ConfigError
from companion.params.files import load_airframe
from companion.ports import Clock

_TRIES = 3  # a parameter is set so often before it counts as refused (choice)
_ANSWER_NS = 1_000_000_000  # chosen: a parameter is answered within it over a radio link, or asked again
_CHECKS = (
    check_link,
    check_parameters,
    check_rates,
    check_clipping,
    check_filters,
    check_clocks,
    check_nodes,
    check_ranging,
    check_cameras,
    check_computer,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--connect", action="append", metavar="LINK", help="MAVLink link (see run); may be repeated")
    what.add_argument("--log", type=Path, metavar="FILE", help="a recording in place of a vehicle")
    parser.add_argument("--airframe", required=True, metavar="NAME", help="name or path of an airframe file")
    parser.add_argument("--for", type=seconds, default=10.0, metavar="SECONDS", dest="seconds", help="listen so long")
    parser.add_argument(
        "--fix", action="store_true", help="with --connect: offer to set the autopilot's parameters, one by one"
    )
    parser.add_argument("--yes", action="store_true", help="with --fix: do not ask")
    parser.add_argument("--json", action="store_true", help="the findings as JSON")
    parser.add_argument("--sign-key", type=Path, metavar="FILE", help="key of a signed link (see run)")
    add_settings(parser)


def execute(options: argparse.Namespace) -> int:
    """Examine, report, and fix where that is asked for."""
    _check(options)
    airframe = load_airframe(options.airframe)
    recording = None if options.log is None else open_recording(options.log, airframe)
    settings = read_settings(options, None if recording is None else recording.settings)
    check_airframe(airframe, settings)  # an orientation that cannot be would be offered to the autopilot
    if recording is not None:
        return _report(list(diagnose(read_log(recording, airframe, settings))), as_json=options.json)
    clock = MonotonicClock()
    signing = None if options.sign_key is None else load_signing(options.sign_key, clock)
    links = [open_link(spelling, clock, number, signing) for number, spelling in enumerate(options.connect)]
    examination = Examination(links, clock, airframe, settings, options.seconds, signing=signing)
    try:
        print(f"listening for {options.seconds:g} s ...", file=sys.stderr)
        while not examination.over:
            examination.run_once()
        findings = list(diagnose(examination.evidence()))
        code = _report(findings, as_json=options.json)
        if options.fix:
            ask = (lambda _: True) if options.yes else _ask
            tell = say if options.json else print
            left = apply([fix for entry in findings for fix in entry.fixes], examination, clock, ask, tell)
            wrong = [entry for entry in findings if entry.level is FindingLevel.FIX]
            code = TO_FIX if any(not entry.fixes or set(entry.fixes) & set(left) for entry in wrong) else 0
    finally:
        examination.pilot.close()
    return code


def _check(options: argparse.Namespace) -> None:
    """Refuse what would do nothing."""
    if options.yes and not options.fix:
        raise ConfigError("--yes is of --fix: give both")
    if options.log is not None and (options.fix or options.sign_key):
        raise ConfigError("--fix and --sign-key are of --connect: a log has no autopilot that answers")


def diagnose(evidence: Evidence) -> Iterator[Finding]:
    """All checks; where no autopilot is heard, what it would have told is not asked about."""
    for check in _CHECKS:
        yield from check(evidence)
        if check is check_link and evidence.live and evidence.pilot is None:
            return


def apply(
    fixes: list[Fix],
    examination: Examination,
    clock: Clock,
    ask: Callable[[Fix], bool],
    say: Callable[[str], None] = print,
) -> list[Fix]:
    """Set what the user agrees to, each until the autopilot confirms it.

    Returns what was not done.
    """
    remaining: list[Fix] = []
    done: list[Fix] = []
    for fix in dict.fromkeys(fixes):
        if not ask(fix):
            remaining.append(fix)
        elif _set(fix, examination, clock):
            done.append(fix)
            say(f"{fix.name} is now {fix.value:g}")
        else:
            remaining.append(fix)
            say(f"{fix.name}: the autopilot did not take {fix.value:g}")
    if any(fix.reboot for fix in done):
        say("reboot the autopilot: " + ", ".join(fix.name for fix in done if fix.reboot) + " acts from the next start")
    return remaining


def _set(fix: Fix, examination: Examination, clock: Clock) -> bool:
    parameters = examination.evidence().parameters
    for _ in range(_TRIES):
        parameters.pop(fix.name, None)
        examination.pilot.set_parameter(fix.name, fix.value)
        ends_ns = clock.now_ns() + _ANSWER_NS
        while clock.now_ns() < ends_ns and fix.name not in parameters:
            examination.run_once()
        value = parameters.get(fix.name)
        if value is not None and abs(value - fix.value) <= 1e-6 * max(1.0, abs(fix.value)):
            return True
    return False


def _ask(fix: Fix) -> bool:
    print(f"{fix}? [y/N] ", end="", file=sys.stderr, flush=True)  # standard output has the findings, maybe as JSON
    return input().strip().lower() in ("y", "yes")


def _report(findings: list[Finding], *, as_json: bool) -> int:
    wrong = [entry for entry in findings if entry.level is FindingLevel.FIX]
    if as_json:
        print(json.dumps([dataclasses.asdict(entry) for entry in findings], indent=2))
    else:
        for entry in findings:
            remedy = "".join(f"\n{'':17s}-> {fix}" for fix in entry.fixes)
            print(f"{entry.level:5s}{entry.subject:12s}{entry.text}{remedy}")
        print(f"{len(wrong)} to fix" if wrong else "nothing to fix")
    return TO_FIX if wrong else 0
