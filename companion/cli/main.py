"""``spanwise``: every command behind one name.

Exit codes: 0 done; 1 bad input or a dead device (the message says what to do); 2 wrong usage; 3 done, but there was
nothing to estimate (no mode, no ranges, nothing to be told from a recording); 4 the doctor or the set-up found
something to mend; 130 stopped by Ctrl-C before the end.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from companion.errors import SpanwiseError

_COMMANDS = {
    "run": "the live service beside an autopilot",
    "demo": "a simulated aircraft and the live service: corrected against uncorrected ranges",
    "simulate": "fly the simulated aircraft into a recording",
    "vehicle": "the simulated aircraft on a link: try run and doctor without hardware",
    "replay": "estimate again from a recording",
    "report": "one flight as a page: could its ranges be trusted, and why not",
    "info": "what a recording holds: streams, rates, gaps, losses",
    "convert": "a recording as a telemetry log (.tlog) or as CSV tables",
    "tune": "parameter values proposed from a recording, with what each would have changed",
    "fleet": "report, diagnose, identify or tune many flights into one table and page",
    "paper": "reproduce and audit the paper, table by table and figure by figure",
    "doctor": "look at a live vehicle or a log: what is wrong, and the exact fix",
    "diagnose": "what the simulation gets wrong on a recording, why, and what it is worth",
    "calibrate": "the stereo rig from images of a board, the cameras' mounting, the trigger latency",
    "identify": "wing modes from a ground vibration test or a flight, written as an airframe",
    "new-airframe": "the first airframe file of an aircraft, from span, frequency, mass and cameras",
    "setup": "install the service on a companion (Raspberry Pi, Jetson), and take it back",
    "params": "the settings table: show, check or write config/PARAMETERS.md",
}

_ONE_THREAD = ("diagnose", "fleet")
"""Many small systems: threads of linear algebra that wait for one another take longer, beside other work much."""


class _WithDefaults(argparse.HelpFormatter):
    """Help that says each option's default, where it has one, and keeps the lines of a text that has several."""

    def _get_help_string(self, action: argparse.Action) -> str:
        text, default = action.help or "", action.default
        says = isinstance(default, str | int | float | Path | tuple) and not isinstance(default, bool)
        if not (action.option_strings and says) or default in ("", argparse.SUPPRESS) or "default" in text:
            return text
        values = default if isinstance(default, tuple) else (default,)
        return f"{text} (default: {' '.join(f'{v:g}' if isinstance(v, float) else str(v) for v in values)})"

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if "\n" in text else super()._fill_text(text, width, indent)


class _CommandParser(argparse.ArgumentParser):
    """Parser of a command and, as argparse makes them of the same class, of its parts."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **{"formatter_class": _WithDefaults, **options})


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """The whole command line; with ``only``, that command's options alone: the other rooms take seconds to load."""
    parser = argparse.ArgumentParser(
        prog="spanwise", description="Stereo ranges that stay true while the wing bends.", allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"spanwise {metadata.version('spanwise')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command", parser_class=_CommandParser)
    for name, text in _COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text, allow_abbrev=False)
        if only in (None, name):
            _module(name).add_arguments(command)
    return parser


def _module(command: str) -> Any:
    return importlib.import_module(f"companion.cli.{command.replace('-', '_')}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; never a traceback for a bad input, a full disk, a closed pipe or Ctrl-C."""
    words = [_at_home(word) for word in (sys.argv[1:] if arguments is None else arguments)]
    name = words[0] if words and words[0] in _COMMANDS else ""
    if name in _ONE_THREAD:  # before numpy is loaded
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):  # as standard error: a file's name may be of any bytes
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        options = build_parser(words[0] if words else "").parse_args(words)
        code: int = _module(options.command).execute(options)
        sys.stdout.flush()
    except SpanwiseError as error:
        return _failed(name, str(error))
    except KeyboardInterrupt:
        return _failed(name, "stopped", code=130)
    except BrokenPipeError:
        return _failed(name, "standard output was closed before the end")
    except EOFError:
        return _failed(name, "standard input ended where an answer was asked for")
    except MemoryError:
        return _failed(name, "not enough memory")
    except OSError as error:
        where = f"{error.filename}: " if error.filename is not None else ""
        return _failed(name, f"{where}{error.strerror or error}")
    return code


def _at_home(word: str) -> str:
    """The word, with a quoted ``~/`` as the shell takes it where it is not quoted; of an option behind its sign."""
    option, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
    return option + equals + (os.path.expanduser(value) if value.startswith("~/") else value)


def _failed(name: str, sentence: str, code: int = 1) -> int:
    """Say it, and let nothing be said of it again when the interpreter ends."""
    print(f"{f'spanwise {name}'.strip()}: {sentence}", file=sys.stderr)
    try:
        sys.stdout.flush()
    except OSError:  # a closed pipe or a full disk, told above
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code
