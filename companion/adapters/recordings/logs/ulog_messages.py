"""PX4's log format: a header and length-prefixed messages, walked once from front to back.

Every message is looked at once and none is allocated for, so that a damaged log costs what its bytes cost: where a
message cannot be right, the walk goes on at the next place from which five messages follow one another. The format is
https://docs.px4.io/main/en/dev_log/ulog_file_format.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
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

MAGIC = b"ULog\x01\x12\x35"
_FIRST = 16  # bytes of the file's header (by definition)
_HEAD = 3  # bytes of a message's: size and kind (by definition)
_KINDS = b"FDIMPQARSLOCB"
_FORMAT, _DATA, _PARAMETER, _ADD, _DROPOUT, _FLAGS = b"FDPAOB"
_CANDIDATE = re.compile(rb"(?=[\x00-\xff]{2}[" + _KINDS + rb"])", re.DOTALL)
_CHAIN = 5  # messages in a row that prove a place behind damage (choice)
_LONG = 1000  # bytes: few true messages are longer (choice)
_MOST_UNKNOWN_BYTES = 10_000  # chosen: a message of a later version is hardly longer
_MOST_BYTES = 65_535  # the size of a message is a uint16 (PX4's ULog format)
_MOST_NESTED = 8  # bound of recursion: depth of types within types
_MOST_ELEMENTS = 64  # of an array that is given as columns (choice)
_TYPES = {
    "int8_t": "i1",
    "uint8_t": "u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "int64_t": "<i8",
    "uint64_t": "<u8",
    "float": "<f4",
    "double": "<f8",
    "bool": "i1",
    "char": "i1",
}
_FIELD = re.compile(r"([a-zA-Z0-9_]+)(?:\[(\d{1,5})\])? ([a-zA-Z0-9_]+)")


@dataclass(frozen=True, slots=True)
class _TopicLayout:
    """Where a topic's columns are: name to (numpy type, offset). Padding at the end may be missing in the file."""

    columns: dict[str, tuple[str, int]]
    least_bytes: int
    most_bytes: int


@dataclass(slots=True)
class _Topic:
    name: str
    instance: int
    layout: _TopicLayout
    starts: list[int] = field(default_factory=list)


