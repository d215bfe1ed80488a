"""Writes the laboratory's format; what is read back equals what was written, bit for bit (times to the nanosecond)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from companion.adapters.recordings.recording import InertialStream
from companion.adapters.recordings.tables.csv import RANGE_OPTIONAL, Covariate, RangeTable
from companion.records import Floats, ImuBatch, Ints, Station

_NAMES = ("x_mps2", "y_mps2", "z_mps2", "p_radps", "q_radps", "r_radps")
_ROWS = 4096  # chosen: rows written at once: fast, and little memory


def write_folder(
    folder: Path,
    streams: Sequence[InertialStream],
    covariates: Sequence[Covariate] = (),
    ranges: RangeTable | None = None,
) -> None:
    """Write a folder that :class:`~companion.adapters.recordings.tables.csv.CsvRecording` reads.

    Streams that share the first one's stamps go to ``accel.csv``, with the covariates; every other stream gets a file
    ``accel_<place>.csv``. Raise ValueError for a covariate on other
    stamps than the first stream's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    first = streams[0]
    shared = [stream for stream in streams if np.array_equal(stream.t_ns, first.t_ns)]
    columns = {name: values for stream in shared for name, values in _columns(stream)}
    t_s = _seconds(first.t_ns)
    for covariate in covariates:
        if not np.array_equal(covariate.t_s, t_s):
            raise ValueError(f"covariate '{covariate.name}' is not on the stamps of accel.csv")
        columns[covariate.name] = covariate.values
    write_table(folder / "accel.csv", {"t_s": t_s, **columns})
    for stream in streams:
        if all(stream is not other for other in shared):
            stream_columns = {"t_s": _seconds(stream.t_ns), **dict(_columns(stream))}
            write_table(folder / f"accel_{stream.station.name.lower()}.csv", stream_columns)
    if ranges is not None:
        write_table(folder / "range.csv", _range_columns(ranges))


def streams_of(batches: Iterable[ImuBatch]) -> list[InertialStream]:
    """Join batches to one stream per station, in order of time; of equal stamps the first sample is kept."""
    parts: dict[Station, list[ImuBatch]] = {}
    for batch in batches:
        parts.setdefault(batch.station, []).append(batch)
    return [_joined(parts[station]) for station in sorted(parts)]


def write_table(path: Path, columns: dict[str, Floats]) -> None:
    """Write columns of equal length (n,); numbers are written with their shortest exact form."""
    table = np.column_stack(list(columns.values()))
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(columns) + "\n")
        for start in range(0, len(table), _ROWS):
            rows = table[start : start + _ROWS].tolist()
            file.write("".join([",".join(map(repr, row)) + "\n" for row in rows]))


def _seconds(t_ns: Ints) -> Floats:
    """Stamps in seconds; exact to the nanosecond for 100 days."""
    return t_ns / 1e9


def _columns(stream: InertialStream) -> Iterable[tuple[str, Floats]]:
    place = stream.station.name.lower()
    for column in stream.axes.columns:
        yield f"{place}_{_NAMES[column]}", stream.values[:, column]


def _joined(batches: list[ImuBatch]) -> InertialStream:
    t_ns = np.concatenate([batch.t_ns for batch in batches])
    values = np.concatenate([batch.values for batch in batches])
    t_ns, order = np.unique(t_ns, return_index=True)
    axes = batches[0].axes
    for batch in batches:
        axes &= batch.axes
    return InertialStream(batches[0].station, batches[0].clock, axes, t_ns, values[order])


def _range_columns(ranges: RangeTable) -> dict[str, Floats]:
    optional = {name: getattr(ranges, name) for name in RANGE_OPTIONAL}
    present = {name: values for name, values in optional.items() if values is not None}
    return {"t_s": ranges.t_s, "range_m": ranges.range_m, **present, **ranges.further}
