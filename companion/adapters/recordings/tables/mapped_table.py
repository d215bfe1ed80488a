"""Reads a laboratory's own table through its mapping: every channel in SI under the name that the mapping gives it."""

from __future__ import annotations

import dataclasses
import fnmatch
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.recordings.tables.csv import RANGE_OPTIONAL
from companion.adapters.recordings.tables.mapped_matlab import matlab_columns
from companion.adapters.recordings.tables.mapped_text import text_columns
from companion.adapters.recordings.tables.mapping import MatlabLayout, TableMapping
from companion.adapters.recordings.tables.stamps import without_rounding
from companion.errors import RecordingError
from companion.records import Floats

_MOST_NAMED = 5  # chosen: folders that a sentence names and stays legible
MAY_BE_MISSING = frozenset({"range_m", *RANGE_OPTIONAL})
"""Channels whose cells may be empty where the pair made no range."""


@dataclass(frozen=True, slots=True)
class MappedTable:
    """A table as read.

    ``t_s`` (n,) are the stamps, row by row. ``channels`` holds (n,) values by the mapping's names, scaled; NaN only in
    the channels of :data:`MAY_BE_MISSING`. ``constants`` are what the mapping says of this file.
    """

    path: Path
    t_s: Floats
    channels: dict[str, Floats]
    constants: dict[str, float]
    notes: tuple[str, ...] = ()

    def increasing(self) -> MappedTable:
        """The rows in order of their stamps, of equal stamps the first; a note tells of it."""
        t_s, rows = np.unique(self.t_s, return_index=True)
        if np.array_equal(rows, np.arange(len(self.t_s))):
            return self
        wrong = int(np.sum(np.diff(self.t_s) <= 0.0))
        text = f"stamps of {wrong} of {len(self.t_s)} rows repeat or go back; {len(rows)} rows are used"
        note = f"{self.path.name}: {text}, in order of time"
        channels = {name: values[rows] for name, values in self.channels.items()}
        return dataclasses.replace(self, t_s=t_s, channels=channels, notes=(*self.notes, note))

    def unrounded(self) -> MappedTable:
        """The rows with rounded stamps put back onto their even grid; a note tells of it."""
        t_s, rounded = without_rounding(self.t_s)
        notes = (f"{self.path.name}: {rounded}",) if rounded else ()
        return dataclasses.replace(self, t_s=t_s, notes=(*self.notes, *notes))


def files_of(path: Path, mapping: TableMapping) -> list[Path]:
    """The files of a recording: itself, or all of a folder that fit the mapping's pattern, numbers in their order.

    Raises
    ------
    RecordingError
        Nothing there, or nothing that fits.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise RecordingError(f"{path}: no such file or folder")
    fitting = _fitting(path, mapping)
    if not fitting:
        folders = [folder for folder in sorted(path.iterdir()) if folder.is_dir() and _fitting(folder, mapping)]
        listed = " ".join(str(folder) for folder in folders[:_MOST_NAMED]) + " ..." * (len(folders) > _MOST_NAMED)
        beside = f"; give folders that have them: {listed}" if folders else ""
        raise RecordingError(f"{path}: no file '{mapping.files}', which {mapping.origin} asks for{beside}")
    return sorted(fitting, key=lambda file: [int(p) if p.isdigit() else p for p in re.split(r"(\d+)", file.name)])


def _fitting(folder: Path, mapping: TableMapping) -> list[Path]:
    """Files of a folder that fit the mapping's pattern, in no order."""
    return [file for file in folder.iterdir() if file.is_file() and fnmatch.fnmatch(file.name, mapping.files)]


def read_mapped(path: Path, mapping: TableMapping) -> MappedTable:
    """Read one file.

    Raises
    ------
    RecordingError
        The file is missing or no such table.
    TableError
        A column is missing, or a cell is no number; file, line and column are named.
    """
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    layout = mapping.layout
    if isinstance(layout, MatlabLayout):
        raw = matlab_columns(path, mapping, layout)
    else:
        raw = text_columns(path, mapping, layout, MAY_BE_MISSING)
    present = [column for column in mapping.columns if column.name in raw]
    channels = {column.channel: raw[column.name] * column.scale + column.offset for column in present}
    t_s = channels.pop("t_s", None)
    if t_s is None:
        t_s = np.arange(len(next(iter(channels.values())))) / mapping.rate_hz
    missing = [column for column in mapping.columns if column.name not in raw]
    notes = tuple(f"{path.name}: no column '{column.name}' ({column.channel})" for column in missing)
    return MappedTable(path, t_s, channels, dict(mapping.constants.get(path.name, {})), notes)
