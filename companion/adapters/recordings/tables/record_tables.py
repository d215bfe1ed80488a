"""Writes records as CSV tables for spreadsheets and pandas: a file for each kind, a column for each number."""

from __future__ import annotations

import csv
import dataclasses
import enum
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from companion.adapters.recordings.mcap.channels import CHANNELS, Recordable
from companion.records import Frame, FramePair, ImuBatch, MatchSet, RawChunk

_NO_ROWS = (RawChunk, ImuBatch, MatchSet, Frame, FramePair)
"""Kinds that are no row: bytes, blocks of samples or matches, images."""
_MOST_CELLS = 64  # a larger array (an obstacle circle has 72 sectors) is one cell


class RecordTables:
    """Tables of a folder, opened as records come; a context manager.

    The file is named by the record's topic (``ranges.csv``, ``mode.csv``), its columns by the attributes: ``name.part``
    for a nested record, ``name_0`` for an entry of an array. Enumerations are words, absent values empty cells.

    ``rows`` counts the rows written, by file name.
    """

    def __init__(self, folder: Path) -> None:
        self.rows: dict[str, int] = {}
        self._folder = folder
        self._open = ExitStack()
        self._writers: dict[str, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def add(self, record: Recordable) -> None:
        """Write one record as a row; kinds that are no row are passed over."""
        if isinstance(record, _NO_ROWS):
            return
        name = CHANNELS[type(record)].topic.strip("/").replace("/", "_") + ".csv"
        cells = dict(_cells("", record))
        if name not in self._writers:
            file = self._open.enter_context((self._folder / name).open("w", encoding="utf-8", newline=""))
            self._writers[name] = csv.writer(file, lineterminator="\n")
            self._writers[name].writerow(cells)
        self._writers[name].writerow(cells.values())
        self.rows[name] = self.rows.get(name, 0) + 1


def _cells(prefix: str, value: object) -> Iterator[tuple[str, object]]:
    if dataclasses.is_dataclass(value):
        for entry in dataclasses.fields(value):
            yield from _cells(f"{prefix}.{entry.name}" if prefix else entry.name, getattr(value, entry.name))
    elif isinstance(value, np.ndarray) and value.size <= _MOST_CELLS:
        for i, number in enumerate(value.ravel().tolist()):
            yield f"{prefix}_{i}", number
    elif isinstance(value, (np.ndarray, tuple)):
        entries = value.ravel().tolist() if isinstance(value, np.ndarray) else value
        yield prefix, " ".join(str(_plain(entry)) for entry in entries)
    else:
        yield prefix, _plain(value)


def _plain(value: object) -> object:
    """A number, a word, or nothing."""
    if isinstance(value, enum.Flag):
        return value.value
    if isinstance(value, enum.StrEnum):
        return str(value)
    if isinstance(value, enum.Enum):
        return value.name.lower()
    return "" if value is None else value
