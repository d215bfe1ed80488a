"""The compiled way of plain inertial messages: from a chunk's bytes to SI samples of every source, in one pass.

It reads what a healthy vehicle sends thousands of times a second: HIGHRES_IMU, RAW_IMU and SCALED_IMU* of our sources
with nothing odd about them. Every other frame is found here too, and read by who reads everything where nothing is
compiled; so is all that one source has in a chunk with something odd in it. What is odd, and what that means, is said
there alone (:mod:`companion.adapters.mavlink.decode.layouts`, :mod:`companion.adapters.mavlink.decode.inertial`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from fastcrc.crc16 import mcrf4xx

from companion.adapters.mavlink.decode.layouts import IMPLAUSIBLE_STAMP_US, INTEGER_SCALE
from companion.adapters.mavlink.decode.source_map import MappedSource
from companion.adapters.mavlink.link.dialect import CRC_EXTRA, ID_OF, payload_size
from companion.records import Floats, Ints

try:
    from numba import njit
except ImportError:  # everything goes the plain way
    njit = None

COMPILED = njit is not None
_NO_SYSTEM = -1  # convention: no system id is negative
_HIGHRES, _RAW, _SCALED = range(3)
_FORMS = {
    "HIGHRES_IMU": _HIGHRES,
    "RAW_IMU": _RAW,
    "SCALED_IMU": _SCALED,
    "SCALED_IMU2": _SCALED,
    "SCALED_IMU3": _SCALED,
}
_FORM_OF = {ID_OF[name]: form for name, form in _FORMS.items()}
_MAGIC_1, _MAGIC_2 = 0xFE, 0xFD
_COUNTED = 5  # position, frames, checksum errors, unknown, skipped bytes
_LARGEST = 255  # bytes of a MAVLink payload
_SHORTEST = 8  # bytes of a MAVLink 1 frame without payload

_Bytes = np.ndarray[tuple[int], np.dtype[np.uint8]]
# what a byte leaves in the checksum, alone and with one to three zeros behind it: four bytes are taken at once
_CRC = np.array([[mcrf4xx(bytes([byte]) + bytes(zeros), 0) for byte in range(256)] for zeros in range(4)], np.int64)


def _compiled(function: Any) -> Any:
    return function if njit is None else njit(cache=True, error_model="numpy")(function)


class SampleRun(NamedTuple):
    """Samples of one source in a chunk, in arrival order, body axes, all of them plain.

    ``t_ns`` (n,) as sent, and its ends in time; ``values`` (n, 6) in SI, zero along axes that the source does not send.
    """

    source: MappedSource
    t_ns: Ints
    values: Floats
    oldest_ns: int
    newest_ns: int


class _Plan(NamedTuple):
    """Sources to be read, as plain arrays: compiled code may rest on nothing else that is said in other files.

    Attributes
    ----------
    extra : (ids,) int64
        CRC extra of every message id, -1 where it is unknown.
    longest : (256,) int64
        Payload of MAVLink 1 by message id.
    limit_us : int
        From here on a stamp is odd.
    number : (sources, 8) int64
        Key without the system, the message's layout, the sensor axis behind each body axis.
    factor : (sources, 6) float64
        Unit of each body axis with its sign, 0 where it is not sent.
    """

    extra: Ints
    longest: Ints
    limit_us: int
    number: Ints
    factor: Floats


class BulkDecoder:
    """Reads the plain sources of one vehicle."""

    def __init__(self, sources: Sequence[MappedSource]) -> None:
        shared = [(source.message, source.component) for source in sources]
        self._sources = tuple(
            source
            for source, place in zip(sources, shared, strict=True)
            if source.message in _FORM_OF and source.instance == "0" and shared.count(place) == 1
        )
        self._plan = _plan(self._sources)
        self.scan(b"", None, [])  # compiled now, or loaded, and not in flight

    def scan(
        self, buffer: bytes, system: int | None, frames: list[tuple[int, bytes]]
    ) -> tuple[int, list[int], list[SampleRun]]:
        """Read a buffer; frames that are not in the runs are appended to ``frames``.

        Returns
        -------
        position : int
            Of the first byte that has to wait for more.
        counted : [frames, crc_errors, unknown, skipped_bytes]
        runs : list of Run
        """
        counts, t_ns, values = _read(
            np.frombuffer(buffer, np.uint8), _NO_SYSTEM if system is None else system, self._plan
        )
        numbers = counts.tolist()
        at = _COUNTED + 3 * len(self._sources)
        for k in range(at, len(numbers), 3):
            frames.append((numbers[k], buffer[numbers[k + 1] : numbers[k + 2]]))
        runs, first = [], 0
        for k, source in enumerate(self._sources):
            count, oldest_ns, newest_ns = numbers[_COUNTED + 3 * k : _COUNTED + 3 * k + 3]
            if count:
                last = first + count
                runs.append(SampleRun(source, t_ns[first:last], values[first:last], oldest_ns, newest_ns))
                first = last
        return numbers[0], numbers[1:_COUNTED], runs


@functools.cache
def _checksum_tables() -> tuple[Ints, Ints]:
    """CRC extra of every message id, and the longest payload of MAVLink 1, as :class:`_Plan` has them."""
    extra = np.full(max(CRC_EXTRA) + 1, -1, np.int64)
    extra[list(CRC_EXTRA)] = list(CRC_EXTRA.values())
    longest = np.array([payload_size(identity) if identity in CRC_EXTRA else 0 for identity in range(256)])
    return extra, longest


def seek(buffer: bytes, start: int) -> int:
    """The next place from ``start`` on with a whole frame, or one that is not complete; the end where there is none."""
    counted, spans = np.zeros(_COUNTED, np.int64), np.empty((1, 4), np.int64)
    rest = np.frombuffer(buffer, np.uint8)[start:]
    position = _find(rest, *_checksum_tables(), spans, counted)
    return start + (int(spans[0, 3]) if counted[1] else position)


def _plan(sources: Sequence[MappedSource]) -> _Plan:
    number, factor = np.empty((len(sources), 8), np.int64), np.empty((len(sources), 6))
    for at, source in enumerate(sources):
        form = _FORM_OF[source.message]
        number[at] = source.message << 16 | source.component << 8, form, *source.order
        unit = np.ones(6) if form == _HIGHRES else INTEGER_SCALE
        sends = np.array([int(source.sends) >> axis & 1 for axis in range(6)])
        factor[at] = unit[source.order] * source.signs * sends
    return _Plan(*_checksum_tables(), IMPLAUSIBLE_STAMP_US, number, factor)


@_compiled
def _read(buffer: _Bytes, system: int, plan: _Plan) -> tuple[Ints, Ints, Floats]:
    """Read a buffer.

    Returns
    -------
    counts : int64
        Position and counts; number, oldest and newest stamp of each source's samples; then key, start and end of every
        payload that is not among these.
    t_ns : (n,) int64
        One source after the other.
    values : (n, 6) float64
    """
    counted = np.zeros(_COUNTED, np.int64)
    spans = np.empty((len(buffer) // _SHORTEST, 4), np.int64)
    counted[0] = _find(buffer, plan.extra, plan.longest, spans, counted)
    count = counted[1]
    of, rows = np.full(count, -1), np.zeros(len(plan.number), np.int64)
    for k in range(count):
        if spans[k, 0] & 0xFF == system:
            for source in range(len(rows)):
                if spans[k, 0] & ~0xFF == plan.number[source, 0]:
                    of[k] = source
                    rows[source] += 1
    t_ns, values, first = np.empty(rows.sum(), np.int64), np.empty((rows.sum(), 6)), 0
    at = _COUNTED + 3 * len(rows)
    counts = np.zeros(at + 3 * count, np.int64)
    counts[:_COUNTED] = counted
    for source in range(len(rows)):
        if rows[source] and _fill(buffer, spans, of, source, plan, t_ns[first:], values[first:]):
            stamps_ns, place = t_ns[first : first + rows[source]], _COUNTED + 3 * source
            counts[place], counts[place + 1], counts[place + 2] = rows[source], stamps_ns.min(), stamps_ns.max()
            first += rows[source]
        else:
            rows[source] = 0
    for k in range(count):
        if of[k] < 0 or not rows[of[k]]:
            counts[at : at + 3] = spans[k, :3]
            at += 3
    return counts[:at], t_ns, values


@_compiled
def _find(buffer: _Bytes, extras: Ints, longest: Ints, spans: Ints, counted: Ints) -> int:
    """The scanner's walk, until ``spans`` are full: see :class:`companion.adapters.mavlink.link.scan.Scanner`.

    Each span is a frame's key, the first byte of its payload, the one behind it, and the frame's first byte.
    """
    position, end = 0, len(buffer)
    while position < end:
        newer = buffer[position] == _MAGIC_2
        if not newer and buffer[position] != _MAGIC_1:
            counted[4] += 1
            position += 1
            continue
        first = position + (10 if newer else 6)
        if first > end:
            break
        flags = buffer[position + 2] if newer else 0
        key = np.int64(0)
        for k in range(5 if newer else 3):
            key |= np.int64(buffer[first - (5 if newer else 3) + k]) << (8 * k)
        extra = extras[key >> 16] if key >> 16 < len(extras) else -1
        if flags > 1 or extra < 0:
            counted[3] += flags <= 1
            counted[4] += 1
            position += 1
            continue
        stop = first + buffer[position + 1]
        after = stop + (15 if flags else 2)
        if after > end:
            break
        if not newer and buffer[position + 1] > longest[key >> 16]:
            counted[2] += 1
            counted[4] += 1
            position += 1
            continue
        crc = _checksum(buffer, position + 1, stop)
        crc = (crc >> 8) ^ _CRC[0, (crc ^ extra) & 255]
        if crc != np.int64(buffer[stop]) | np.int64(buffer[stop + 1]) << 8:
            counted[2] += 1
            counted[4] += 1
            position += 1
            continue
        spans[counted[1], 0], spans[counted[1], 1], spans[counted[1], 2] = key, first, stop
        spans[counted[1], 3] = position
        counted[1] += 1
        position = after
        if counted[1] == len(spans):
            break
    return position


@_compiled
def _checksum(buffer: _Bytes, first: int, stop: int) -> int:
    """CRC-16/MCRF4XX of the bytes ``first:stop``."""
    crc, k = np.int64(0xFFFF), first
    while k + 4 <= stop:
        together = _CRC[3, (crc ^ buffer[k]) & 255] ^ _CRC[2, (crc >> 8) ^ buffer[k + 1]]
        crc = together ^ _CRC[1, buffer[k + 2]] ^ _CRC[0, buffer[k + 3]]
        k += 4
    while k < stop:
        crc = (crc >> 8) ^ _CRC[0, (crc ^ buffer[k]) & 255]
        k += 1
    return int(crc)


@_compiled
def _fill(buffer: _Bytes, spans: Ints, of: Ints, source: int, plan: _Plan, t_ns: Ints, values: Floats) -> bool:
    """Samples of one source; False where one of them is odd."""
    payload, raw, row = np.zeros(_LARGEST + 1, np.uint8), np.empty(6), 0
    form = plan.number[source, 1]
    for k in range(len(of)):
        if of[k] != source:
            continue
        length = spans[k, 2] - spans[k, 1]
        payload[:length], payload[length:] = buffer[spans[k, 1] : spans[k, 2]], 0  # trailing zeros are not sent
        t_ns[row] = _sample(form, payload, plan.limit_us, raw)
        if t_ns[row] < 0:
            return False
        for axis in range(6):
            factor = plan.factor[source, axis]
            values[row, axis] = raw[plan.number[source, 2 + axis]] * factor if factor != 0.0 else 0.0
            if not np.isfinite(values[row, axis]):
                return False
        row += 1
    return True


@_compiled
def _sample(form: int, payload: _Bytes, limit_us: int, raw: Floats) -> int:
    """Stamp in ns and raw values of one payload; -1 where it is odd."""
    if form == _SCALED:
        counts = payload.view(np.int16)
        for axis in range(6):
            raw[axis] = counts[2 + axis]
        return int(payload.view(np.uint32)[0]) * 1_000_000
    stamp_us = payload.view(np.uint64)[0]
    if form == _RAW:
        counts = payload.view(np.int16)
        for axis in range(6):
            raw[axis] = counts[4 + axis]
        odd = payload[26] != 0
    else:
        numbers = payload.view(np.float32)
        for axis in range(6):
            raw[axis] = numbers[2 + axis]
        odd = payload[62] != 0 or payload[60] & 63 != 63
    return -1 if odd or stamp_us >= np.uint64(limit_us) else int(stamp_us) * 1000
