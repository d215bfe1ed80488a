"""Reads a CSV table of numbers fast, and names file, line and column of whatever is wrong with it."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np

from companion.errors import RecordingError, TableError
from companion.records import Floats


def read_table(
    path: Path, required: tuple[str, ...] = (), may_be_infinite: frozenset[str] = frozenset()
) -> dict[str, Floats]:
    """Read a CSV table, whose first line is its header: columns (n,) by name, in file order; ``t_s`` must be there.

    Columns of ``required`` must be there too; ``inf`` is allowed in those of ``may_be_infinite``. Empty cells and
    not-a-number are allowed nowhere.

    Raises
    ------
    RecordingError
        The file is missing or is no text.
    TableError
        A missing or repeated column, a row with another number of cells, or a cell that is empty, not a number or not
        finite.
    """
    header = _header(path)
    for name in ("t_s", *required):
        if name not in header:
            raise TableError(path, 1, f"column '{name}' is missing; the columns are {', '.join(header)}")
    values = _values(path, header)
    strict = [i for i, name in enumerate(header) if name not in may_be_infinite]
    if not np.isfinite(values[:, strict]).all() or np.isnan(values).any():
        _find_bad_cell(path, header, may_be_infinite)
    return {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(header)}


def _header(path: Path) -> list[str]:
    try:
        with path.open(encoding="utf-8-sig") as file:
            line = file.readline()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: is not text in UTF-8: save it as such, if it is a text file") from error
    header = [name.strip().strip('"') for name in line.split(",")]
    if len(header) < 2:
        other = any(mark in line for mark in ";\t")
        advice = "; other separators are read through a mapping file (--mapping)" if other else ""
        raise TableError(
            path, 1, f"a header of columns separated by commas is expected, not '{line.strip()[:60]}'{advice}"
        )
    for i, name in enumerate(header):
        if not name:
            raise TableError(path, 1, f"column {i + 1} has no name")
        if name in header[:i]:
            raise TableError(path, 1, f"column '{name}' is there twice")
    return header


def _values(path: Path, header: list[str]) -> Floats:
    try:
        with warnings.catch_warnings(action="ignore", category=UserWarning):  # "no data": said below
            values = np.loadtxt(path, delimiter=",", skiprows=1, comments=None, ndmin=2, encoding="utf-8-sig")
    except (ValueError, UnicodeDecodeError):
        _find_bad_cell(path, header, frozenset())
        raise TableError(path, 1, "cannot be read as a table of numbers") from None
    if values.size == 0:
        raise TableError(path, 2, "no row of numbers follows the header")
    if values.shape[1] != len(header):
        _find_bad_cell(path, header, frozenset())
    return values


def _find_bad_cell(path: Path, header: list[str], may_be_infinite: frozenset[str]) -> None:
    """Read again line by line and raise for the first cell that is wrong; slow, but only ever once."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        next(file)
        for number, line in enumerate(file, start=2):
            if not line.strip():
                continue
            cells = line.rstrip("\r\n").split(",")
            if len(cells) != len(header):
                raise TableError(path, number, f"{len(cells)} cells, but the header has {len(header)} columns")
            for name, cell in zip(header, cells, strict=True):
                value = cell_number(path, number, f"column '{name}'", cell.strip())
                if math.isnan(value) or (math.isinf(value) and name not in may_be_infinite):
                    raise not_finite(path, number, f"column '{name}'", cell.strip())


def cell_number(path: Path, line: int, column: str, cell: str, decimal: str = ".") -> float:
    """The number in a cell, finite or not; raise :class:`TableError`, which begins with ``column``, for none."""
    if not cell:
        raise TableError(path, line, f"{column} is empty; leave the whole row out where a sample is missing")
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        raise TableError(path, line, f"{column}: '{cell[:40]}' is not a number") from None


def not_finite(path: Path, line: int, column: str, cell: str) -> TableError:
    """The error of a cell whose number is not finite."""
    return TableError(path, line, f"{column}: '{cell}' is not a finite number; leave the whole row out")
