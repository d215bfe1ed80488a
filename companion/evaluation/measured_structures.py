"""``spanwise diagnose --mapping`` for what is no flight: a structure that rings or flutters, or a vibration test."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from companion.adapters.recordings.tables.mapped_table import MappedTable, files_of, read_mapped
from companion.adapters.recordings.tables.mapping import FLIGHT, TableMapping
from companion.diagnosis.channel_defects import CLIPPED, is_clipped, unbroken
from companion.diagnosis.forced.equation_rows import ForcedRecording
from companion.diagnosis.forced.even_recording import row_steps
from companion.diagnosis.forced.json_report import as_json as forced_json
from companion.diagnosis.forced.recordings import diagnose_forced
from companion.diagnosis.forced.response_kind import ResponseKind
from companion.diagnosis.free_decay.json_report import as_json as ringing_json
from companion.diagnosis.free_decay.record import RawFreeDecay, prepare
from companion.diagnosis.free_decay.recordings import diagnose as diagnose_decays
from companion.diagnosis.limit_cycles.json_report import as_json as flutter_json
from companion.diagnosis.limit_cycles.recordings import diagnose_vibration
from companion.diagnosis.limit_cycles.tracks import RawVibration, VibrationTrack, track
from companion.diagnosis.modal_tests.frequency_changes import ORDER
from companion.diagnosis.modal_tests.json_report import as_json as modal_json
from companion.diagnosis.modal_tests.recordings import diagnose_modal_test
from companion.diagnosis.modal_tests.vibration import VibrationRun, modes_of_runs, responses
from companion.errors import NOTHING_TO_ESTIMATE, ConfigError, RecordingError
from companion.evaluation.findings_output import write_findings
from companion.evaluation.pages.findings_page import findings_page
from companion.evaluation.pages.flutter_page import flutter_page
from companion.evaluation.pages.measured_pages import headline, ringing_page, vibration_page
from companion.params.airframe import Uncertain
from companion.params.files import load_airframe
from companion.records import Floats

Progress = Callable[[str, float], None]
_TIPS = ("left_z_mps2", "right_z_mps2")
_RESPONSE = "response_"
_FORCE = "input_n"
_AIRSPEED = "airspeed_mps"
_INPUT = "input_"
_LINEAR = ("mass", "damping", "stiffness")
_STILL_MPS = 1.0  # chosen: less is an airspeed sensor's zero
_STEADY = 0.1  # of the mean: more is a sweep, and no airspeed of a recording (choice)
_GAP_RATIO = 2.5  # chosen: of the usual step: one sample may be lost, two may not
_GAP_PERIODS = 0.25  # chosen, of the band's top: a line across less is near the vibration
_BAND_SLACK = 1.01  # chosen: a band may reach half the rate of stamps that wander a little


def tables_of(paths: Sequence[str], mapping: TableMapping) -> list[MappedTable]:
    """Every file of every path, read through the mapping.

    Raises
    ------
    RecordingError
        One cannot be read, or has the samples of another one.
    """
    files = [file for path in paths for file in files_of(Path(path), mapping)]
    tables = [read_mapped(file, mapping).increasing().unrounded() for file in files]
    for first, second in itertools.combinations(tables, 2):
        if _is_copy(first, second):
            raise RecordingError(
                f"{second.path}: has the samples of {first.path}: give each recording once, for a copy makes "
                "everything surer than it is"
            )
    return tables


def _is_copy(first: MappedTable, second: MappedTable) -> bool:
    """Whether two tables have the same samples, and these change."""
    if first.channels.keys() != second.channels.keys() or len(first.t_s) != len(second.t_s) or not len(first.t_s):
        return False
    pairs = [(values, second.channels[name]) for name, values in first.channels.items()]
    return all(np.array_equal(*pair) for pair in pairs) and any(np.ptp(values) > 0.0 for values, _ in pairs)


def execute(options: argparse.Namespace, mapping: TableMapping, progress: Progress) -> int:
    """Diagnose recordings of one structure jointly; exit codes as those of a flight.

    Raises
    ------
    ConfigError
        The mapping is of a kind of test that nobody here diagnoses.
    """
    if mapping.test not in _DIAGNOSED:
        kinds = ", ".join((FLIGHT, *_DIAGNOSED))
        raise ConfigError(f"{mapping.origin}: 'test' must be one of {kinds}, not {mapping.test!r}")
    tables = tables_of(options.recordings, mapping)
    plain, make_page = _DIAGNOSED[mapping.test](tables, mapping, options, progress)
    plain["notes"] += [*_unmatched(tables, mapping), *(note for table in tables for note in table.notes)]
    write_findings(plain, options.json, options.html, _print_findings, make_page)
    if options.apply is not None:
        print("--apply: what was found here is of a structure on the bench; no airframe was written", file=sys.stderr)
    return NOTHING_TO_ESTIMATE if plain["verdict"] == "not-identifiable" else 0


def _unmatched(tables: Sequence[MappedTable], mapping: TableMapping) -> list[str]:
    """Sentences of entries under [[recordings]] without a file, and of channels that are not said of every file."""
    folders = {table.path.parent for table in tables}
    missing = [name for name in mapping.constants if not any((folder / name).exists() for folder in folders)]
    channels = dict.fromkeys(name for table in tables for name in table.constants)
    lacking = {name: [table.path.name for table in tables if name not in table.constants] for name in channels}
    noted = {name: ", ".join(files) for name, files in lacking.items() if files}
    return [
        *(f"[[recordings]] names {name}, which is no file beside the others" for name in missing),
        *(f"{name} cannot be a cause: {files} has no value of it" for name, files in noted.items()),
    ]


_Diagnosed = tuple[dict[str, Any], Callable[[], str]]


def _free_decay(
    tables: Sequence[MappedTable], mapping: TableMapping, options: argparse.Namespace, progress: Progress
) -> _Diagnosed:
    band_hz = _band(mapping)
    for table in tables:
        _check_rows(table, band_hz, [name for name in _TIPS if name in table.channels])
    recordings, scales = prepare([_raw_ringing(table) for table in tables], band_hz)
    frequency_hz, damping = _believed(mapping, options.airframe)
    if not band_hz[0] < frequency_hz.value < band_hz[1]:
        raise ConfigError(
            f"{mapping.origin}: band_hz, {band_hz[0]:g} to {band_hz[1]:g} Hz, does not hold the believed frequency_hz, "
            f"{frequency_hz.value:g} Hz: correct one of them"
        )
    diagnosis = diagnose_decays(recordings, frequency_hz, damping, band_hz, options.max_causes + 2, progress)
    plain = ringing_json(diagnosis, scales, options.airframe)
    plain["notes"] += [
        f"{table.path.name}: {name} {CLIPPED}, which looks like a law and changes the damping"
        for table in tables
        for name in _TIPS
        if name in table.channels and is_clipped(table.channels[name])
    ]
    return plain, lambda: ringing_page(diagnosis, scales, plain, mapping.description)


def _raw_ringing(table: MappedTable) -> RawFreeDecay:
    tips = [table.channels[name] for name in _TIPS if name in table.channels]
    if not tips:
        raise RecordingError(f"{table.path}: the mapping gives no {' or '.join(_TIPS)}: nothing to follow")
    constants = {name: np.full(len(table.t_s), value) for name, value in table.constants.items() if name != ORDER}
    others = constants | {name: values for name, values in table.channels.items() if name not in _TIPS}
    return RawFreeDecay(f"{table.path.parent.name}/{table.path.name}", table.t_s, -np.mean(tips, axis=0), others)


def _vibration(
    tables: Sequence[MappedTable], mapping: TableMapping, options: argparse.Namespace, progress: Progress
) -> _Diagnosed:
    band_hz = _band(mapping)
    runs: list[VibrationRun] = []
    notes: list[str] = []
    for i, table in enumerate(tables):
        progress("transform the runs", i / len(tables))
        runs.append(_run(table, band_hz, notes))
    if len({run.frequency_hz.size for run in runs}) > 1:
        raise RecordingError("the runs are of different length or rate: compare runs of one kind")
    progress("fit the modes of every run", 0.0)
    modes, peaks = modes_of_runs(runs)
    diagnosis = diagnose_modal_test(modes, [run.constants for run in runs], progress)
    plain = modal_json(diagnosis, [str(table.path) for table in tables], options.airframe)
    plain["notes"] += [*peaks, *notes]
    return plain, lambda: vibration_page(diagnosis, runs, plain, mapping.description)


def _limit_cycle(
    tables: Sequence[MappedTable], mapping: TableMapping, options: argparse.Namespace, progress: Progress
) -> _Diagnosed:
    tracks: list[VibrationTrack] = []
    names, notes = _responses_of_all(tables)
    for i, table in enumerate(tables):
        progress("follow the vibration", i / len(tables))
        try:
            airspeed = _airspeed(table, notes)
            _check_rows(table, _band(mapping), names)
            table = _unbroken(table, _band(mapping)[1], notes)
            responses = {name.removeprefix(_RESPONSE): table.channels[name] for name in names}
            forces = {name: values for name, values in table.channels.items() if name.startswith(_INPUT)}
            raw = RawVibration(table.path.name, table.t_s, responses, airspeed, forces)
            followed = track(raw, _band(mapping))
            tracks.append(followed)
            if not len(followed.t_s):
                leading = names[0].removeprefix(_RESPONSE)
                notes.append(f"{table.path.name}: {leading} rises nowhere above its noise: nothing is told from it")
        except RecordingError as error:
            notes.append(str(error))
    if not tracks:
        raise RecordingError("; ".join(notes))
    diagnosis = diagnose_vibration(tracks, options.max_causes + 2, progress)
    plain = flutter_json(diagnosis)
    plain["notes"] += notes
    return plain, lambda: flutter_page(diagnosis, plain, mapping.description)


def _airspeed(table: MappedTable, notes: list[str]) -> float | None:
    """Mean airspeed of a file, or what the mapping says of it, None where it has none; a change within it is noted.

    Raises
    ------
    RecordingError
        It is negative.
    """
    speed = table.channels.get(_AIRSPEED)
    if speed is None:
        if _AIRSPEED not in table.constants:
            return None
        speed = np.array([table.constants[_AIRSPEED]])
    mean, (low, high) = float(np.mean(speed)), np.percentile(speed, (2.0, 98.0)).tolist()
    if mean < -_STILL_MPS:
        raise RecordingError(f"{table.path.name}: an airspeed of {mean:.1f} m/s is negative: turn its sign or zero")
    if high - low > max(_STEADY * mean, _STILL_MPS):
        notes.append(
            f"{table.path.name}: the airspeed goes from {low:.1f} to {high:.1f} m/s, and counts as {mean:.1f} m/s"
        )
    return max(mean, 0.0)


def _unbroken(table: MappedTable, top_hz: float, notes: list[str]) -> MappedTable:
    """The longest stretch of a file without a gap; a note where that is not all."""
    usual_s = float(np.median(np.diff(table.t_s)))
    stretch, gaps = unbroken(table.t_s, max(_GAP_RATIO * usual_s, _GAP_PERIODS / top_hz))
    if not gaps:
        return table
    t_s = table.t_s[stretch]
    notes.append(
        f"{table.path.name}: gaps: {gaps}; judged is the longest stretch without one, {t_s[-1] - t_s[0]:.1f} s"
    )
    channels = {name: values[stretch] for name, values in table.channels.items()}
    return dataclasses.replace(table, t_s=t_s, channels=channels)


def _responses_of_all(tables: Sequence[MappedTable]) -> tuple[list[str], list[str]]:
    """Responses that every file has, and a note for each that some file lacks."""
    channels = dict.fromkeys(name for table in tables for name in table.channels)
    every = [name for name in channels if name.startswith(_RESPONSE)]
    lacking = {name: [table.path for table in tables if name not in table.channels] for name in every}
    names = [name for name in every if not lacking[name]]
    if not names:
        needed = f"a limit cycle needs {_RESPONSE}<what> in every file, and {_AIRSPEED} if there was any"
        raise RecordingError(f"{next((paths[0] for paths in lacking.values() if paths), tables[0].path)}: {needed}")
    return names, [f"{name} is left out: {paths[0].name} has none" for name, paths in lacking.items() if paths]


def _forced(
    tables: Sequence[MappedTable], mapping: TableMapping, options: argparse.Namespace, progress: Progress
) -> _Diagnosed:
    recordings = []
    for table in tables:
        forces = [name for name in table.channels if name.startswith(_INPUT)]
        measured = [name for name in table.channels if name.startswith(_RESPONSE)]
        if len(forces) != 1 or len(measured) != 1:
            needed = f"one {_INPUT}<what> and one {_RESPONSE}<what>"
            raise RecordingError(f"{table.path}: a forced oscillator needs {needed}")
        _check_rows(table, _band(mapping), [*forces, *measured])
        force, response = table.channels[forces[0]], table.channels[measured[0]]
        kind = ResponseKind.of_channel(measured[0])
        recordings.append(ForcedRecording(table.path.name, table.t_s, force, response, kind))
    plain = forced_json(diagnose_forced(recordings, _band(mapping), options.max_causes, progress))
    return plain, lambda: findings_page(plain, mapping.description)


_DIAGNOSED = {"ringing": _free_decay, "vibration": _vibration, "limit-cycle": _limit_cycle, "forced": _forced}


def _run(table: MappedTable, band_hz: tuple[float, float], notes: list[str]) -> VibrationRun:
    names = [name for name in table.channels if name.startswith(_RESPONSE)]
    if _FORCE not in table.channels or not names:
        raise RecordingError(f"{table.path}: a vibration test needs {_FORCE} and {_RESPONSE}<point>_mps2")
    _check_rows(table, band_hz, [_FORCE, *names])
    table = _without_losses(table, band_hz[1], notes)
    rate_hz = (len(table.t_s) - 1) / float(table.t_s[-1] - table.t_s[0])
    accelerations: Floats = np.stack([table.channels[name] for name in names], axis=1)
    f_hz, frf = responses(table.channels[_FORCE], accelerations, rate_hz, band_hz)
    order = table.constants.get("run_order")
    return VibrationRun(f"{order:g}" if order is not None else table.path.stem, f_hz, frf, table.constants)


def _without_losses(table: MappedTable, top_hz: float, notes: list[str]) -> MappedTable:
    """A run with the rows that were lost splined, and a note of them: its rows are transformed as even ones.

    Raises
    ------
    RecordingError
        It has a gap that a spline does not bridge.
    """
    steps = row_steps(table.t_s, top_hz)
    if steps.gaps.size:
        raise RecordingError(
            f"{table.path}: rows are lost in gaps ({steps.gaps.size}, the longest {steps.longest_s:.3g} s), across "
            "which a run is not transformed and every frequency would be wrong: record it without losses"
        )
    if not steps.splined:
        return table
    even_s = np.linspace(table.t_s[0], table.t_s[-1], steps.rows)
    channels = {name: CubicSpline(table.t_s, values)(even_s) for name, values in table.channels.items()}
    notes.append(f"{table.path.name}: rows are lost at {steps.splined} places, which splines bridge")
    return dataclasses.replace(table, t_s=even_s, channels=channels)


def _check_rows(table: MappedTable, band_hz: tuple[float, float], names: Sequence[str]) -> None:
    """Check rows and channels of a file.

    Raises
    ------
    RecordingError
        One row, rows too slow for the band, or a channel of these names that never changes.
    """
    if len(table.t_s) < 2:
        raise RecordingError(f"{table.path}: has {len(table.t_s)} row of samples, a vibration has many: record longer")
    step_s = np.diff(table.t_s)
    rate_hz = 1.0 / float(np.mean(step_s[step_s <= _GAP_RATIO * np.median(step_s)]))  # whatever pauses there were
    if band_hz[1] > _BAND_SLACK * 0.5 * rate_hz:
        raise RecordingError(
            f"{table.path}: {rate_hz:.4g} rows a second show nothing above {0.5 * rate_hz:.4g} Hz, band_hz reaches "
            f"{band_hz[1]:g} Hz: check the unit of the time column, or lower band_hz"
        )
    for name in names:
        if not np.ptp(table.channels[name]) > 0.0:
            raise RecordingError(f"{table.path}: {name} never changes: check its sensor, or take it out of the mapping")


def _believed(mapping: TableMapping, airframe: str | None) -> tuple[Uncertain, Uncertain]:
    if airframe is not None:
        mode = load_airframe(airframe).wing.symmetric
        return mode.frequency_hz, mode.damping
    if "frequency_hz" not in mapping.belief or "damping" not in mapping.belief:
        raise ConfigError(f"{mapping.origin}: [belief] needs frequency_hz and damping, or give --airframe NAME")
    return mapping.belief["frequency_hz"], mapping.belief["damping"]


def _band(mapping: TableMapping) -> tuple[float, float]:
    if mapping.band_hz is None:
        raise ConfigError(f"{mapping.origin}: 'band_hz' is missing: where the modes of interest are")
    return mapping.band_hz


def _print_findings(plain: dict[str, Any]) -> None:
    print(f"verdict: {headline(plain)}")
    for cause in plain["causes"]:
        channel = f" ({cause['channel']})" if cause["channel"] else ""
        print(f"  {cause['name']}{channel}: log Bayes factor {cause['log_bayes_factor']:.0f}, BIC {cause['bic']:+.0f}")
        for name, entry in cause["parameters"].items():
            sigma = f" ± {entry['sigma']:.2g}" if entry["sigma"] else ""
            print(f"    {name} = {entry['value']:.5g}{sigma} {entry['unit']} ({entry['meaning']})")
        if cause["gain"]:
            print(f"    {error_line(cause['gain'])}")
    if plain.get("linear"):
        linear = plain["linear"]["after"]
        values = [f"{name} {linear[name]:.5g} ± {linear[f'{name}_sigma']:.2g}" for name in _LINEAR]
        print(f"  linear part: {', '.join(values)} in the units that the mapping gives;")
        print(f"    {linear['frequency_hz']:.4g} Hz, damping ratio {linear['damping_ratio']:.4g}")
    if plain.get("onset"):
        print(f"  onset: {plain['onset']['says']}")
    for entry in plain.get("held_out_speeds", []):
        each = [("frequency in Hz", entry["frequency_hz"]), *entry["amplitude"].items()]
        pairs = ", ".join(
            f"{name} {pair['measured']:.4g} -> {pair['predicted']:.4g} ({100 * pair['relative_error']:+.1f} %)"
            for name, pair in each
        )
        print(f"  {entry['airspeed_mps']:g} m/s held out, measured -> predicted: {pairs}")
    for line in plain.get("advice", []):
        print(f"  record: {line}")
    for note in plain["notes"]:
        print(f"  note: {note}")


def error_line(gain: dict[str, Any]) -> str:
    """Error of a law on blocks that it was not fitted to."""
    low, high = (100.0 * value for value in gain["interval"])
    before, after = (100.0 * value for value in gain["share_of_signal"])
    return (
        f"held-out error of the {gain['what']}: {gain['before']:.4f} -> {gain['after']:.4f} {gain['unit']} "
        f"({before:.0f} -> {after:.0f} % of the signal; {low:.0f} to {high:.0f} % of its square is gone)"
    )
