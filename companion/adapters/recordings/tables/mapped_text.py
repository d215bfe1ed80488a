"""The columns of a text table in any layout, by the names of a mapping."""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.adapters.recordings.tables.mapping import ColumnMapping, TableMapping, TextLayout
from companion.adapters.recordings.tables.number_table import cell_number, not_finite
from companion.errors import RecordingError, TableError
from companion.records import Floats


def text_columns(
    path: Path, mapping: TableMapping, layout: TextLayout, may_be_missing: frozenset[str]
) -> dict[str, Floats]:
    """Columns (n,) by the mapping's names; an optional one that the file has not is left out.

    Raises
    ------
    RecordingError
        The file is no text.
    TableError
        A column is missing or a cell is wrong.
    """
    places = _places(path, mapping, layout)
    if next(_rows(path, layout), None) is None:
        raise TableError(path, layout.first_line, "no row of numbers is there")
    values = _loaded(path, layout, list(places.values())) if layout.decimal == "." else None
    if values is None or not np.isfinite(values).all():
        values = _cell_by_cell(path, mapping, layout, places, may_be_missing)
    return {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(places)}


def _loaded(path: Path, layout: TextLayout, columns: list[int]) -> Floats | None:
    """Fast path: columns (n, ...) by their indices; None where a cell is wrong."""
    try:
        with warnings.catch_warnings(action="ignore"):
            return np.loadtxt(
                path,
                delimiter=layout.delimiter,
                skiprows=layout.first_line - 1,
                comments=None,
                usecols=columns,
                ndmin=2,
                encoding="utf-8-sig",
                quotechar=None if layout.delimiter is None else '"',
            )
    except (ValueError, IndexError, UnicodeDecodeError):
        return None


def _places(path: Path, mapping: TableMapping, layout: TextLayout) -> dict[str, int]:
    """Index of each column of the mapping that is there."""
    header = _header(path, layout)
    if any(column.name in header for column in mapping.columns):
        _check_width(path, mapping, layout, header)
    places: dict[str, int] = {}
    for column in mapping.columns:
        index = _numbered(column.name)
        if index is None and column.name in header:
            index = header.index(column.name)
            if header.count(column.name) > 1:
                raise TableError(
                    path,
                    layout.header_line,
                    f"column '{column.name}' is there {header.count(column.name)} times; name it by its number in "
                    f"{mapping.origin}: '#{index + 1}' is the first",
                )
        if index is not None:
            places[column.name] = index
        elif not column.optional:
            available = ", ".join(f"'{name}'" for name in header) or "without names: write '#1', '#2' in the mapping"
            raise TableError(
                path,
                layout.header_line or layout.first_line,
                f"column {column.label} of {mapping.origin} is missing; the columns are {available}",
            )
    return places


def _check_width(path: Path, mapping: TableMapping, layout: TextLayout, header: list[str]) -> None:
    """Refuse a first row whose cells do not stand below the names: a row's number without one, or names with spaces."""
    line, text = next(_rows(path, layout), (layout.first_line, ""))
    cells = _cells(text, layout)
    while len(cells) > len(header) and not cells[-1].strip():  # rows may end in delimiters
        cells.pop()
    if text and (len(cells) > len(header) or (layout.delimiter is None and len(cells) < len(header))):
        raise TableError(
            path,
            line,
            f"{len(cells)} cells, but the header in line {layout.header_line} has {len(header)} names, so that a "
            f"name is not above its column: mend the header, or name columns by number in {mapping.origin}: "
            "'#1' is the first",
        )


def _numbered(name: str) -> int | None:
    return int(name[1:]) - 1 if name.startswith("#") and name[1:].isdigit() and int(name[1:]) > 0 else None


def _header(path: Path, layout: TextLayout) -> list[str]:
    if not layout.header_line:
        return []
    try:
        with path.open(encoding="utf-8-sig") as file:
            lines = [line for _, line in zip(range(layout.header_line), file, strict=False)]
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: is not text in UTF-8: save it as such, if it is a text file") from error
    if len(lines) < layout.header_line:
        raise TableError(path, len(lines) + 1, f"ends before the header of line {layout.header_line}")
    return [name.strip().strip('"') for name in _cells(lines[-1], layout)]


def _cells(line: str, layout: TextLayout) -> list[str]:
    """Cells of a line; between double quotes a delimiter is a letter as any other."""
    text = line.rstrip("\r\n")
    if layout.delimiter is None or '"' not in text:
        return text.split(layout.delimiter)
    try:
        return next(csv.reader([text], delimiter=layout.delimiter, skipinitialspace=True))
    except csv.Error:  # a cell longer than any table's
        return text.split(layout.delimiter)


def _rows(path: Path, layout: TextLayout) -> Iterator[tuple[int, str]]:
    """Numbered lines that are not empty."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            if number >= layout.first_line and line.strip():
                yield number, line


def _cell_by_cell(
    path: Path, mapping: TableMapping, layout: TextLayout, places: dict[str, int], may_be_missing: frozenset[str]
) -> Floats:
    """Slow path: for tables with empty cells, and to name the cell that is wrong."""
    columns = {column.name: column for column in mapping.columns}
    rows = []
    for number, line in _rows(path, layout):
        cells = _cells(line, layout)
        row = []
        for name, index in places.items():
            if index >= len(cells):
                raise TableError(path, number, f"{len(cells)} cells, but column '{name}' is number {index + 1}")
            cell = cells[index].strip()
            if layout.decimal != "." and "." in cell:
                raise TableError(path, number, f"column '{name}': '{cell}' has a point, but decimals follow a comma")
            row.append(_number(path, number, columns[name], cell, layout.decimal, may_be_missing))
        rows.append(row)
    return np.array(rows)


def _number(
    path: Path, line: int, column: ColumnMapping, cell: str, decimal: str, may_be_missing: frozenset[str]
) -> float:
    lenient = column.channel in may_be_missing
    what = f"column {column.label}"
    if lenient and not cell:
        return math.nan
    value = cell_number(path, line, what, cell, decimal)
    if not lenient and not math.isfinite(value):
        raise not_finite(path, line, what, cell)
    return value