class UlogMessages:
    """A log, walked.

    Only topics named in ``topics`` are kept. The log begins at boot time ``start_us``; ``parameters`` are boot time in
    us, name and value, at the start and whenever one changed. ``damaged_bytes`` belong to no message that can be right,
    ``cut_bytes`` to the incomplete message at the end.

    Raises
    ------
    RecordingError
        No ULog, or one of a kind that cannot be read.
    """

    def __init__(self, path: Path, topics: Collection[str]) -> None:
        self.dropouts_ms: list[int] = []
        self.damaged_bytes = self.cut_bytes = 0
        self._wanted = frozenset(topics)
        self._formats: dict[str, str] = {}
        self._topics: dict[int, _Topic | None] = {}  # None: logged, but not wanted
        self._finished: list[_Topic] = []
        self._borders: list[int] = []
        self._values: list[tuple[int, str, float]] = []  # of parameters, with their place in the file
        self._data = path.read_bytes()
        if len(self._data) < _FIRST or not self._data.startswith(MAGIC):
            raise RecordingError(f"{path}: cannot be read as a ULog: its header is not whole")
        self.start_us = int.from_bytes(self._data[8:16], "little")
        try:
            self._walk()
        except _Incompatible as error:
            raise RecordingError(f"{path}: cannot be read as a ULog: {error}") from None
        self._sample_leaps: dict[tuple[str, int], int] = {}
        self._ahead: set[int] = set()  # places of samples whose stamps leap
        self._places, self._stamps_us = self._timed()
        self.parameters = self._timed_parameters()

    @property
    def logged(self) -> list[tuple[str, int]]:
        """Names and instances of the wanted topics that have samples."""
        return sorted({(topic.name, topic.instance) for topic in self._all() if topic.starts})

    def take(self, name: str, instance: int, *needed: str) -> dict[str, Any]:
        """Give a topic's columns by name (``q[0]`` for elements), in the order of the log.

        Empty where there is none, or where this log's version of it lacks a ``needed`` column.
        """
        for topic in self._all():
            columns = topic.layout.columns
            if (topic.name, topic.instance) == (name, instance) and topic.starts and set(needed) <= columns.keys():
                starts = [start for start in topic.starts if start not in self._ahead] if self._ahead else topic.starts
                rows = self._bytes(np.array(starts, dtype=np.int64), topic.layout.least_bytes)
                table = {column: _column(rows, *place) for column, place in columns.items()}
                if {"timestamp", "timestamp_sample"} <= columns.keys():
                    ahead = ahead_of_messages(table["timestamp_sample"], table["timestamp"])
                    self._sample_leaps[name, instance] = int(ahead.sum())
                    table = {column: values[~ahead] for column, values in table.items()} if ahead.any() else table
                return table
        return {}

    @property
    def leaps(self) -> int:
        """Samples that are left out for stamps that leap ahead; those for ``timestamp_sample`` as they are taken."""
        return len(self._ahead) + sum(self._sample_leaps.values())

    def _all(self) -> list[_Topic]:
        return [*self._finished, *(topic for topic in self._topics.values() if topic is not None)]

    def _walk(self) -> None:
        data, end, at = self._data, len(self._data), _FIRST
        topics = self._topics
        while at + _HEAD <= end:
            size, kind = data[at] | data[at + 1] << 8, data[at + 2]
            stop = at + _HEAD + size
            border = self._borders[0] if self._borders else end
            if at >= border < end:
                del self._borders[0]
            elif stop > border < end:
                at = border  # what was being written when the log was first closed
            elif kind == _DATA and size >= 2 and stop <= end:
                number = data[at + 3] | data[at + 4] << 8
                topic = topics.get(number, _UNKNOWN)
                if topic is None:
                    at = stop
                elif isinstance(topic, _Topic) and topic.layout.least_bytes <= size - 2 <= topic.layout.most_bytes:
                    topic.starts.append(at + 5)
                    at = stop
                else:
                    at = self._after_damage(at, stop)
            elif self._fits(kind, stop) and self._understand(at, kind, data[at + _HEAD : stop]):
                at = stop
            else:
                at = self._after_damage(at, stop)
        self.cut_bytes += max(end - at, 0)

    def _fits(self, kind: int, stop: int) -> bool:
        """Whether what is no sample may be a message: noise that begins like one is not followed by others."""
        return kind in _KINDS and (
            stop == len(self._data) or (kind != _DATA and self._chained(stop, _CHAIN, strict=False))
        )

    def _after_damage(self, at: int, stop: int) -> int:
        """The next message: behind this one if that looks like one, else wherever five follow one another."""
        data, end = self._data, len(self._data)
        listed = data[at + 2] in _KINDS
        if stop <= end and (listed or 0 < stop - at - _HEAD <= _MOST_UNKNOWN_BYTES) and self._chained(stop, _CHAIN):
            self.damaged_bytes += stop - at if listed else 0  # another kind may be of a later version
            return stop
        for candidate in _CANDIDATE.finditer(data, at + 1):
            if self._chained(candidate.start(), _CHAIN):
                self.damaged_bytes += candidate.start() - at
                return candidate.start()
        self.cut_bytes += end - at
        return end

    def _chained(self, at: int, count: int, *, strict: bool = True) -> bool:
        """Whether so many messages that may be right follow one another, or the end comes after at least one.

        With ``strict``, samples must be of topics that were named before, and others not long: among noise a long one
        ends on some message's beginning too easily, and takes thousands of right ones with it.
        """
        data, end = self._data, len(self._data)
        for number in range(count):
            if at == end and number:
                return True
            if at + _HEAD > end or data[at + 2] not in _KINDS:
                return False
            size, is_sample = data[at] | data[at + 1] << 8, data[at + 2] == _DATA
            if strict and is_sample and int.from_bytes(data[at + 3 : at + 5], "little") not in self._topics:
                return False
            if strict and not is_sample and size > _LONG:
                return False
            at += _HEAD + size
        return at <= end

    def _understand(self, at: int, kind: int, body: bytes) -> bool:
        """Take a message that is no sample; False where it cannot be right."""
        try:
            if kind == _FORMAT:
                name, _, fields = body.decode("utf-8", "replace").partition(":")
                self._formats.setdefault(name, fields)
            elif kind == _ADD:
                self._subscribe(body)
            elif kind == _PARAMETER:
                self._values.append((at, *_parameter(body)))
            elif kind == _DROPOUT:
                self.dropouts_ms.append(struct.unpack("<H", body)[0])
            elif kind == _FLAGS and at == _FIRST:
                self._flags(body)
        except (ValueError, struct.error):
            return False
        return True

    def _subscribe(self, body: bytes) -> None:
        instance, number = struct.unpack_from("<BH", body)
        name = body[3:].decode("utf-8", "replace")
        before = self._topics.get(number)
        if before is not None and before.starts:
            self._finished.append(before)
        self._topics[number] = None
        if name in self._wanted:
            self._topics[number] = _Topic(name, instance, _layout(name, self._formats))

    def _timed(self) -> tuple[Ints, Ints]:
        """Places of all stamped samples in the file's order and their stamps, us; the log's start comes first.

        A topic may be logged long after it was published, so that stamps are held against their own topic's; what is
        logged once may have any stamp.
        """
        places, stamps_us = [np.zeros(1, dtype=np.int64)], [as_stamps(np.array([self.start_us], np.uint64))]
        ahead, repeated = [np.zeros(1, dtype=np.bool_)], [np.zeros(1, dtype=np.bool_)]
        for topic in self._all():
            kind, offset = topic.layout.columns.get("timestamp", ("", 0))
            if kind == "<u8" and topic.starts:
                starts = np.array(topic.starts, dtype=np.int64)
                places.append(starts)
                stamps_us.append(as_stamps(_column(self._bytes(starts, offset + 8), kind, offset)))
                ahead.append(ahead_of_neighbours(stamps_us[-1]))
                repeated.append(np.full(starts.size, starts.size > 1))
        order = np.argsort(np.concatenate(places), kind="stable")
        in_order, in_order_us = np.concatenate(places)[order], np.concatenate(stamps_us)[order]
        leaps = np.concatenate(ahead)[order] | (ahead_of_end(in_order_us) & np.concatenate(repeated)[order])
        self._ahead = set(in_order[leaps].tolist())
        return in_order[~leaps], in_order_us[~leaps]

    def _timed_parameters(self) -> list[tuple[int, str, float]]:
        """Each with the newest stamp before it in the file, which is when it changed; the start where there is none."""
        newest_us = np.maximum.accumulate(self._stamps_us)
        at = np.searchsorted(self._places, [place for place, _, _ in self._values]) - 1
        return [(int(t_us), name, value) for t_us, (_, name, value) in zip(newest_us[at], self._values, strict=True)]

    def _bytes(self, starts: Ints, count: int) -> Any:
        """(n, count) bytes from these places on."""
        return np.frombuffer(self._data, dtype=np.uint8)[starts[:, None] + np.arange(count)]

    def _flags(self, body: bytes) -> None:
        incompatible, offsets = body[8:16], struct.unpack_from("<3Q", body, 16)
        if incompatible[0] & ~1 or any(incompatible[1:]):
            raise _Incompatible("it says that it needs a later reader (incompatible flags)")
        self._borders = sorted(offset for offset in offsets if _FIRST < offset < len(self._data))


