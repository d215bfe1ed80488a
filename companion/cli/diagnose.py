"""``spanwise diagnose``: what the simulation gets wrong on a recording, why, and what it is worth to know."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path

from companion.cli.evidence import airframe_of, load
from companion.cli.report_html import write_report
from companion.core.wing.effects import catalogue
from companion.diagnosis.belief import believe
from companion.diagnosis.observations import observe
from companion.diagnosis.report import as_json, sentence
from companion.diagnosis.search import Diagnosis, diagnose
from companion.diagnosis.supermodel import SuperModel
from companion.params.airframe import Airframe, NamedEffect
from companion.params.files import dump_airframe

_LOAD_VARIES = 0.02
_TOP = 8.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("recordings", nargs="+", metavar="RECORDING", help=".mcap, .tlog, .BIN, .ulg, or a CSV folder")
    parser.add_argument("--airframe", metavar="NAME", help="what is believed; needed unless the recording brings it")
    parser.add_argument("--json", metavar="FILE", help="write the findings as JSON ('-': to standard output)")
    parser.add_argument("--html", metavar="FILE", help="write the report, one self-contained page")
    parser.add_argument(
        "--apply", metavar="FILE", nargs="?", const="", help="write the airframe with the named effects"
    )
    parser.add_argument("--max-causes", type=int, default=3, metavar="N", help="name at most N effects (default 3)")


def execute(options: argparse.Namespace) -> int:
    """Diagnose; every verdict is exit code 0."""
    airframe = airframe_of(options.airframe, options.recordings)
    models = [_model(path, airframe) for path in options.recordings]
    found = diagnose(models, list(catalogue().values()), options.max_causes, _Progress(options.json != "-"))
    plain = as_json(found, models, options.recordings)
    if options.json == "-":
        print(json.dumps(plain, indent=2, allow_nan=False))
    else:
        _tell(found, plain)
        if options.json:
            Path(options.json).write_text(json.dumps(plain, indent=2) + "\n", encoding="utf-8")
    if options.html:
        write_report(found, models, plain, Path(options.html))
    if options.apply is not None and found.causes:
        path = Path(options.apply or f"{airframe.name}-extended.toml")
        path.write_text(dump_airframe(extended(airframe, found)), encoding="utf-8")
        if options.json != "-":
            print(f"wrote {path}: {airframe.name} with {', '.join(cause.part.effect.name for cause in found.causes)}")
    return 0


def extended(airframe: Airframe, found: Diagnosis) -> Airframe:
    """The airframe with the named effects in force."""
    named = [
        NamedEffect(
            cause.part.effect.name,
            dict(zip([entry.name for entry in cause.part.effect.parameters()], cause.values, strict=True)),
        )
        for cause in found.causes
    ]
    return dataclasses.replace(airframe, effects=(*airframe.effects, *named))


def _model(path: str, airframe: Airframe) -> SuperModel:
    wing = airframe.wing
    modes = [wing.symmetric, wing.antisymmetric, wing.second_symmetric, wing.second_antisymmetric]
    present = [mode.frequency_hz.value for mode in modes if mode is not None]
    top_hz = max(_TOP * present[0], 1.6 * max(present))
    seen = observe(load(Path(path), airframe), airframe, top_hz)
    varies = float(seen.load_factor.std()) > _LOAD_VARIES
    return SuperModel(believe(airframe, seen.sides, seen.toe is not None, varies), seen, top_hz)


def _tell(found: Diagnosis, plain: dict[str, object]) -> None:
    print(f"verdict: {sentence(found)}")
    for cause in found.causes:
        print(f"  {cause.part.effect.name}: log Bayes factor {cause.log_bayes_factor:.1f}, BIC {cause.bic:+.1f}")
        for entry, value, sigma in zip(cause.part.effect.parameters(), cause.values, cause.sigmas, strict=True):
            print(f"    {entry.name} = {value:.5g} ± {sigma:.2g} {entry.unit} ({entry.doc})")
        if cause.group:
            print(f"    cannot be told from {', '.join(cause.group)}: {cause.part.effect.advice or 'record more'}")
    if found.gain is not None:
        value, low, high = found.gain.log_score["total"]
        print(f"  held-out gain {value:.1f} nat (95 %: {low:.1f} to {high:.1f})")
        for distance, (before, after) in found.gain.range_rms_m.items():
            print(f"  range error at {distance:g} m: {before:.2f} -> {after:.2f} m rms")
    notes = plain["notes"]
    assert isinstance(notes, list)
    for note in notes:
        print(f"  note: {note}")


class _Progress:
    """One line that says what is being done."""

    def __init__(self, shown: bool) -> None:
        self._shown = shown and sys.stderr.isatty()

    def __call__(self, what: str, share: float) -> None:
        if self._shown:
            print(f"\r\033[K{what} {100 * share:3.0f} %", end="\r", file=sys.stderr, flush=True)
