"""Requirements of a diagnosis on a flight's recording; the verdict on one that falls short says what to record."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.recording import rate_of
from companion.adapters.recordings.tables.mapped_table import files_of
from companion.adapters.recordings.tables.mapping import TableMapping
from companion.diagnosis.data.segments import REQUIREMENT, segments_of
from companion.errors import NOTHING_TO_ESTIMATE
from companion.evaluation.findings_output import write_findings
from companion.evaluation.recorded_evidence import open_mapped
from companion.evaluation.station_tones import StationAnalysis
from companion.params.airframe import Airframe
from companion.records import Axis, Floats, ImuBatch, Ints, Station
from companion.reporting.blocks import Advice, Block, Heading, Page, Paragraph, Table
from companion.reporting.page import capitalised, render

_GAP_RATIO = 2.5  # chosen: of the usual step: one sample may be lost, two may not
_FASTEST_HZ = 2e4  # chosen: no accelerometer on a wing is sampled so fast: the unit of its stamps is another
_FEWEST = 10  # samples: of fewer there is no usual step (choice)
_NEEDED = f"an accelerometer at each wing tip (left_z, right_z), {REQUIREMENT}"


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """How evenly one station's samples came; steps in milliseconds, gaps are longer than 2.5 usual steps.

    ``usable_s`` can be pieced together for a diagnosis, 0 where it is too little.
    """

    station: str
    samples: int
    rate_hz: float = 0.0
    step_p1_ms: float = 0.0
    step_p50_ms: float = 0.0
    step_p99_ms: float = 0.0
    gaps: int = 0
    longest_gap_ms: float = 0.0
    longest_stretch_s: float = 0.0
    usable_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Timing:
    """One recording: its streams, whether a wing tip is among them, what its reader noticed, and the steady tones."""

    path: Path
    streams: tuple[StreamTiming, ...]
    has_tip: bool
    notes: tuple[str, ...]
    tones: tuple[str, ...] = ()

    @property
    def can_be_judged(self) -> bool:
        """Whether a wing tip was recorded long enough."""
        return self.has_tip and not self.problem

    @property
    def problem(self) -> str:
        """Missing requirement in words, "" for none."""
        if not self.has_tip:
            return "no accelerometer on a wing: what the wing does cannot be told from the fuselage alone"
        short = [timing.longest_stretch_s for timing in self.streams if not timing.usable_s]
        if not short:
            return ""
        rate_hz = max(timing.rate_hz for timing in self.streams if not timing.usable_s)
        unit = f"; it says {rate_hz:.0f} Hz: are its stamps in another unit?" if rate_hz > _FASTEST_HZ else ""
        return f"the longest stretch without a gap is {min(short):.1f} s{unit}"


def paths_of(recordings: Sequence[str], mapping: TableMapping | None) -> list[Path]:
    """The recordings, with a mapping every file of each that it is for."""
    if mapping is None:
        return [Path(path) for path in recordings]
    return [file for path in recordings for file in files_of(Path(path), mapping)]


def timing(path: Path, airframe: Airframe, mapping: TableMapping | None = None) -> Timing:
    """Read a recording's stamps."""
    recording = open_mapped(path, airframe, mapping)
    stamps: dict[Station, list[Ints]] = {}
    has_tip = False
    stations = StationAnalysis(recording.airframe)
    for record in recording.records():
        if isinstance(record, ImuBatch):
            stations.add(record)
            stamps.setdefault(record.station, []).append(record.t_ns)
            has_tip |= record.station is not Station.ROOT and bool(record.axes & Axis.Z)
    streams = tuple(_evenness(station, np.concatenate(parts)) for station, parts in sorted(stamps.items()))
    notes = tuple(notice.text for notice in recording.notices)
    return Timing(path, streams, has_tip, notes, tuple(stations.sentences()))


