"""``spanwise diagnose``: what the simulation gets wrong on a recording, why, and what it is worth to know."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from companion.adapters.recordings.tables.mapping import FLIGHT, TableMapping, load_mapping
from companion.cli.steps.effect_list import add_effect_list
from companion.cli.steps.numbers import integer
from companion.cli.steps.options import check_ending, check_new, check_output
from companion.core.wing.effects import catalogue
from companion.diagnosis.flights.json_report import as_json
from companion.diagnosis.flights.outcome import FlightDiagnosis, sentence
from companion.diagnosis.flights.recordings import diagnose
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.summary import summary_sentences
from companion.errors import NOTHING_TO_ESTIMATE
from companion.evaluation import measured_structures, sampling_check
from companion.evaluation.extended_airframe import extended
from companion.evaluation.findings_output import write_findings
from companion.evaluation.flight_models import models_of
from companion.evaluation.pages.diagnosis_page import diagnosis_page
from companion.evaluation.recorded_evidence import airframe_of
from companion.params.airframe import Airframe
from companion.params.files import dump_airframe
from companion.reporting.plotting import require_report

_NOTHING_TO_APPLY = "--apply: no effect was named that an airframe has, so no airframe was written"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="RECORDING",
        help=".mcap, .tlog, .BIN, .ulg, a CSV folder, or with --mapping a table or a folder of tables",
    )
    parser.add_argument("--airframe", metavar="NAME", help="what is believed; needed unless the recording brings it")
    parser.add_argument(
        "--mapping", metavar="NAME", help="how to read a table in another layout: a name, or the path of a .toml file"
    )
    parser.add_argument("--json", metavar="FILE", help="write the findings as JSON ('-': to standard output)")
    parser.add_argument("--html", metavar="FILE", help="write the report, one self-contained page")
    parser.add_argument(
        "--apply", metavar="FILE", nargs="?", const="", help="write the airframe with the named effects"
    )
    parser.add_argument(
        "--max-causes", type=integer(0, 10), default=3, metavar="N", help="name at most N effects (default 3)"
    )
    add_effect_list(
        parser,
        "The {count} causes that a diagnosis can name, with the prior sigma of the first parameter (what was believed "
        "before the recording). Anything else comes out as unexplained.",
    )


def execute(options: argparse.Namespace) -> int:
    """Diagnose; a verdict is exit code 0, that nothing can be told from these recordings 3."""
    inputs = [Path(name) for name in (*options.recordings, options.airframe, options.mapping) if name]
    for option, ending in (("json", ".json"), ("html", ".html"), ("apply", ".toml")):
        path = Path(getattr(options, option)) if getattr(options, option) else None
        check_output(path, f"--{option}", inputs)
        check_ending(path, f"--{option}", ending)
    if options.html:
        require_report()
    progress = partial(_show_progress, options.json != "-" and sys.stderr.isatty())
    mapping = load_mapping(options.mapping) if options.mapping is not None else None
    if mapping is not None and mapping.test != FLIGHT:
        return measured_structures.execute(options, mapping, progress)
    return _diagnose_flights(options, mapping, progress)


def _diagnose_flights(
    options: argparse.Namespace, mapping: TableMapping | None, progress: Callable[[str, float], None]
) -> int:
    airframe = airframe_of(options.airframe, options.recordings)
    if options.apply is not None:
        options.apply = options.apply or f"{airframe.name}-extended.toml"
        check_output(Path(options.apply), "--apply")  # its name may hold a slash, and this folder may take no file
        check_new(Path(options.apply), "--apply")
    paths = sampling_check.paths_of(options.recordings, mapping)
    timings = [sampling_check.timing(path, airframe, mapping) for path in paths]
    if not all(timing.can_be_judged for timing in timings):
        if options.apply is not None:
            print(_NOTHING_TO_APPLY, file=sys.stderr)
        return sampling_check.not_identifiable(timings, options, airframe.name)
    models = models_of(paths, airframe, mapping)
    diagnosis = diagnose(models, list(catalogue().values()), options.max_causes, progress)
    plain = as_json(diagnosis, models, options.recordings, bool(options.json or options.html))
    plain["notes"] = [*dict.fromkeys([note for timing in timings for note in timing.notes] + plain["notes"])]
    plain["tones"] = [tone for timing in timings for tone in timing.tones]
    plain["words"] = summary_sentences(plain, plain["tones"])
    write_findings(
        plain,
        options.json,
        options.html,
        partial(_print_findings, diagnosis),
        lambda: diagnosis_page(diagnosis, models, plain),
    )
    if options.apply is not None:
        _apply(options, airframe, models[0], diagnosis)
    return NOTHING_TO_ESTIMATE if diagnosis.verdict is DiagnosisVerdict.NOT_IDENTIFIABLE else 0


def _apply(options: argparse.Namespace, airframe: Airframe, model: FlightModel, diagnosis: FlightDiagnosis) -> None:
    """Write the airframe with the named effects."""
    if not diagnosis.causes:
        print(_NOTHING_TO_APPLY, file=sys.stderr)
        return
    of_recording = [cause.term.name for cause in diagnosis.causes if cause.term.effect.belongs_to_recording()]
    lasting = [cause.term.name for cause in diagnosis.causes if cause.term.name not in of_recording]
    if of_recording:
        print(f"--apply leaves out {', '.join(of_recording)}: it belongs to this recording", file=sys.stderr)
    if not lasting:
        print(_NOTHING_TO_APPLY, file=sys.stderr)
        return
    path = Path(options.apply)
    airframe_with_causes = extended(airframe, model.belief, diagnosis, model.observations.units)
    path.write_text(dump_airframe(airframe_with_causes), encoding="utf-8")
    if options.json != "-":
        print(f"wrote {path}: {airframe.name} with {', '.join(lasting)}")


def _print_findings(diagnosis: FlightDiagnosis, plain: dict[str, Any]) -> None:
    print(f"verdict: {sentence(diagnosis)}")
    for line in plain["words"].values():
        print(f"  {line}")
    for cause in diagnosis.causes:
        print(f"  {cause.term.effect.name}: log Bayes factor {cause.log_bayes_factor:.1f}, BIC {cause.bic:+.1f}")
        for entry, value, sigma in zip(cause.term.effect.parameters(), cause.values, cause.sigmas, strict=True):
            print(f"    {entry.name} = {value:.5g} ± {sigma:.2g} {entry.unit} ({entry.doc})")
        if cause.group:
            print(f"    cannot be told from {', '.join(cause.group)}: {cause.term.effect.advice or 'record more'}")
    if diagnosis.gain is not None:
        value, low, high = diagnosis.gain.log_score["total"]
        print(f"  held-out gain {value:.1f} nat (95 %: {low:.1f} to {high:.1f})")
        for distance, pair in plain["gain"]["range_rms_m"].items():
            print(f"  range error at {distance} m: {pair['before']:.2f} -> {pair['after']:.2f} m rms")
    for note in plain["notes"]:
        print(f"  note: {note}")


def _show_progress(shown: bool, what: str, fraction: float) -> None:
    """One line that says what is being done."""
    if shown:
        print(f"\r\033[K{what} {100 * fraction:3.0f} %", end="\r", file=sys.stderr, flush=True)
