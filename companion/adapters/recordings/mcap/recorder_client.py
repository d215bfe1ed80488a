"""Client of the recorder process: the producer never waits; what does not fit is dropped and counted.

A thread sends what has gathered every 20 ms as one pickled batch, cut into packets that keep their borders, so that a
recorder that is started again finds the next whole batch.
"""

from __future__ import annotations

import pickle
import socket
import struct
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

from companion.adapters.recordings.mcap.channels import Recordable
from companion.records import Frame, FramePair, ImuBatch, MatchSet, RawChunk

_PERIOD_S = 0.02  # chosen: fifty batches a second: few system calls, little lost in a crash
_PACKET_BYTES = 65_536  # chosen: well below a socket's buffer, so that a packet fits in
_PACKET_HEADER = struct.Struct("<II")
_SEND_TIMEOUT_S = 1.0  # chosen: a disk that stalls for longer is asked again, and the end not held up
_SMALL_BYTES = 400  # chosen: about what a record costs beside its arrays, for the bound of memory


@dataclass(frozen=True, slots=True)
class Batch:
    """Unit of transfer: records in order, how many more were dropped before them, and whether the producer ended."""

    records: list[Recordable]
    dropped: int
    last: bool


def recorder_channel() -> tuple[socket.socket, socket.socket]:
    """Socket pair to the recorder process: the end of :class:`RecorderClient`, and of :class:`RecorderReceiver`."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


class RecorderClient:
    """The recorder port in a producing process; to be used from one thread.

    ``end`` is the producer's end of :func:`recorder_channel`; while the disk is slow, at most ``capacity_bytes`` wait
    here. A ``successor`` takes the place of a process that died: what that one had not sent is missing, and counts as
    one dropped record.
    """

    def __init__(self, end: socket.socket, capacity_bytes: int = 64 << 20, *, successor: bool = False) -> None:
        self._end = end
        self._end.settimeout(_SEND_TIMEOUT_S)
        self._capacity_bytes = capacity_bytes
        self._waiting: deque[tuple[Recordable, int]] = deque()
        self._queued_bytes = 0  # changed by the caller's thread alone
        self._sent_bytes = 0  # changed by the sending thread alone
        self._refused = 0  # likewise the caller's
        self._lost = int(successor)  # likewise the sender's
        self._reported_drops = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._send_all, name="recorder-client", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Records that will never be in the file."""
        return self._refused + self._lost

    def write(self, record: Recordable) -> None:
        """Append one record, or drop and count it when too much is waiting; never blocks."""
        size = _size(record)
        if self._closing.is_set() or self._queued_bytes - self._sent_bytes + size > self._capacity_bytes:
            self._refused += 1
            return
        self._queued_bytes += size
        self._waiting.append((record, size))

    def close(self) -> None:
        """Send what waits and end this producer's part; gives up when the recorder takes nothing for 1 s."""
        self._closing.set()
        self._thread.join()
        self._end.close()

    def _send_all(self) -> None:
        while not self._closing.wait(_PERIOD_S):
            self._send_waiting(last=False)
        self._send_waiting(last=True)

    def _send_waiting(self, last: bool) -> None:
        dropped = self.dropped
        taken = [self._waiting.popleft() for _ in range(len(self._waiting))]
        if not taken and not last and dropped == self._reported_drops:
            return
        batch = Batch([record for record, _ in taken], dropped - self._reported_drops, last)
        if self._send(pickle.dumps(batch, protocol=pickle.HIGHEST_PROTOCOL)):
            self._reported_drops = dropped
        else:
            self._lost += len(taken)
        self._sent_bytes += sum(size for _, size in taken)

    def _send(self, data: bytes) -> bool:
        """Send one batch whole; wait for a slow recorder, give up on a dead one, or on a stuck one when closing."""
        count = -(-len(data) // _PACKET_BYTES)
        for index in range(count):
            packet = _PACKET_HEADER.pack(index, count) + data[index * _PACKET_BYTES : (index + 1) * _PACKET_BYTES]
            while True:
                try:
                    self._end.send(packet)
                    break
                except TimeoutError:
                    if self._closing.is_set():
                        return False
                except OSError:
                    return False
        return True


class RecorderReceiver:
    """The recorder's end: puts packets together to batches."""

    def __init__(self, end: socket.socket) -> None:
        self.end = end
        self._parts: list[bytes] = []

    def fileno(self) -> int:
        """For ``select``."""
        return self.end.fileno()

    def receive(self) -> Batch | None:
        """Take one packet; give the batch that it completes, or an empty last one when the producer is gone."""
        packet = self.end.recv(_PACKET_HEADER.size + _PACKET_BYTES)
        if not packet:
            return Batch([], 0, last=True)
        index, count = _PACKET_HEADER.unpack_from(packet)
        if index == 0:
            self._parts = []
        elif index != len(self._parts):
            return None  # the rest of a batch whose beginning another recorder took
        self._parts.append(packet[_PACKET_HEADER.size :])
        if len(self._parts) < count:
            return None
        batch: Any = pickle.loads(b"".join(self._parts))
        self._parts = []
        return batch if isinstance(batch, Batch) else None


def _size(record: Recordable) -> int:
    if isinstance(record, RawChunk):
        return _SMALL_BYTES + len(record.data)
    if isinstance(record, ImuBatch):
        return _SMALL_BYTES + record.values.nbytes + record.t_ns.nbytes
    if isinstance(record, MatchSet):
        return _SMALL_BYTES + 5 * record.sigma_px.nbytes
    if isinstance(record, Frame):
        return _SMALL_BYTES + record.image.nbytes
    if isinstance(record, FramePair):
        return _size(record.left) + _size(record.right)
    return _SMALL_BYTES
