"""MAVLink FTP, read only, for a few files in memory: list, open, read, burst, checksum.

Requests of one client carry rising sequence numbers; one that comes again, because our answer was lost, gets the same
answer again. Bursts are paced, and the newest one of a client replaces the older, so that nobody can make us send much.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.dialect import mavlink
from companion.params.metadata import mavlink_crc32
from companion.rate_limiter import RateLimiter

_HEAD = struct.Struct("<HBBBBBBI")
_DATA_BYTES = 239  # payload less the FTP header (MAVLink FTP protocol)
_PAYLOAD_BYTES = 251  # payload of FILE_TRANSFER_PROTOCOL (MAVLink common.xml)
_PACE_NS = 10_000_000  # chosen: 24 kB/s at most, a quarter of a 921,600 baud line
_MOST_CLIENTS = 4  # bound of memory: more ground stations than a vehicle has
_MOST_WAITING = 16  # bound of memory
_BURST_PACKETS = 40  # a burst of 9.6 kB: 0.4 s at our pace, then the client asks on (choice)

# opcodes (MAVLink FTP protocol)
_NONE, _TERMINATE, _RESET, _LIST, _OPEN, _READ, _CRC, _BURST = 0, 1, 2, 3, 4, 5, 14, 15
_WRITES = frozenset(range(6, 14))  # opcodes that would change a file (MAVLink FTP protocol)
_ACK, _NAK = 128, 129  # opcodes of answers (MAVLink FTP protocol)
# error codes (MAVLink FTP protocol)
_NO_SESSION, _END_OF_FILE, _UNKNOWN_COMMAND, _PROTECTED, _NO_SUCH_FILE = 4, 6, 7, 9, 10


@dataclass(slots=True)
class _Request:
    sequence: int
    session: int
    opcode: int
    size: int
    offset: int
    data: bytes


@dataclass(slots=True)
class _Client:
    path: str = ""
    request: _Request | None = None
    answer: bytes = b""
    burst_at: int = -1
    burst_sequence: int = 0
    burst_session: int = 0
    burst_packets: int = 0
    burst_size: int = _DATA_BYTES


class FileServer:
    """Serves ``files`` (path to content) to whoever asks our component."""

    def __init__(self, files: Mapping[str, bytes], component: int) -> None:
        self._files = dict(files)
        self._component = component
        self._clients: dict[tuple[int, int], _Client] = {}
        self._waiting: deque[tuple[tuple[int, int], bytes]] = deque(maxlen=_MOST_WAITING)
        self._pace = RateLimiter(_PACE_NS)

    def hear(self, heard: Heard, system: int) -> None:
        """Take in a FILE_TRANSFER_PROTOCOL message; ``system`` is our own system id."""
        message = heard.message
        if message.target_system not in (0, system) or message.target_component != self._component:
            return
        request = _parse(bytes(message.payload))
        if request is None:
            return
        sender = (heard.system, heard.component)
        client = self._client(sender)
        if request != client.request or not client.answer:  # a station that starts again may begin with any number
            client.request = request
            client.answer = self._answer(client, request)
        if client.answer:
            self._waiting.append((sender, client.answer))

    def due(self, now_host_ns: int) -> Any | None:
        """The next message to send, if it is time for one."""
        if not self._pace.ready(now_host_ns):
            return None
        addressed = self._waiting.popleft() if self._waiting else self._next_burst()
        if addressed is None:
            return None
        self._pace.take(now_host_ns)
        (system, component), payload = addressed
        filled = list(payload.ljust(_PAYLOAD_BYTES, b"\0"))
        return mavlink.MAVLink_file_transfer_protocol_message(0, system, component, filled)

    def _client(self, sender: tuple[int, int]) -> _Client:
        client = self._clients.pop(sender, None) or _Client()
        while len(self._clients) >= _MOST_CLIENTS:
            del self._clients[next(iter(self._clients))]
        self._clients[sender] = client
        return client

    # ------------------------------------------------------------------------------------------ answers

    def _answer(self, client: _Client, request: _Request) -> bytes:
        opcode = request.opcode
        if opcode != _READ:  # a client may fill gaps while its burst goes on
            client.burst_at = -1
        if opcode in (_NONE, _TERMINATE, _RESET):
            if opcode != _NONE:
                client.path = ""
            return _ack(request, b"")
        if opcode == _LIST:
            return self._list(request)
        if opcode in (_OPEN, _CRC):
            return self._open(client, request)
        if opcode in (_READ, _BURST):
            return self._read(client, request)
        return _nak(request, _PROTECTED if opcode in _WRITES else _UNKNOWN_COMMAND)

    def _list(self, request: _Request) -> bytes:
        if _path(request) != "/":
            return _nak(request, _NO_SUCH_FILE)
        entries = [f"F{path[1:]}\t{len(content)}".encode() + b"\0" for path, content in sorted(self._files.items())]
        if request.offset >= len(entries):
            return _nak(request, _END_OF_FILE)
        data = b""
        for entry in entries[request.offset :]:
            if len(data) + len(entry) > _DATA_BYTES:
                break
            data += entry
        return _ack(request, data)

    def _open(self, client: _Client, request: _Request) -> bytes:
        path = _path(request)
        content = self._files.get(path)
        if content is None:
            return _nak(request, _NO_SUCH_FILE)
        if request.opcode == _CRC:
            return _ack(request, struct.pack("<I", mavlink_crc32(content)))
        client.path = path
        return _ack(request, struct.pack("<I", len(content)))

    def _read(self, client: _Client, request: _Request) -> bytes:
        content = self._files.get(client.path)
        if content is None:
            return _nak(request, _NO_SESSION)
        if request.offset >= len(content):
            return _nak(request, _END_OF_FILE)
        size = min(request.size or _DATA_BYTES, _DATA_BYTES)
        if request.opcode == _READ:
            return _ack(request, content[request.offset : request.offset + size], request.offset)
        client.burst_at, client.burst_packets, client.burst_size = request.offset, _BURST_PACKETS, size
        client.burst_sequence, client.burst_session = request.sequence, request.session
        return b""

    def _next_burst(self) -> tuple[tuple[int, int], bytes] | None:
        for sender, client in self._clients.items():
            content = self._files.get(client.path, b"")
            if client.burst_at < 0:
                continue
            data = content[client.burst_at : client.burst_at + client.burst_size]
            request = _Request(client.burst_sequence, client.burst_session, _BURST, 0, client.burst_at, b"")
            client.burst_sequence = (client.burst_sequence + 1) & 0xFFFF
            client.burst_packets -= 1
            ended = client.burst_at + len(data) >= len(content) or client.burst_packets == 0
            client.burst_at = -1 if ended else client.burst_at + len(data)
            return sender, _ack(request, data, request.offset, complete=ended)
        return None


def _parse(payload: bytes) -> _Request | None:
    if len(payload) < _HEAD.size:
        return None
    sequence, session, opcode, size, _, _, _, offset = _HEAD.unpack_from(payload)
    if size > _DATA_BYTES:
        return None
    return _Request(sequence, session, opcode, size, offset, payload[_HEAD.size : _HEAD.size + size])


def _path(request: _Request) -> str:
    name = request.data.split(b"\0", 1)[0].decode("utf-8", errors="replace")
    return "/" + name.strip("/")


def _ack(request: _Request, data: bytes, offset: int = 0, *, complete: bool = False) -> bytes:
    sequence = (request.sequence + 1) & 0xFFFF
    return _HEAD.pack(sequence, request.session, _ACK, len(data), request.opcode, complete, 0, offset) + data


def _nak(request: _Request, error: int) -> bytes:
    sequence = (request.sequence + 1) & 0xFFFF
    return _HEAD.pack(sequence, request.session, _NAK, 1, request.opcode, 0, 0, request.offset) + bytes((error,))
