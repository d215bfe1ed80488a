"""``spanwise setup``: install the service on a companion, guided; --dry-run looks first, --undo takes it back."""

from __future__ import annotations

import argparse
import difflib
import os
import sys
from pathlib import Path
from typing import Any

from companion.adapters.cameras.camera_factory import parse_cameras
from companion.adapters.triggers.trigger_factory import trigger_factory
from companion.cli.steps import setup_wing
from companion.errors import TO_FIX, SetupError, SpanwiseError
from companion.params.files import load_airframe
from companion.setup import manifest
from companion.setup.boards import BOARDS, CompanionBoard, board_of
from companion.setup.checks import SystemCheck, airframe_check, checks
from companion.setup.choices import Choices, answered, choices_for
from companion.setup.install import install, recorded, undo, undone
from companion.setup.manifest import Manifest
from companion.setup.next_steps import next_steps
from companion.setup.plan import Change, planned
from companion.setup.tree import Entry, File, Tree

_IN_AN_IMAGE = "/opt/spanwise/bin/spanwise"
_ASKED = {
    "links": "MAVLink links, the autopilot's first, with blanks between",
    "airframe": "airframe, a name or a file",
    "cameras": "cameras, as oak:CAM_B,CAM_C (- for none)",
    "trigger": "trigger, as serial:/dev/spanwise-trigger (- for none)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parts = parser.add_subparsers(dest="part", metavar="wing")
    text = "guided: nodes, axes and signs by hand, modes, stereo, first range, each with its figure"
    setup_wing.add_arguments(parts.add_parser("wing", help=text, description=text, allow_abbrev=False))
    parser.add_argument("--dry-run", action="store_true", help="show what would be written, and write nothing")
    parser.add_argument("--undo", action="store_true", help="put every file back to what it was before")
    parser.add_argument("--yes", action="store_true", help="ask nothing")
    parser.add_argument("--root", type=Path, default=Path("/"), metavar="FOLDER", help="a mounted image to set up")
    keys = [board.key for board in BOARDS]
    parser.add_argument("--board", choices=keys, help="instead of what the machine says that it is")
    parser.add_argument(
        "--link", action="append", dest="links", metavar="LINK",
        help="MAVLink link of the service (see run), the autopilot's first; may be repeated",
    )  # fmt: skip
    parser.add_argument("--airframe", metavar="NAME", help="name or path; default /etc/spanwise/wing.toml")
    parser.add_argument("--cameras", metavar="PAIR", help="as of run; - for none")
    parser.add_argument("--trigger", metavar="LINE", help="as of run; - for none")
    for port in ("left", "right", "trigger"):
        what = "trigger board" if port == "trigger" else f"{port} wing node"
        parser.add_argument(
            f"--serial-{port}", metavar="NUMBER", help=f"USB serial number of the {what}; default spanwise-{port}"
        )
    parser.add_argument(
        "--router", action=argparse.BooleanOptionalAction,
        help="configure mavlink-router for the first link, and listen to it (default: where it is installed)",
    )  # fmt: skip
    parser.add_argument("--program", metavar="FILE", help="the spanwise that the service starts; default: this one")


def execute(options: argparse.Namespace) -> int:
    """Check, ask, show, write, and name the next steps; 4 where a check has something to mend."""
    if options.part == "wing":
        return setup_wing.execute(options)
    tree = Tree(options.root)
    previous = manifest.load(tree)
    if options.undo:
        return _undo(tree, previous, options)
    previous = previous or Manifest()
    board = board_of(tree, options.board or previous.board or None)
    program = (
        options.program or previous.choices.get("program") or (_this_program() if _is_here(tree) else _IN_AN_IMAGE)
    )
    is_fit = _show_checks(tree, board, program)
    choices, answers = _answers(tree, board, previous, options)
    is_fit &= _show_results([airframe_check(tree, choices.airframe)])
    changes = planned(tree, board, choices, program, previous)
    _show(changes, contents=options.dry_run)
    if options.dry_run:
        print("nothing was written (--dry-run)")
    else:
        if any(change.changes for change in changes):
            _confirm(options)
        install(tree, changes, recorded(tree, changes, previous, answers, options.board or previous.board))
        _show_next(tree, choices, changes)
    return 0 if is_fit else TO_FIX


def _undo(tree: Tree, previous: Manifest | None, options: argparse.Namespace) -> int:
    if previous is None:
        raise SetupError(f"nothing to undo: {tree.root / manifest.NAME} is not there")
    changes = undone(tree, previous)
    _show(changes, contents=options.dry_run)
    if options.dry_run:
        print("nothing was written (--dry-run)")
        return 0
    _confirm(options)
    for name in undo(tree, changes, previous):
        print(f"  left     {tree.root / name} (the service's own, or yours; sudo rm -r)")
    if _is_here(tree):
        print("then: sudo systemctl stop spanwise; sudo systemctl daemon-reload; a restart gives the UART back")
    return 0


def _is_here(tree: Tree) -> bool:
    return tree.root == Path("/")


def _this_program() -> str:
    script = Path(sys.executable).parent / "spanwise"
    return str(script) if script.exists() else f"{sys.executable} -m companion.cli"


def _show_checks(tree: Tree, board: CompanionBoard, program: str) -> bool:
    return _show_results(checks(tree, board, program, os.environ.get("SUDO_USER", "") if _is_here(tree) else ""))


def _show_results(results: list[SystemCheck]) -> bool:
    for check in results:
        print(f"  {'ok' if check.passes else 'mend':8} {check.name:8} {check.figure}")
        if check.remedy:
            print(f"{'':20}{check.remedy}")
    return all(check.passes for check in results)


def _answers(
    tree: Tree, board: CompanionBoard, previous: Manifest, options: argparse.Namespace
) -> tuple[Choices, dict[str, Any]]:
    """The choices, and those of them that somebody made: a suggestion that is taken over is none."""
    overrides: dict[str, Any] = {
        name: "" if value == "-" else value for name, value in vars(options).items() if value is not None
    }
    answers = answered(previous.choices, overrides)
    choices = _checked(choices_for(board, tree, answers))
    if options.yes or options.dry_run or not sys.stdin.isatty():
        return choices, answers
    while True:
        asked = {name: _ask(text, getattr(choices, name)) for name, text in _ASKED.items() if name not in overrides}
        chosen = {name: answer for name, answer in asked.items() if answer != getattr(choices, name)}
        try:
            return _checked(choices_for(board, tree, {**answers, **chosen})), {**answers, **chosen}
        except SpanwiseError as error:
            print(error, file=sys.stderr)


def _checked(choices: Choices) -> Choices:
    """The choices, whose airframe's name, cameras and trigger are refused here if ``spanwise run`` would refuse them.

    A file of an airframe may be made later.
    """
    if not Path(choices.airframe).suffix:
        load_airframe(choices.airframe)
    trigger_factory(choices.trigger or "none")
    if choices.cameras:
        parse_cameras(choices.cameras, soft=choices.trigger.partition(":")[0] == "oak")
    return choices


def _ask(text: str, suggestion: str | tuple[str, ...]) -> str | tuple[str, ...]:
    shown = suggestion if isinstance(suggestion, str) else " ".join(suggestion)
    said = input(f"{text} [{shown or '-'}]: ").strip() or shown
    if not isinstance(suggestion, str):
        return tuple(said.split())
    return "" if said == "-" else said


def _confirm(options: argparse.Namespace) -> None:
    if options.yes:
        return
    if not sys.stdin.isatty():
        raise SetupError("there is no terminal to ask at: give --yes, or --dry-run to look only")
    if input("write these? [y/N] ").strip().lower() not in ("y", "yes"):
        raise SetupError("nothing was written")


def _show(changes: list[Change], *, contents: bool) -> None:
    if not any(change.changes for change in changes):
        print(f"  ok       files    {len(changes)} as they should be")
    for change in changes:
        if not change.changes and not change.note:
            continue
        note = f"  ({change.note})" if change.note else ""
        print(f"  {change.word:8} /{change.name}{note}")
        if contents and change.changes:
            for line in _difference(change):
                print(f"           {line}")


def _difference(change: Change) -> list[str]:
    lines = difflib.unified_diff(_lines(change.now), _lines(change.then), n=0, lineterm="")
    return [line for line in lines if not line.startswith(("---", "+++", "@@"))]


def _lines(entry: Entry | None) -> list[str]:
    return entry.data.decode(errors="replace").splitlines() if isinstance(entry, File) else []


def _show_next(tree: Tree, choices: Choices, changes: list[Change]) -> None:
    on_uart = [change for change in changes if change.name.startswith("boot/") or change.word == "disable"]
    restart = any(change.changes for change in on_uart)
    print("next:")
    for number, step in enumerate(next_steps(choices, here=_is_here(tree), restart=restart), 1):
        print(f"  {number:2} {step.purpose}\n       {step.command}")
