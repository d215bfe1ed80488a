"""Compiled path of plain inertial messages: a chunk's bytes to SI samples of every source in one pass.

It reads what a healthy vehicle sends thousands of times a second: HIGHRES_IMU, RAW_IMU and SCALED_IMU* of our sources
with nothing odd about them, in ``native/mavlink.c``. Every other frame is found there too, and read one by one; so is
all that one source has in a chunk with something odd in it. What is odd, and what that means, is said
there alone (:mod:`companion.adapters.mavlink.decode.layouts`, :mod:`companion.adapters.mavlink.decode.inertial`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from fastcrc.crc16 import mcrf4xx

from companion.adapters.mavlink.decode.layouts import IMPLAUSIBLE_STAMP_US, INTEGER_SCALE
from companion.adapters.mavlink.decode.source_map import MappedSource
from companion.adapters.mavlink.link.dialect import CRC_EXTRA, ID_OF, payload_size
from companion.native.library import ARRAY, INTEGER, RECORD, kernel, packed
from companion.records import Floats, Ints

_BYTE = np.dtype(np.uint8)
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
_COUNTED = 5  # position, frames, checksum errors, unknown, skipped bytes (by definition)
_SHORTEST = 8  # bytes of a MAVLink 1 frame without payload

# what a byte leaves in the checksum, alone and with one to seven zeros behind it: eight bytes are taken at once
_CRC = np.array([[mcrf4xx(bytes([byte]) + bytes(zeros), 0) for byte in range(256)] for zeros in range(8)], np.int64)


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
    """Sources to be read, as plain arrays.

    Attributes
    ----------
    crc : (8, 256) int64
        What a byte leaves in the checksum, alone and with one to seven zeros behind it.
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

    crc: Ints
    extra: Ints
    longest: Ints
    limit_us: int
    number: Ints
    factor: Floats


class _Room:
    """Room for what a buffer of some size may hold."""

    def __init__(self, size: int, sources: int) -> None:
        self.size, frames = size, size // _SHORTEST
        self.counts = np.empty(_COUNTED + 3 * (sources + frames), np.int64)
        self.t_ns, self.values = np.empty(frames, np.int64), np.empty((frames, 6))


_packed = packed(_Plan)
_read = kernel("mavlink_read", ARRAY, INTEGER, RECORD, ARRAY, ARRAY, ARRAY)
_seek = kernel("mavlink_seek", ARRAY, ARRAY, ARRAY, ARRAY)


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
        self._laid_out = _packed(self._plan)  # addresses of its arrays, which live as long
        self._room = _Room(0, len(self._sources))

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
        room = self._room
        if len(buffer) > room.size:
            room = self._room = _Room(2 * len(buffer), len(self._sources))
        chunk = np.frombuffer(buffer, _BYTE)
        system = _NO_SYSTEM if system is None else system
        filled = _read(chunk, system, self._laid_out, room.counts, room.t_ns, room.values)
        numbers = room.counts[:filled].tolist()
        at = _COUNTED + 3 * len(self._sources)
        for k in range(at, len(numbers), 3):
            frames.append((numbers[k], buffer[numbers[k + 1] : numbers[k + 2]]))
        runs: list[SampleRun] = []
        rows, first = sum(numbers[_COUNTED:at:3]), 0
        t_ns, values = room.t_ns[:rows].copy(), room.values[:rows].copy()  # once: a run is a part of them
        for k, source in enumerate(self._sources):
            place = _COUNTED + 3 * k
            if count := numbers[place]:
                last = first + count
                oldest_ns, newest_ns = numbers[place + 1], numbers[place + 2]
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


def next_frame(buffer: bytes, start: int) -> int:
    """The next place from ``start`` on with a whole frame, or one that is not complete; the end where there is none."""
    return start + _seek(np.frombuffer(buffer, np.uint8)[start:], _CRC, *_checksum_tables())


def _plan(sources: Sequence[MappedSource]) -> _Plan:
    number, factor = np.empty((len(sources), 8), np.int64), np.empty((len(sources), 6))
    for at, source in enumerate(sources):
        form = _FORM_OF[source.message]
        number[at] = source.message << 16 | source.component << 8, form, *source.order
        unit = np.ones(6) if form == _HIGHRES else INTEGER_SCALE
        sends = np.array([int(source.sends) >> axis & 1 for axis in range(6)])
        factor[at] = unit[source.order] * source.signs * sends
    return _Plan(_CRC, *_checksum_tables(), IMPLAUSIBLE_STAMP_US, number, factor)
