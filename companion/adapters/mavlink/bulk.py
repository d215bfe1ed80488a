"""The compiled way of plain inertial messages: from a chunk's bytes to SI samples of every source, in one pass.

It reads what a healthy vehicle sends thousands of times a second: HIGHRES_IMU, RAW_IMU and SCALED_IMU* of our sources
with nothing odd about them. Every other frame is found here too, and read by who reads everything where nothing is
compiled; so is all that one source has in a chunk with something odd in it. What is odd, and what that means, is said
there alone (:mod:`companion.adapters.mavlink.layouts`, :mod:`companion.adapters.mavlink.inertial`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from fastcrc.crc16 import mcrf4xx

from companion.adapters.mavlink.dialect import CRC_EXTRA, ID_OF
from companion.adapters.mavlink.layouts import IMPLAUSIBLE_STAMP_US, INTEGER_SCALE
from companion.adapters.mavlink.mapping import Mapped
from companion.records import Bools, Floats, Ints

try:
    from numba import njit
except ImportError:  # everything goes the plain way
    njit = None

COMPILED = njit is not None
_NO_SYSTEM = -1
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
_LARGEST = 255
_SHORTEST = 8

_Bytes = np.ndarray[tuple[int], np.dtype[np.uint8]]
# what a byte leaves in the checksum, alone and with one to three zeros behind it: four bytes are taken at once
_CRC = np.array([[mcrf4xx(bytes([byte]) + bytes(zeros), 0) for byte in range(256)] for zeros in range(4)], np.int64)


def _compiled(function: Any) -> Any:
    return function if njit is None else njit(cache=True, error_model="numpy")(function)


class Run(NamedTuple):
    """Samples of one source in a chunk, in arrival order, body axes, all of them plain.

    ``t_ns`` (n,) as sent; ``values`` (n, 6) in SI, zero along axes that the source does not send.
    """

    source: Mapped
    t_ns: Ints
    values: Floats


class _Plan(NamedTuple):
    """What is to be read, as plain arrays; what is compiled may rest on nothing else that is said in other files.

    Attributes
    ----------
    extra : (ids,) int64
        CRC extra of every message id, -1 where it is unknown.
    limit_us : int
        From here on a stamp is odd.
    key, form : (sources,) int64
        Key without the system, and the message's layout.
    order, scale, sign, sends : (sources, 6)
        Sensor axis behind each body axis; unit of each sensor axis; sign and presence of each body axis.
    """

    extra: Ints
    limit_us: int
    key: Ints
    form: Ints
    order: Ints
    scale: Floats
    sign: Floats
    sends: Bools


class Bulk:
    """Reads the plain sources of one vehicle."""

    def __init__(self, sources: Sequence[Mapped]) -> None:
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
    ) -> tuple[int, list[int], list[Run]]:
        """Read a buffer; frames that are not in the runs are appended to ``frames``.

        Returns
        -------
        position : int
            Of the first byte that has to wait for more.
        counted : [frames, crc_errors, unknown, skipped_bytes]
        runs : list of Run
        """
        found, t_ns, values = _read(
            np.frombuffer(buffer, np.uint8), _NO_SYSTEM if system is None else system, self._plan
        )
        numbers = found.tolist()
        at = _COUNTED + len(self._sources)
        for k in range(at, len(numbers), 3):
            frames.append((numbers[k], buffer[numbers[k + 1] : numbers[k + 2]]))
        runs, first = [], 0
        for source, count in zip(self._sources, numbers[_COUNTED:at], strict=True):
            if count:
                last = first + count
                runs.append(Run(source, t_ns[first:last], values[first:last]))
                first = last
        return numbers[0], numbers[1:_COUNTED], runs


def _plan(sources: Sequence[Mapped]) -> _Plan:
    count = len(sources)
    order, sign = np.empty((count, 6), np.int64), np.empty((count, 6))
    for at, source in enumerate(sources):
        order[at], sign[at] = source.order, source.signs
    forms = np.array([_FORM_OF[source.message] for source in sources], np.int64)
    extra = np.full(max(CRC_EXTRA) + 1, -1, np.int64)
    extra[list(CRC_EXTRA)] = list(CRC_EXTRA.values())
    return _Plan(
        extra,
        IMPLAUSIBLE_STAMP_US,
        np.array([source.message << 16 | source.component << 8 for source in sources], np.int64),
        forms,
        order,
        np.where(forms[:, None] == _HIGHRES, 1.0, INTEGER_SCALE[None, :]),
        sign,
        np.array([[int(source.sends) >> axis & 1 for axis in range(6)] for source in sources], np.bool_).reshape(-1, 6),
    )


@_compiled
def _read(buffer: _Bytes, system: int, plan: _Plan) -> tuple[Ints, Ints, Floats]:
    """Read a buffer.

    Returns
    -------
    found : int64
        Position and counts, samples of each source, then key, start and end of every payload that is not among these.
    t_ns : (n,) int64
        One source after the other.
    values : (n, 6) float64
    """
    counted = np.zeros(_COUNTED, np.int64)
    spans = np.empty((len(buffer) // _SHORTEST, 3), np.int64)
    counted[0] = _find(buffer, plan.extra, spans, counted)
    count = counted[1]
    of, rows = np.full(count, -1), np.zeros(len(plan.key), np.int64)
    for k in range(count):
        if spans[k, 0] & 0xFF == system:
            for source in range(len(rows)):
                if spans[k, 0] & ~0xFF == plan.key[source]:
                    of[k] = source
                    rows[source] += 1
    t_ns, values, first = np.empty(rows.sum(), np.int64), np.empty((rows.sum(), 6)), 0
    for source in range(len(rows)):
        if rows[source] and _fill(buffer, spans, of, source, plan, t_ns[first:], values[first:]):
            first += rows[source]
        else:
            rows[source] = 0
    found, at = np.empty(_COUNTED + len(rows) + 3 * (count - first), np.int64), _COUNTED + len(rows)
    found[:_COUNTED], found[_COUNTED:at] = counted, rows
    for k in range(count):
        if of[k] < 0 or not rows[of[k]]:
            found[at : at + 3] = spans[k]
            at += 3
    return found, t_ns, values


@_compiled
def _find(buffer: _Bytes, extras: Ints, spans: Ints, counted: Ints) -> int:
    """The scanner's walk: see :class:`companion.adapters.mavlink.scan.Scanner`."""
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
        crc = _checksum(buffer, position + 1, stop)
        crc = (crc >> 8) ^ _CRC[0, (crc ^ extra) & 255]
        if crc != np.int64(buffer[stop]) | np.int64(buffer[stop + 1]) << 8:
            counted[2] += 1
            counted[4] += 1
            position += 1
            continue
        spans[counted[1], 0], spans[counted[1], 1], spans[counted[1], 2] = key, first, stop
        counted[1] += 1
        position = after
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
    form = plan.form[source]
    for k in range(len(of)):
        if of[k] != source:
            continue
        length = spans[k, 2] - spans[k, 1]
        payload[:length], payload[length:] = buffer[spans[k, 1] : spans[k, 2]], 0  # trailing zeros are not sent
        t_ns[row] = _sample(form, payload, plan.limit_us, raw)
        if t_ns[row] < 0:
            return False
        for axis in range(6):
            origin = plan.order[source, axis]
            value = raw[origin] * plan.scale[source, origin] * plan.sign[source, axis]
            values[row, axis] = value if plan.sends[source, axis] else 0.0
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
