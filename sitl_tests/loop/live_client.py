"""A client of the Foxglove websocket protocol on a plain socket: handshake, text and binary frames."""

from __future__ import annotations

import base64
import http.client
import json
import os
import socket
import struct
from typing import Any

TEXT, BINARY = 1, 2


class Refused(Exception):
    """The handshake was answered by something else than 101."""


class LiveClient:
    """One connection. ``topics`` is filled by the advertisement."""

    def __init__(self, port: int, name: str = "foxglove.sdk.v1", path: str = "/", **headers: str) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=20)
        lines = {
            "Host": f"127.0.0.1:{port}", "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": base64.b64encode(os.urandom(16)).decode(), "Sec-WebSocket-Protocol": name,
        } | headers  # fmt: skip
        head = "".join(f"{key}: {value}\r\n" for key, value in lines.items())
        self._socket.sendall(f"GET {path} HTTP/1.1\r\n{head}\r\n".encode())
        self._buffer = b""
        while b"\r\n\r\n" not in self._buffer:
            self._more()
        self.answer, _, self._buffer = self._buffer.partition(b"\r\n\r\n")
        if b" 101 " not in self.answer.splitlines()[0]:
            self._socket.close()
            raise Refused(self.answer.decode())
        self.topics: dict[str, int] = {}
        while not self.topics:
            message = self.hear()
            if isinstance(message, dict) and message["op"] == "advertise":
                self.channels = {channel["topic"]: channel for channel in message["channels"]}
                self.topics = {topic: channel["id"] for topic, channel in self.channels.items()}

    def subscribe(self, *topics: str) -> None:
        wanted = [{"id": self.topics[topic], "channelId": self.topics[topic]} for topic in topics]
        self.say({"op": "subscribe", "subscriptions": wanted})

    def say(self, message: Any) -> None:
        data, mask = json.dumps(message).encode(), os.urandom(4)
        size = struct.pack("!B", 0x80 | len(data)) if len(data) < 126 else struct.pack("!BH", 0x80 | 126, len(data))
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(data))
        self._socket.sendall(bytes([0x80 | TEXT]) + size + mask + masked)

    def hear(self) -> dict[str, Any] | tuple[str, int, bytes]:
        """The next message: JSON, or topic, log time and bytes."""
        data, kind = b"", 0
        while True:
            first, second = self._take(2)
            length = second & 0x7F
            if length == 126:
                (length,) = struct.unpack("!H", self._take(2))
            elif length == 127:
                (length,) = struct.unpack("!Q", self._take(8))
            kind = first & 0x0F or kind
            data += self._take(length)
            if first & 0x80 and kind == TEXT:
                content: dict[str, Any] = json.loads(data)
                return content
            if first & 0x80 and kind == BINARY:
                _, channel, log_ns = struct.unpack_from("<BIQ", data)
                return {number: topic for topic, number in self.topics.items()}[channel], log_ns, data[13:]
            if first & 0x80:
                data, kind = b"", 0

    def close(self) -> None:
        self._socket.close()

    def break_off(self) -> None:
        """Close as a browser that is ended does: without a word of the protocol, with bytes still unread."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()

    def _take(self, count: int) -> bytes:
        while len(self._buffer) < count:
            self._more()
        taken, self._buffer = self._buffer[:count], self._buffer[count:]
        return taken

    def _more(self) -> None:
        piece = self._socket.recv(1 << 16)
        if not piece:
            raise ConnectionError("the live view hung up")
        self._buffer += piece


def last_words(client: LiveClient) -> list[str]:
    """Sentences of the status messages that say that it has ended, until the server hangs up."""
    said = []
    try:
        while True:
            message = client.hear()
            if isinstance(message, dict) and message["op"] == "status" and message["id"] == "ended":
                said.append(str(message["message"]))
    except ConnectionError:
        return said


def ask(port: int, method: str, path: str, content: Any = None, **headers: str) -> tuple[int, dict[str, str], bytes]:
    """One request of HTTP: status, headers, body."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    body = None if content is None else json.dumps(content)
    kind = {} if content is None else {"Content-Type": "application/json"}
    connection.request(method, path, body, kind | headers)
    answer = connection.getresponse()
    read = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), read
