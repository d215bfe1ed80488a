"""ArduPilot's onboard log format: self-describing binary messages (0xA3 0x95 type body), parsed in bulk with numpy.

pymavlink's reader makes a Python object of every message; here a kind of message becomes an array in one pass, which
logs of millions of samples need. Format letters as in AP_Logger's LogStructure.h; scaled letters (c, C, e, E, L) are
given in their unit, others raw.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.logs.stamps_ahead import (
    ahead_of_end,
    ahead_of_messages,
    ahead_of_neighbours,
    as_stamps,
)
from companion.errors import RecordingError
from companion.records import Ints

MAGIC = b"\xa3\x95\x80"
_HEAD_1, _HEAD_2, _FMT_TYPE, _FMT_BYTES = 0xA3, 0x95, 128, 89  # AP_Logger's LogStructure.h
_TEXTS = "anNZ"  # letters of what is no number
_FMT = struct.Struct("<BB4s16s64s")
# letter -> (numpy type, factor)
_LETTERS: dict[str, tuple[str, float]] = {
    "a": ("(32,)<i2", 1.0),
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "g": ("<f2", 1.0),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
    "c": ("<i2", 0.01),
    "C": ("<u2", 0.01),
    "e": ("<i4", 0.01),
    "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7),
    "M": ("u1", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}


@dataclass(frozen=True, slots=True)
class _Format:
    name: str
    length: int
    letters: str
    fields: tuple[str, ...]

    @property
    def begins_with_time(self) -> bool:
        """Whether the first field is the boot time, us."""
        return self.fields[0] == "TimeUS" and self.letters[0] == "Q"

    @property
    def layout(self) -> np.dtype[Any]:
        """Fields as numpy has them."""
        rows = zip(self.fields, self.letters, strict=True)
        return np.dtype([(field, _LETTERS[letter][0]) for field, letter in rows])

    @property
    def fits(self) -> bool:
        """Whether the fields are as long as the message is said to be."""
        return self.layout.itemsize == self.length - 3

    def has(self, needed: tuple[str, ...]) -> bool:
        """Whether these fields are there, ``Name`` as a text and all others as numbers."""
        letters = dict(zip(self.fields, self.letters, strict=True))
        return all(name in letters and (letters[name] in _TEXTS) == (name == "Name") for name in needed)


class DataflashLog:
    """A log in memory; messages of a kind are taken out as arrays.

    ``skipped_bytes`` lie inside the log and belong to no message; ``cut_bytes`` are of the incomplete message at the
    end. Messages whose ``TimeUS`` or ``SampleUS`` leaps ahead are left out and counted in ``leaps``. Kinds of messages
    whose fields are not as long as they are said to be are named in ``misfits`` and passed over.

    Raises
    ------
    RecordingError
        No dataflash log, or nothing whole in it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data = np.fromfile(path, dtype=np.uint8)
        if not self._data[:3].tobytes() == MAGIC:
            raise RecordingError(f"{path}: not an ArduPilot .BIN log")
        heads = np.flatnonzero((self._data[:-2] == _HEAD_1) & (self._data[1:-1] == _HEAD_2))
        types = self._data[heads + 2]
        self._formats = self._read_formats(heads[types == _FMT_TYPE])
        lengths = np.zeros(256, dtype=np.int64)
        for number, entry in self._formats.items():
            lengths[number] = entry.length
        intact, self.skipped_bytes, self.cut_bytes = _chain(heads, lengths[types], self._data.size)
        self._starts = heads[intact]
        self._types = types[intact]
        if not self._starts.size:
            raise RecordingError(f"{path}: no whole message in this log")
        self._message_leaps = self._drop_leaps()
        self._sample_leaps: dict[str, int] = {}

    @property
    def misfits(self) -> list[str]:
        """Names of the kinds of messages whose format contradicts itself."""
        return [entry.name for entry in self._formats.values() if not entry.fits]

    @property
    def leaps(self) -> int:
        """Messages that were left out for stamps that leap ahead; those for their sample's as they are taken."""
        return self._message_leaps + sum(self._sample_leaps.values())

    def take(self, name: str, *needed: str) -> dict[str, Any]:
        """Give all messages of a kind as a dict of field name to array, in log order.

        Empty where there are none, or where this log's version of them lacks a ``needed`` field or has it as a text
        (``Name``: as a number).
        Integers and floats keep their width, scaled fields become float64 in their unit, texts bytes.
        """
        for number, entry in self._formats.items():
            if entry.name == name and entry.fits and entry.has(needed):
                table = self._table(number, entry)
                if {"TimeUS", "SampleUS"} <= set(entry.fields):
                    ahead = ahead_of_messages(table["SampleUS"], table["TimeUS"])
                    self._sample_leaps[name], table = int(ahead.sum()), table[~ahead]
                return {
                    field: _scaled(table[field], letter)
                    for field, letter in zip(entry.fields, entry.letters, strict=True)
                }
        return {}

    def _table(self, number: int, entry: _Format) -> Any:
        starts = self._starts[self._types == number] + 3
        dtype = entry.layout
        return self._data[starts[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]

    def _drop_leaps(self) -> int:
        """Leave out messages whose time is far ahead of their neighbours'; gives their number."""
        timed = [number for number, entry in self._formats.items() if entry.fits and entry.begins_with_time]
        places = np.flatnonzero(np.isin(self._types, timed))
        t_us = self._data[self._starts[places][:, None] + np.arange(3, 11)].view("<u8")[:, 0]
        stamps_us = as_stamps(t_us)
        ahead = places[ahead_of_neighbours(stamps_us) | ahead_of_end(stamps_us)]
        self._starts, self._types = np.delete(self._starts, ahead), np.delete(self._types, ahead)
        return int(ahead.size)

    def _read_formats(self, starts: Ints) -> dict[int, _Format]:
        formats = {_FMT_TYPE: _Format("FMT", _FMT_BYTES, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))}
        for start in starts.tolist():
            body = self._data[start + 3 : start + _FMT_BYTES].tobytes()
            if len(body) < _FMT.size:
                continue
            number, length, *texts = _FMT.unpack(body)
            name, letters, columns = (text.split(b"\0")[0].decode("ascii", "replace") for text in texts)
            fields = tuple(columns.split(","))
            plain = all(fields) and len(set(fields)) == len(fields) == len(letters)
            if length > 3 and plain and set(letters) <= _LETTERS.keys():
                entry = _Format(name, length, letters, fields)
                if number not in formats or (entry.fits and not formats[number].fits):
                    formats[number] = entry
        return formats


def _chain(heads: Ints, lengths: Ints, size: int) -> tuple[Ints, int, int]:
    """Follow messages from head to head; give the indices of true heads, and the bytes skipped and cut.

    Nearly always a message ends where the next head stands; only where it does not (a head's pattern inside a message,
    or damage) is the next one looked up.
    """
    ends = heads + lengths
    breaks = [*np.flatnonzero(ends[:-1] != heads[1:]).tolist(), heads.size - 1]
    runs: list[Ints] = []
    at = skipped = 0
    for last in breaks:
        if last < at:
            continue
        end = int(ends[last])
        good = lengths[last] > 0 and end <= size
        runs.append(np.arange(at, last + 1 if good else last))
        if not good and end > size:
            return np.concatenate(runs), skipped, size - int(heads[last])
        following = int(np.searchsorted(heads, end)) if good else last + 1
        if following >= heads.size:
            return np.concatenate(runs), skipped, size - end if good else size - int(heads[last])
        skipped += int(heads[following]) - (end if good else int(heads[last]))
        at = following
    return np.concatenate(runs), skipped, 0


def _scaled(values: Any, letter: str) -> Any:
    factor = _LETTERS[letter][1]
    return values if factor == 1.0 else values * factor
