"""Datagrams that wait in a socket: all by one call, with sender and form of each (``native/datagrams.c``)."""

from __future__ import annotations

import os
import socket
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from companion.native.library import ARRAY, INTEGER, kernel

OTHER, FRAMES, GUARDED_FRAMES = range(3)
"""Form of a datagram: anything; whole frames by their headers; the same, and one of them with a guarded id."""
_SLOT_BYTES = 65536  # room for the largest datagram of UDP (convention)
_MOST_AT_ONCE = 32  # by one system call, chosen: more save nothing
_MOST_ROWS = 256  # of a read, about; bound of memory
_MOST_BYTES = 1 << 20  # of a read, about; bound of memory
_MANY_ADDRESSES = 64  # bound of memory against invented senders
_COLUMNS = 4  # sender, start, stop, form (by definition)
_FAILED = -1000  # convention with the kernel: less the system's number of the error
_NO_SYSTEM = -1  # convention: no system id is negative

_SHORTEST_FRAME = 8  # bytes of a MAVLink 1 frame without payload

_read = kernel("datagrams_read", INTEGER, INTEGER, ARRAY, ARRAY, ARRAY, INTEGER, ARRAY, ARRAY)
_guarded = kernel("datagram_guarded", ARRAY, ARRAY, INTEGER, ARRAY)


class Datagrams(NamedTuple):
    """Consecutive datagrams of one sender as one, where all have the form ``FRAMES``; else a single one."""

    address: tuple[str, int]
    data: bytes
    form: int


class DatagramReader:
    """Reads a datagram socket without waiting.

    ``drained`` is whether the last read left nothing behind, as far as it can tell.
    """

    def __init__(self, reader: socket.socket) -> None:
        self.drained = False
        self._socket = reader
        self._slots = np.empty(_MOST_AT_ONCE * _SLOT_BYTES, np.uint8)
        self._buffer = np.empty(_MOST_BYTES + len(self._slots), np.uint8)
        self._bytes = self._buffer.data
        self._table = np.empty((_MOST_ROWS + _MOST_AT_ONCE, _COLUMNS), np.int64)
        self._state = np.array([_SLOT_BYTES, 0])  # largest datagram read last, and whether none was left
        self._addresses: dict[int, tuple[str, int]] = {}
        self._guarded: Collection[int] = ()
        self._guards = np.zeros(256, np.bool_)

    def read(self, limit: int, guarded: Collection[int], system: int | None) -> list[Datagrams]:
        """Read what has come, about ``limit`` bytes at most; guarded are these components of a system, or of all.

        Raises
        ------
        OSError
            As the socket's own ``recv`` does, but for an empty socket.
        """
        if guarded is not self._guarded:
            self._guarded = guarded
            self._guards[:] = False
            self._guards[list(guarded)] = True
        number, limit = _NO_SYSTEM if system is None else system, min(limit, _MOST_BYTES)
        count = _read(
            self._socket.fileno(), limit, self._buffer, self._slots, self._guards, number, self._table, self._state
        )
        if count <= _FAILED:
            raise OSError(_FAILED - count, os.strerror(_FAILED - count))
        self.drained = bool(self._state[1])
        rows = self._table[:count].tolist()
        return [Datagrams(self._address(row[0]), bytes(self._bytes[row[1] : row[2]]), row[3]) for row in rows]

    def guarded_frames(self, data: bytes, system: int | None) -> Iterator[tuple[tuple[int, int], bytes]]:
        """System and component, and bytes, of each guarded frame in data of the form ``GUARDED_FRAMES`` just read."""
        table = np.empty((len(data) // _SHORTEST_FRAME, 4), np.int64)
        count = _guarded(np.frombuffer(data, np.uint8), self._guards, _NO_SYSTEM if system is None else system, table)
        for start, stop, of_system, component in table[:count].tolist():
            yield (of_system, component), data[start:stop]

    def _address(self, sender: int) -> tuple[str, int]:
        """Sender as Python's socket spells it."""
        address = self._addresses.get(sender)
        if address is None:
            if len(self._addresses) >= _MANY_ADDRESSES:
                self._addresses.clear()
            address = self._addresses[sender] = (socket.inet_ntoa((sender >> 16).to_bytes(4)), sender & 0xFFFF)
        return address