def _evenness(station: Station, t_ns: Ints) -> StreamTiming:
    if len(np.unique(t_ns)) < _FEWEST:
        return StreamTiming(station.name.lower(), len(t_ns))
    steps_ms: Floats = np.diff(np.unique(t_ns)).astype(np.float64) * 1e-6
    usual = float(np.median(steps_ms))
    wide = np.flatnonzero(steps_ms > _GAP_RATIO * usual)
    ends_s = np.concatenate([[0.0], np.cumsum(steps_ms)]) * 1e-3
    # short gaps are bridged by interpolation; only what is longer than 20 ms ends a segment
    long = np.flatnonzero(steps_ms > max(20.0, 2.0 * _GAP_RATIO * usual))
    edges = [0, *(long + 1).tolist(), len(steps_ms) + 1]
    segments_s = [float(ends_s[stop - 1] - ends_s[start]) for start, stop in itertools.pairwise(edges)]
    low, high = np.percentile(np.delete(steps_ms, wide), (1, 99))
    return StreamTiming(
        station.name.lower(),
        len(t_ns),
        rate_of(t_ns, 1e3 / usual),
        float(low),
        usual,
        float(high),
        len(wide),
        float(steps_ms[wide].max()) if len(wide) else 0.0,
        max(segments_s),
        sum(segment.recorded_s for segment in segments_of([ends_s])),
    )


def not_identifiable(timings: Sequence[Timing], options: argparse.Namespace, airframe: str) -> int:
    """Say what these recordings lack and how evenly they were sampled; invent nothing."""
    plain = _plain(timings, airframe)
    write_findings(plain, options.json, options.html, _print_findings, lambda: _page(plain))
    return NOTHING_TO_ESTIMATE


def _plain(timings: Sequence[Timing], airframe: str) -> dict[str, Any]:
    problems = "; ".join(f"{timing.path.name}: {timing.problem}" for timing in timings if timing.problem)
    streams = [{"recording": timing.path.name, **asdict(stream)} for timing in timings for stream in timing.streams]
    return {
        "format": 1,
        "recordings": [str(timing.path) for timing in timings],
        "airframe": airframe,
        "verdict": "not-identifiable",
        "reason": problems,
        "causes": [],
        "nearest": None,
        "gain": None,
        "adequacy": {"before": [], "after": []},
        "residual": None,
        "timing": streams,
        "advice": [f"record {_NEEDED}"],
        "notes": [note for timing in timings for note in timing.notes],
    }


def _rows(plain: dict[str, Any]) -> list[list[str]]:
    return [
        [entry["recording"], entry["station"], f"{entry['rate_hz']:.0f} Hz",
         f"{entry['step_p1_ms']:.2f} to {entry['step_p99_ms']:.2f} ms", f"{entry['gaps']}",
         f"{entry['longest_gap_ms']:.1f} ms", f"{entry['longest_stretch_s']:.1f} s"]
        for entry in plain["timing"]
    ]  # fmt: skip


def _print_findings(plain: dict[str, Any]) -> None:
    print(f"verdict: not identifiable from this recording: {plain['reason']}")
    for name, station, rate, steps, gaps, longest, segment in _rows(plain):
        count = f"{gaps} gap" if gaps == "1" else f"{gaps} gaps"
        print(f"  {name}, {station}: {rate}, steps {steps}, {count}, the longest {longest}; unbroken {segment}")
    for line in plain["advice"]:
        print(f"  record: {line.removeprefix('record ')}")
    for note in plain["notes"]:
        print(f"  note: {note}")


def _page(plain: dict[str, Any]) -> str:
    heads = ["recording", "station", "rate", "steps (1 to 99 %)", "gaps", "longest", "unbroken"]
    body: list[Block] = [
        *[Advice(f"{capitalised(line)}.") for line in plain["advice"]],
        Heading("How evenly it was sampled"),
        Table(heads, _rows(plain)),
        *[Paragraph(note) for note in plain["notes"]],
    ]
    headline = f"not identifiable from this recording: {plain['reason']}"
    return render(Page("Diagnosis: not-identifiable", headline, body, grade="not-identifiable"))
