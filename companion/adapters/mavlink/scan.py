"""Finds MAVLink frames in bulk: header scan, CRC of every known message id, one byte forward on failure.

Payloads are collected per sender and message id, so that inertial messages become arrays without a Python object each.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from fastcrc.crc16 import mcrf4xx

from companion.adapters.mavlink.dialect import CRC_EXTRA

_MAGIC_1, _MAGIC_2 = 0xFE, 0xFD
_HEADER_1, _HEADER_2 = 6, 10
_SIGNED = 0x01
_SIGNATURE_BYTES = 13
_SHORTEST_2 = _HEADER_2 + 2
_MAGIC = re.compile(rb"[\xfd\xfe]")
_LAST_BYTE: tuple[int, ...] = tuple(mcrf4xx(bytes([byte]), 0) for byte in range(256))
_MOST_ROUTES = 1024


@dataclass(slots=True)
class ScanCounters:
    """What one link's scanner has seen since it was made."""

    frames: int = 0
    crc_errors: int = 0
    unknown: int = 0
    skipped_bytes: int = 0


@dataclass(slots=True)
class Route:
    """Payloads of one message id from one sender, in arrival order, until the decoder takes them."""

    system: int
    component: int
    message: int
    crc_extra: int
    payloads: list[bytes] = field(default_factory=list)


Collect = Callable[[Route], Callable[[bytes], None]]


class Scanner:
    """The scanner of one link. A partial frame at the end of a chunk (less than 280 bytes) waits for the next one.

    A frame is a magic byte with a known message id, no incompatible flag but signing, and the right checksum. Where one
    of these fails, the scan goes one byte forward, so a frame behind a damaged or unknown one is never lost; an unknown
    id cannot be checked and is stepped over the same way. Signatures are skipped, not verified.

    Parameters
    ----------
    collect
        Called once for every new sender and message id; returns what is to be done with each payload.
    """

    def __init__(self, collect: Collect) -> None:
        self.counters = ScanCounters()
        self.routes: dict[bytes, Route] = {}
        self._collect = collect
        self._fast: dict[bytes, tuple[int, Callable[[bytes], None]]] = {}
        self._tail = b""

    @property
    def pending_bytes(self) -> int:
        """Bytes of an unfinished frame that wait for the next chunk."""
        return len(self._tail)

    def scan(self, data: bytes) -> None:
        """Find the frames of the next bytes of this link and hand each payload to its collector."""
        buffer = self._tail + data if self._tail else data
        fast, crc, last_byte = self._fast.get, mcrf4xx, _LAST_BYTE
        position, end, frames = 0, len(buffer), 0
        last_start = end - _SHORTEST_2
        while position < end:
            if position <= last_start and buffer[position] == _MAGIC_2 and not buffer[position + 2]:
                known = fast(buffer[position + 5 : position + 10])
                stop = position + _HEADER_2 + buffer[position + 1]
                if known is not None and stop + 2 <= end:
                    extra, collect = known
                    state = crc(buffer[position + 1 : stop])
                    if (state >> 8) ^ last_byte[(state & 255) ^ extra] == buffer[stop] | buffer[stop + 1] << 8:
                        collect(buffer[position + _HEADER_2 : stop])
                        position = stop + 2
                        frames += 1
                        continue
            ahead = self._careful(buffer, position, end)
            if ahead < 0:
                break
            position = ahead
        self.counters.frames += frames
        self._tail = buffer[position:]

    def _careful(self, buffer: bytes, start: int, end: int) -> int:
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
        extra = CRC_EXTRA.get(int.from_bytes(key[2:], "little"))
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
        self.counters.frames += 1
        self._route(key, extra)(buffer[start + header : stop])
        return after

    def _step(self, start: int) -> int:
        self.counters.skipped_bytes += 1
        return start + 1

    def _route(self, key: bytes, extra: int) -> Callable[[bytes], None]:
        known = self._fast.get(key)
        if known is None:
            if len(self._fast) >= _MOST_ROUTES:
                self._forget_idle()
            route = Route(key[0], key[1], int.from_bytes(key[2:], "little"), extra)
            known = self._fast[key] = (extra, self._collect(route))
            self.routes[key] = route
        return known[1]

    def _forget_idle(self) -> None:
        """Bound the memory that a flood of invented senders can take."""
        for key in [key for key, route in self.routes.items() if not route.payloads]:
            del self.routes[key], self._fast[key]