class _Incompatible(Exception):
    """The log says that it cannot be read by rules of ours."""


_UNKNOWN = object()


def _parameter(body: bytes) -> tuple[str, float]:
    """Name and value; raises ValueError or struct.error for what is neither a float nor a whole number."""
    key = body[1 : 1 + body[0]].decode("utf-8", "replace") if body else ""
    kind, _, name = key.partition(" ")
    if kind not in ("float", "int32_t") or not name:
        raise ValueError("no parameter")
    (value,) = struct.unpack("<f" if kind == "float" else "<i", body[1 + body[0] :])
    return name, float(value)


def _layout(name: str, formats: Mapping[str, str]) -> _TopicLayout:
    """Columns of a topic; raises ValueError for a format that is missing or cannot be right."""
    columns: dict[str, tuple[str, int]] = {}
    sizes: dict[str, int] = {}
    at = least = 0
    for kind, count, label in _fields(formats, name):
        size = _size(kind, formats, sizes, 0)
        if kind in _TYPES and count is None:
            columns.setdefault(label, (_TYPES[kind], at))
        elif kind in _TYPES and count is not None and count <= _MOST_ELEMENTS:
            columns |= {f"{label}[{i}]": (_TYPES[kind], at + i * size) for i in range(count)}
        at += size * (1 if count is None else count)
        if at > _MOST_BYTES:
            raise ValueError("longer than a message can be")
        if not label.startswith("_padding"):
            least = at
    inside = {label: place for label, place in columns.items() if place[1] + int(place[0][-1]) <= least}
    if not inside:
        raise ValueError("no column")
    return _TopicLayout(inside, least, at)


def _fields(formats: Mapping[str, str], name: str) -> list[tuple[str, int | None, str]]:
    fields = []
    for text in filter(None, formats.get(name, "").split(";")):
        parts = _FIELD.fullmatch(text)
        if parts is None:
            raise ValueError(f"no field: {text[:40]}")
        fields.append((parts[1], None if parts[2] is None else int(parts[2]), parts[3]))
    if not fields:
        raise ValueError("no format")
    return fields


def _size(kind: str, formats: Mapping[str, str], sizes: dict[str, int], depth: int) -> int:
    """Bytes of a type, nested ones too; ``sizes`` are those of before."""
    if kind in _TYPES:
        return int(_TYPES[kind][-1])
    if kind in sizes:
        return sizes[kind]
    if depth >= _MOST_NESTED:
        raise ValueError("nested too deeply")
    total = 0
    for inner, count, _ in _fields(formats, kind):
        total += _size(inner, formats, sizes, depth + 1) * (1 if count is None else count)
        if total > _MOST_BYTES:
            raise ValueError("longer than a message can be")
    sizes[kind] = total
    return total


def _column(rows: Any, kind: str, offset: int) -> Any:
    size = int(kind[-1])
    return np.ascontiguousarray(rows[:, offset : offset + size]).view(kind)[:, 0]
