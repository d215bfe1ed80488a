"""``spanwise convert``: a recording as a telemetry log (.tlog) or as CSV tables."""

from __future__ import annotations

import argparse
import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.adapters.recordings.logs.tlog_writer import utc_offset_ns, write_tlog
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.tables.csv import Covariate, CsvRecording
from companion.adapters.recordings.tables.csv_writer import streams_of, write_folder
from companion.adapters.recordings.tables.record_tables import RecordTables
from companion.adapters.recordings.tables.tables_readme import README, write_readme
from companion.cli.steps.options import add_recording, check_output, open_given, result_folder
from companion.errors import NOTHING_TO_ESTIMATE, ConfigError
from companion.records import ImuBatch, Ints, RawChunk

_FILES = (
    ".csv",
    ".tsv",
    ".txt",
    ".json",
    ".parquet",
    ".mat",
    ".xlsx",
    ".zip",
    ".mcap",
    ".bag",
    ".bin",
    ".ulg",
    ".html",
)
"""Endings of files that a recording does not become."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_recording(parser)
    parser.add_argument(
        "to",
        type=Path,
        metavar="FILE.tlog|FOLDER",
        help="a telemetry log, or a new folder of CSV tables, whose README.txt says what they hold, with units",
    )


def execute(options: argparse.Namespace) -> int:
    """Convert and say what was written; 3 where there is nothing to write."""
    if options.to.exists():
        raise ConfigError(f"{options.to}: exists already; name a new file or folder")
    if options.to.suffix.lower() in _FILES:
        raise ConfigError(
            f"{options.to}: is the name of a file, and the tables are many; name a folder, such as "
            f"{options.to.with_suffix('')}, or a telemetry log (.tlog)"
        )
    recording = open_given(options)
    written = _tlog(recording, options.to) if options.to.suffix.lower() == ".tlog" else _tables(recording, options.to)
    for notice in recording.notices:
        print(f"note: {notice.text}")
    return 0 if written else NOTHING_TO_ESTIMATE


def _tlog(recording: Recording, path: Path) -> bool:
    if isinstance(recording, TlogRecording):
        raise ConfigError(f"{recording.path}: is a telemetry log already; copy it, or name a folder for tables")
    if not isinstance(recording, McapRecording):
        raise ConfigError(f"{recording.path}: holds no MAVLink frames; only a .mcap of Spanwise becomes a .tlog")
    check_output(path, "FILE.tlog")
    chunks = [record for record in recording.records() if isinstance(record, RawChunk)]
    offset_ns, date = utc_offset_ns(chunks), "by the vehicle's SYSTEM_TIME"
    if offset_ns is None:
        newest_ns = max((chunk.received_host_ns for chunk in chunks), default=0)
        offset_ns, date = recording.path.stat().st_mtime_ns - newest_ns, "by the file's date, no SYSTEM_TIME has one"
    with _finished(path) as unfinished:
        count = write_tlog(unfinished, chunks, offset_ns)
    print(f"{path}: {count} frames received and sent; UTC {date}; spanwise reads it with --airframe")
    return count > 0


def _tables(recording: Recording, folder: Path) -> bool:
    with _finished(folder) as unfinished, result_folder(unfinished, "FOLDER"):
        written = _write_tables(recording, unfinished)
    print(f"{folder}:" if written else f"{folder}: nothing, no records")
    print("".join(f"  {line}\n" for line in written), end="")
    return bool(written)


@contextlib.contextmanager
def _finished(path: Path) -> Iterator[Path]:
    """Give a place beside ``path`` that takes its name at the end: what was stopped does not look as if it were whole.

    Raises
    ------
    ConfigError
        The place is taken, by a conversion whose process was killed.
    """
    unfinished = path.with_name(f"{path.name}.part")
    if unfinished.exists():
        raise ConfigError(f"{unfinished}: is what a conversion left that was killed; remove it")
    try:
        yield unfinished
        if unfinished.exists():
            unfinished.rename(path)
    except BaseException:
        shutil.rmtree(unfinished) if unfinished.is_dir() else unfinished.unlink(missing_ok=True)
        raise


def _write_tables(recording: Recording, folder: Path) -> list[str]:
    """Sentences about each table and folder written."""
    batches: list[ImuBatch] = []
    with RecordTables(folder) as tables:
        for record in recording.records():
            if isinstance(record, ImuBatch):
                batches.append(record)
            tables.add(record)
    written = [f"{name}: {count} rows" for name, count in sorted(tables.rows.items())]
    laboratory = recording if isinstance(recording, CsvRecording) else None
    samples = dict(_samples(folder, batches, laboratory))
    written += [f"{name}/: {text}" for name, text in samples.items()]
    if written:
        write_readme(folder, recording, tables, samples)
        written.append(f"{README}: what they hold, every column with its unit")
    return written


def _samples(folder: Path, batches: list[ImuBatch], laboratory: CsvRecording | None) -> Iterator[tuple[str, str]]:
    """Write the samples of each clock into a folder of their own; give its name and what it holds.

    A laboratory's tables, which have a single clock, bring covariates, inputs and ranges.
    """
    covariates = [] if laboratory is None else list(laboratory.covariates.values())
    ranges = None if laboratory is None else laboratory.ranges
    for clock in sorted({batch.clock for batch in batches}):
        of_clock = [batch for batch in batches if batch.clock is clock]
        streams = streams_of(of_clock)
        place = folder / f"samples_{clock}"
        on_stamps = [_on_stamps(covariate, streams[0].t_ns) for covariate in covariates]
        write_folder(place, streams, on_stamps, ranges)
        counts = ", ".join(f"{len(stream.t_ns)} of {stream.station.name.lower()}" for stream in streams)
        repeated = sum(len(batch.t_ns) for batch in of_clock) - sum(len(stream.t_ns) for stream in streams)
        left_out = f"; {repeated} whose stamps repeat are left out" if repeated else ""
        beside = [covariate.name for covariate in on_stamps]
        beside += [] if ranges is None else [f"{len(ranges.t_s)} ranges (range.csv)"]
        beside_text = f"; with {', '.join(beside)}" if beside else ""
        yield place.name, f"samples in the clock '{clock}': {counts}{beside_text}{left_out}"


def _on_stamps(covariate: Covariate, t_ns: Ints) -> Covariate:
    """The covariate at the stamps of ``accel.csv`` (n,): as it is where it has them, or else interpolated."""
    covariate_ns, rows = np.unique(np.rint(covariate.t_s * 1e9).astype(np.int64), return_index=True)
    values = covariate.values[rows]
    if not np.array_equal(covariate_ns, t_ns):
        values = np.interp(t_ns, covariate_ns, values)
    return Covariate(covariate.name, t_ns / 1e9, values)
