"""MATLAB's v5 files: numeric, character and cell arrays; every length is checked against the size of the file.

The format is MathWorks' "MAT-File Format" (level 5). Structures, objects, sparse arrays and functions are left out.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.errors import RecordingError

_HEAD = 128  # bytes of the file's header (MAT-File Level 5 format)
_MATRIX, _COMPRESSED = 14, 15  # data types (MAT-File Level 5 format)
_CELL, _CHARACTER, _FIRST_NUMBER, _LAST_NUMBER, _OPAQUE = 1, 4, 6, 15, 17  # array classes (MAT-File Level 5 format)
# data types (MAT-File Level 5 format)
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
# data types of text (MAT-File Level 5 format)
_ENCODINGS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MOST_INFLATED_BYTES = 400_000_000  # bound of memory against compressed nonsense
_MOST_NESTED = 4  # bound of recursion: depth of cells within cells
_MOST_CELLS = 100_000  # bound of memory


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    data: memoryview


def read_matlab(path: Path) -> dict[str, Any]:
    """Give the variables by name: numbers in their shape and stored type, characters as rows of text, cells as objects.

    Raises
    ------
    RecordingError
        No MATLAB v5 file, or a damaged one.
    """
    data = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or len(data) < _HEAD:
        raise RecordingError(f"{path}: not a MATLAB v5 file (save it with -v6 or -v7; -v7.3 is another format)")
    try:
        variables: dict[str, Any] = {}
        for element in _inflated(memoryview(data)[_HEAD:], order):
            if element.kind == _MATRIX:
                name, value = _matrix(element.data, order, 0)
                if value is not None:
                    variables[name] = value
    except (ValueError, struct.error, zlib.error, OverflowError) as error:
        raise RecordingError(f"{path}: damaged: {error}") from error
    return variables


def _inflated(data: memoryview, order: str) -> Iterator[_Element]:
    """The file's elements, compressed ones unpacked."""
    budget_bytes = _MOST_INFLATED_BYTES
    for element in _elements(data, order, padded=False):
        if element.kind != _COMPRESSED:
            yield element
            continue
        unpacked = zlib.decompressobj().decompress(element.data, budget_bytes)
        budget_bytes -= len(unpacked)
        if budget_bytes <= 0:
            raise ValueError(f"more than {_MOST_INFLATED_BYTES / 1e6:.0f} MB once unpacked")
        yield from _elements(memoryview(unpacked), order)


def _elements(data: memoryview, order: str, *, padded: bool = True) -> Iterator[_Element]:
    """The elements in these bytes; at the top level of a file a compressed one has no padding behind it."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # the small form: kind, size and four bytes of data in eight
            kind, size = kind & 0xFFFF, kind >> 16
            start, after = at + 4, at + 8
            if size > 4:
                raise ValueError(f"an element of {size} bytes in the place of 4")
        else:
            start = at + 8
            after = start + (size if kind == _COMPRESSED and not padded else -(-size // 8) * 8)
        if start + size > len(data):
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
        yield _Element(kind, data[start : start + size])
        at = after


def _matrix(data: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Name and value; the value is None for a class that is not read."""
    parts = _elements(data, order)
    flags, dimensions = _next(parts), _next(parts)
    kind = struct.unpack_from(f"{order}I", flags.data)[0] & 0xFF
    if kind == _OPAQUE:  # an object of MATLAB's own, which has a name and no dimensions
        return bytes(dimensions.data).decode("latin-1"), None
    label = _next(parts)
    shape = tuple(int(n) for n in np.frombuffer(dimensions.data, f"{order}i4"))
    name = bytes(label.data).decode("latin-1")
    if len(shape) < 2 or min(shape) < 0:
        raise ValueError(f"'{name[:40]}' has dimensions {shape}")
    count = math.prod(shape)
    if kind == _CELL:
        return name, _cells(parts, shape, count, order, depth)
    if kind == _CHARACTER:
        return name, _rows(_next(parts), shape, count, order)
    if not _FIRST_NUMBER <= kind <= _LAST_NUMBER:
        return name, None
    real = _next(parts)
    if real.kind not in _NUMBERS:
        raise ValueError(f"'{name[:40]}' holds no numbers")
    values = np.frombuffer(real.data, order + _NUMBERS[real.kind])
    if values.size != count:
        raise ValueError(f"'{name[:40]}' has {values.size} numbers for dimensions {shape}")
    return name, values.reshape(shape, order="F")


def _cells(parts: Iterator[_Element], shape: tuple[int, ...], count: int, order: str, depth: int) -> Any:
    if depth >= _MOST_NESTED or count > _MOST_CELLS:
        raise ValueError("too many cells, or cells in cells")
    cells = np.empty(count, dtype=object)
    for index in range(count):
        cells[index] = _matrix(_next(parts).data, order, depth + 1)[1]
    return cells.reshape(shape, order="F")


def _rows(element: _Element, shape: tuple[int, ...], count: int, order: str) -> Any:
    """A character array as an array of its rows."""
    encoding = _ENCODINGS.get(element.kind)
    if encoding is None:
        raise ValueError("characters in an encoding that is not known")
    wide = {"<": "-le", ">": "-be"}[order] if encoding in ("utf-16", "utf-32") else ""
    text = bytes(element.data).decode(encoding + wide, "replace")
    if count > len(text):
        raise ValueError(f"{len(text)} characters for dimensions {shape}")
    if not count:
        return np.array([""])
    letters = np.array(list(text[:count])).reshape(shape[0], -1, order="F")
    return np.array(["".join(row) for row in letters])


def _next(parts: Iterator[_Element]) -> _Element:
    element = next(parts, None)
    if element is None:
        raise ValueError("an array ends before its parts do")
    return element
