"""Finds MAVLink frames in bulk: header scan, CRC of every known message id, one byte forward on failure.

The scan exists twice: :mod:`companion.adapters.mavlink.bulk` is compiled, and the one here runs where that cannot be.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from fastcrc.crc16 import mcrf4xx

from companion.adapters.mavlink.bulk import Bulk, Run
from companion.adapters.mavlink.dialect import CRC_EXTRA

_MAGIC_1, _MAGIC_2 = 0xFE, 0xFD
_HEADER_1, _HEADER_2 = 6, 10
_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_SHORTEST_2 = _HEADER_2 + 2
_MAGIC = re.compile(rb"[\xfd\xfe]")
_LAST_BYTE: tuple[int, ...] = tuple(mcrf4xx(bytes([byte]), 0) for byte in range(256))
_EXTRA_OF = {identity.to_bytes(3, "little"): extra for identity, extra in CRC_EXTRA.items()}

Frame = tuple[int, bytes]
"""Sender and message id of a frame, see :func:`sender`, and its payload."""


def sender(key: int) -> tuple[int, int, int]:
    """System, component and message id of a frame's key."""
    return key & 0xFF, key >> 8 & 0xFF, key >> 16


@dataclass(slots=True)
class ScanCounters:
    """What one link's scanner has seen since it was made."""

    frames: int = 0
    crc_errors: int = 0
    unknown: int = 0
    skipped_bytes: int = 0


@dataclass(slots=True)
class Found:
    """What some bytes held: frames in arrival order, and apart from them what was read in bulk."""

    frames: list[Frame] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)


class Scanner:
    """The scanner of one link. A partial frame at the end of a chunk (less than 280 bytes) waits for the next one.

    A frame is a magic byte with a known message id, no incompatible flag but signing, and the right checksum. Where one
    of these fails, the scan goes one byte forward, so a frame behind a damaged or unknown one is never lost; an unknown
    id cannot be checked and is stepped over the same way. Signatures are skipped, not verified.

    Parameters
    ----------
    bulk
        The compiled scan, where there is one.
    """

    def __init__(self, bulk: Bulk | None = None) -> None:
        self.counters = ScanCounters()
        self._bulk = bulk
        self._tail = b""

    @property
    def pending_bytes(self) -> int:
        """Bytes of an unfinished frame that wait for the next chunk."""
        return len(self._tail)

    def forget(self) -> None:
        """Drop the bytes of an unfinished frame."""
        self._tail = b""

    def scan(self, data: bytes, system: int | None = None) -> Found:
        """Find the frames of the next bytes of this link; ``system`` is the one whose samples are read in bulk."""
        buffer = self._tail + data if self._tail else data
        found = Found()
        if self._bulk is None:
            position = self._walk(buffer, found.frames)
        else:
            position, counted, found.runs = self._bulk.scan(buffer, system, found.frames)
            own = self.counters
            own.frames += counted[0]
            own.crc_errors += counted[1]
            own.unknown += counted[2]
            own.skipped_bytes += counted[3]
        self._tail = buffer[position:]
        return found

    def _walk(self, buffer: bytes, frames: list[Frame]) -> int:
        """Append the frames; give the position of the first byte that has to wait."""
        extra_of, crc, last_byte, keep = _EXTRA_OF.get, mcrf4xx, _LAST_BYTE, frames.append
        number = int.from_bytes
        position, end, before = 0, len(buffer), len(frames)
        last_start = end - _SHORTEST_2
        while position < end:
            if position <= last_start and buffer[position] == _MAGIC_2 and not buffer[position + 2]:
                extra = extra_of(buffer[position + 7 : position + 10])
                stop = position + _HEADER_2 + buffer[position + 1]
                if extra is not None and stop + 2 <= end:
                    state = crc(buffer[position + 1 : stop])
                    if (state >> 8) ^ last_byte[(state & 255) ^ extra] == buffer[stop] | buffer[stop + 1] << 8:
                        keep((number(buffer[position + 5 : position + 10], "little"), buffer[position + 10 : stop]))
                        position = stop + 2
                        continue
            ahead = self._careful(buffer, position, end, frames)
            if ahead < 0:
                break
            position = ahead
        self.counters.frames += len(frames) - before
        return position

    def _careful(self, buffer: bytes, start: int, end: int, frames: list[Frame]) -> int:
        """Give the next position, or -1 where the candidate is not complete yet."""
        magic = buffer[start]
        if magic not in (_MAGIC_1, _MAGIC_2):
            found = _MAGIC.search(buffer, start)
            ahead = found.start() if found else end
            self.counters.skipped_bytes += ahead - start
            return ahead
        header = _HEADER_2 if magic == _MAGIC_2 else _HEADER_1
        if start + header > end:
            return -1
        flags = buffer[start + 2] if magic == _MAGIC_2 else 0
        if flags & ~_SIGNED:
            return self._step(start)
        key = buffer[start + 5 : start + 10] if magic == _MAGIC_2 else buffer[start + 3 : start + 6] + b"\0\0"
        extra = _EXTRA_OF.get(key[2:])
        if extra is None:
            self.counters.unknown += 1
            return self._step(start)
        stop = start + header + buffer[start + 1]
        after = stop + 2 + (_SIGNATURE_BYTES if flags else 0)
        if after > end:
            return -1
        state = mcrf4xx(buffer[start + 1 : stop])
        if (state >> 8) ^ _LAST_BYTE[(state & 255) ^ extra] != buffer[stop] | buffer[stop + 1] << 8:
            self.counters.crc_errors += 1
            return self._step(start)
        frames.append((int.from_bytes(key, "little"), buffer[start + header : stop]))
        return after

    def _step(self, start: int) -> int:
        self.counters.skipped_bytes += 1
        return start + 1
