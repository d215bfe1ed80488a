"""``spanwise simulate``: fly the simulated aircraft into a folder of tables, as a laboratory would have recorded it."""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path

from companion.cli.steps.effect_list import add_effect_list
from companion.cli.steps.numbers import flight_seconds, seed
from companion.cli.steps.options import make_folder
from companion.core.wing.effects import apply_to_airframe, catalogue
from companion.errors import ConfigError
from companion.params.airframe import NamedEffect
from companion.params.files import load_airframe
from companion.sim.flight.flight import build_flight
from companion.sim.flight.gust import GustKind
from companion.sim.flight.tables import write_csv

_MARK = "simulated.txt"  # name of the file that tells a simulated flight's folder from all others (convention)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--airframe", default="nadir-2m", metavar="NAME", help="name or path of an airframe file")
    parser.add_argument("--seed", type=seed, default=1, help="of everything random")
    parser.add_argument("--duration", type=flight_seconds, default=60.0, metavar="SECONDS", help="length of the flight")
    parser.add_argument("--gust", default="airframe", choices=[kind.value for kind in GustKind], help="its spectrum")
    parser.add_argument("--exact", action="store_true", help="fly the believed airframe, not one drawn from its priors")
    parser.add_argument(
        "--effect", action="append", default=[], metavar="NAME[=VALUE]",
        help="hide a named effect in the truth; VALUE is its first parameter (its prior sigma when left out)",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER",
        help=f"accel.csv, range.csv and {_MARK} go here: a new or empty folder, or one of an earlier simulate",
    )  # fmt: skip
    add_effect_list(
        parser,
        "The {count} effects that --effect hides. VALUE is the first parameter in the unit shown; the number shown is "
        "its prior sigma, which is taken where VALUE is left out. Those that follow a recorded channel cannot be flown "
        "here.",
    )


def execute(options: argparse.Namespace) -> int:
    """Fly and write."""
    airframe = load_airframe(options.airframe)
    effects = tuple(_effect(text) for text in options.effect)
    _check_folder(options.out)
    flight = build_flight(
        airframe,
        options.seed,
        options.duration,
        effects=effects,
        gust=GustKind(options.gust),
        perturbed=not options.exact,
    )
    # with what the airframe itself says, and without what is hidden from it
    wing = apply_to_airframe(dataclasses.replace(flight.real.actual, effects=airframe.effects)).wing
    stated = "".join(f"; airframe's effect: {effect.name} {effect.parameters}" for effect in airframe.effects)
    hidden = ", ".join(f"{effect.name} {effect.parameters}" for effect in effects) or "nothing"
    flown = (
        f"flew {options.duration:g} s of {airframe.name}, seed {options.seed}: "
        f"{wing.symmetric.frequency_hz.value:.3f} Hz, damping {wing.symmetric.damping.value:.4f}"
        f"{stated}; hidden: {hidden}"
    )
    make_folder(options.out)
    (options.out / _MARK).write_text(f"spanwise simulate {flown}\n", encoding="utf-8")
    write_csv(flight, options.out)
    print(f"{flown}; wrote {options.out}")
    return 0


def _check_folder(path: Path) -> None:
    """Refuse a folder whose files are not of an earlier simulated flight: measured tables would be lost."""
    if path.is_dir() and any(path.iterdir()) and not (path / _MARK).exists():
        raise ConfigError(f"--out {path}: holds other files already; name a new folder")


def _effect(text: str) -> NamedEffect:
    name, equals, value = text.partition("=")
    effects = catalogue()
    if name not in effects:
        raise ConfigError(f"no effect '{name}'; known: {', '.join(effects)}")
    if effects[name].follows_channel:
        raise ConfigError(
            f"--effect {text}: {name} follows a recorded channel, and the simulated flight has none that varies; "
            "hide frequency-drift or parametric-stiffness for a frequency that changes, or fly the blind trials "
            f"(python -m tools.trials --only {name}), which record a roller and an airspeed"
        )
    first = effects[name].parameters()[0]
    what = f"number ({first.name}, {first.unit or 'a ratio'})"
    try:
        number = float(value) if equals else first.sigma
    except ValueError as error:
        raise ConfigError(f"--effect {text}: '{value}' is not a {what}") from error
    if not math.isfinite(number):
        raise ConfigError(f"--effect {text}: '{value}' is not a finite {what}")
    if effects[name].one_way and number < 0.0:
        raise ConfigError(f"--effect {text}: no wing has a negative {first.name} ({first.doc})")
    return NamedEffect(name, {first.name: number})
