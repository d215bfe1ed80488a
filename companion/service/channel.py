"""One-way record channels between processes: whole messages, bounded, never blocking, no shared locks.

A sequenced-packet socket pair keeps message borders, so a process that is killed in the middle of a send leaves
neither half a message nor a held lock; the supervisor keeps both ends and hands them to the restarted process.
"""

from __future__ import annotations

import pickle
import socket
from dataclasses import dataclass
from typing import Any

_BUFFER_BYTES = 4 << 20  # chosen: some images' worth of matches, so that a busy reader loses none
_LARGEST_MESSAGE = 1 << 20  # chosen: bytes: room for the longest record, below the socket's buffer


@dataclass(slots=True)
class Sender:
    """The writing end; a message that finds no room is dropped, and one that is too large."""

    end: socket.socket

    def send(self, record: Any) -> bool:
        """Queue one record; False when it was dropped: the reader is too slow, or the record larger than 1 MiB."""
        message = pickle.dumps(record, protocol=pickle.HIGHEST_PROTOCOL)
        if len(message) > _LARGEST_MESSAGE:
            return False
        try:
            self.end.send(message)
        except OSError:
            return False
        return True


@dataclass(slots=True)
class Receiver:
    """The reading end."""

    end: socket.socket

    def fileno(self) -> int:
        """For ``select``."""
        return self.end.fileno()

    def receive(self, limit: int = 256) -> list[Any]:
        """Everything that waits, oldest first, at most ``limit`` records."""
        records: list[Any] = []
        while len(records) < limit:
            try:
                message, _, flags, _ = self.end.recvmsg(_LARGEST_MESSAGE)
            except OSError:
                break
            if not message:
                break
            if not flags & socket.MSG_TRUNC:  # else its end is lost
                records.append(pickle.loads(message))
        return records


def channel() -> tuple[Sender, Receiver]:
    """A new channel; both ends may be passed to other processes."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            end.setsockopt(socket.SOL_SOCKET, option, _BUFFER_BYTES)
    return Sender(ends[0]), Receiver(ends[1])
