"""Writes records as CSV tables for spreadsheets and pandas: a file for each kind, a column for each number."""

from __future__ import annotations

import csv
import dataclasses
import enum
import functools
import json
import typing
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from companion.adapters.recordings.mcap.channels import CHANNELS, Recordable
from companion.records import Flow, Frame, FramePair, ImuBatch, MatchSet, RawChunk

_NO_ROWS = (RawChunk, ImuBatch, Frame, FramePair)
"""Kinds that are no row: bytes, blocks of samples, images."""
_MOST_CELLS = 64  # a larger array (an obstacle circle has 72 sectors) is one cell (choice)
POINTS = "vision_points.csv"
_FLOW = ("earlier_pair_id", "earlier_column_px", "earlier_row_px", "earlier_sigma_px")
_POINT = ("pair_id", "left_column_px", "left_row_px", "right_column_px", "right_row_px", "sigma_px", "filled", *_FLOW)


class RecordTables:
    """Tables of a folder, opened as records come; a context manager.

    The file is named by the record's topic (``ranges.csv``, ``mode.csv``), its columns by the attributes: ``name.part``
    for a nested record, ``name_0`` for an entry of an array. Enumerations are words, counters JSON, absent values empty
    cells. The matches of a pair are a row each of a table of their own, with their places in an earlier image.

    ``rows`` counts the rows written, ``columns`` are the heads and ``kinds`` the records' classes, by file name.
    """

    def __init__(self, folder: Path) -> None:
        self.rows: dict[str, int] = {}
        self.columns: dict[str, tuple[str, ...]] = {}
        self.kinds: dict[str, type] = {}
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
        """Write one record; kinds that are no row are passed over."""
        if isinstance(record, _NO_ROWS):
            return
        name = CHANNELS[type(record)].topic.strip("/").replace("/", "_") + ".csv"
        cells = dict(_pair_cells(record) if isinstance(record, MatchSet) else _cells("", record))
        self._write(name, type(record), tuple(cells), [list(cells.values())])
        if isinstance(record, MatchSet):
            self._write(POINTS, MatchSet, _POINT, _points(record))

    def _write(self, name: str, kind: type, heads: tuple[str, ...], rows: Sequence[Sequence[object]]) -> None:
        if name not in self._writers:
            file = self._open.enter_context((self._folder / name).open("w", encoding="utf-8", newline=""))
            self._writers[name] = csv.writer(file, lineterminator="\n")
            self._writers[name].writerow(heads)
            self.columns[name], self.kinds[name] = heads, kind
        self._writers[name].writerows(rows)
        self.rows[name] = self.rows.get(name, 0) + len(rows)


def _pair_cells(pair: MatchSet) -> Iterator[tuple[str, object]]:
    """Cells that hold for all matches of a pair, and how many there are."""
    single = {"left_px", "right_px", "sigma_px", "flow"}
    for name in [entry.name for entry in dataclasses.fields(pair) if entry.name not in single]:
        yield from _attribute("", pair, name)
    yield "matches", len(pair.sigma_px)
    yield "in_earlier_image", 0 if pair.flow is None else len(pair.flow.index)


def _points(pair: MatchSet) -> list[list[object]]:
    """Rows of the matches: features first, then what fills the picture between them."""
    places = np.column_stack([pair.left_px, pair.right_px, pair.sigma_px]).tolist()
    earlier = {} if pair.flow is None else _earlier(pair.flow)
    features = len(places) - pair.filled
    nowhere: list[object] = [""] * len(_FLOW)
    return [[pair.pair_id, *place, i >= features, *earlier.get(i, nowhere)] for i, place in enumerate(places)]


def _earlier(flow: Flow) -> dict[int, list[object]]:
    """Place in the earlier left image of those matches that it shows too, by their number."""
    places = np.column_stack([flow.earlier_px, flow.sigma_px]).tolist()
    return {i: [flow.earlier_pair_id, *place] for i, place in zip(flow.index.tolist(), places, strict=True)}


def _cells(prefix: str, value: object) -> Iterator[tuple[str, object]]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        for entry in dataclasses.fields(value):
            yield from _attribute(prefix, value, entry.name)
    elif isinstance(value, np.ndarray) and value.size <= _MOST_CELLS:
        for i, number in enumerate(value.ravel().tolist()):
            yield f"{prefix}_{i}", number
    elif isinstance(value, (np.ndarray, tuple)):
        entries = value.ravel().tolist() if isinstance(value, np.ndarray) else value
        yield prefix, " ".join(str(_plain(entry)) for entry in entries)
    else:
        yield prefix, _plain(value)


def _attribute(prefix: str, record: Any, name: str) -> Iterator[tuple[str, object]]:
    value, column = getattr(record, name), f"{prefix}.{name}" if prefix else name
    kind: Any = type(record)
    length = _lengths(kind).get(name)
    if length is None:
        yield from _cells(column, value)
    else:
        for i, entry in enumerate((None,) * length if value is None else value):
            yield f"{column}_{i}", _plain(entry)


@functools.cache
def _lengths(kind: type) -> dict[str, int]:
    """Length of each attribute that is a tuple of one length or absent: absent, it is as many empty cells."""
    lengths = {}
    for name, hint in typing.get_type_hints(kind).items():
        for option in (hint, *typing.get_args(hint)):
            entries = typing.get_args(option)
            if typing.get_origin(option) is tuple and Ellipsis not in entries:
                lengths[name] = len(entries)
    return lengths


def _plain(value: object) -> object:
    """A number, a word, JSON, or nothing."""
    if isinstance(value, dict):
        return json.dumps(value, sort_keys=True)
    if isinstance(value, enum.Flag):
        return value.value
    if isinstance(value, enum.StrEnum):
        return str(value)
    if isinstance(value, enum.Enum):
        return value.name.lower()
    return "" if value is None else value
