"""UDP, listening (``udpin``) or calling (``udpout``)."""

from __future__ import annotations

import contextlib
import errno
import socket

from companion.errors import LinkError

_RECEIVE_BUFFER_BYTES = 1 << 20
_LARGEST_DATAGRAM = 65536
_MOST_PEERS = 16
_MOST_DATAGRAMS = 4096


class _Udp:
    """A non-blocking datagram socket whose datagrams are drained into one buffer."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        self._socket.setblocking(False)
        self._buffer = memoryview(bytearray(2 * _LARGEST_DATAGRAM))

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()

    def _send_to(self, data: bytes, address: tuple[str, int]) -> bool:
        try:
            return self._socket.sendto(data, address) == len(data)
        except OSError:  # full buffer, unreachable network, peer gone: a datagram is never waited for
            return False


class UdpIn(_Udp):
    """Listens on a port and learns its peers from what they send; what is written goes to all of them.

    Autopilot and wing nodes may come from different ports. At most 16 peers are kept; the one
    silent longest leaves first.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._peers: dict[tuple[str, int], None] = {}
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self.close()
            raise LinkError(_bind_advice(host, port, error)) from error

    @property
    def port(self) -> int:
        """The port that is listened on (chosen by the system where 0 was asked)."""
        return int(self._socket.getsockname()[1])

    @property
    def peers(self) -> list[tuple[str, int]]:
        """Known peers, the one heard last at the end."""
        return list(self._peers)

    def receive(self, limit: int, now_host_ns: int) -> bytes:  # noqa: ARG002 (part of the protocol)
        """Drain the socket."""
        buffer, filled, receive = self._buffer, 0, self._socket.recvfrom_into
        heard: dict[tuple[str, int], None] = {}
        with contextlib.suppress(BlockingIOError):
            for _ in range(_MOST_DATAGRAMS):
                try:
                    count, peer = receive(buffer[filled:])
                except ConnectionError:  # an earlier datagram of ours was refused; says nothing of this one
                    continue
                filled += count
                heard[peer] = None
                if filled >= limit:
                    break
        for peer in heard:
            self._peers.pop(peer, None)
            self._peers[peer] = None
        while len(self._peers) > _MOST_PEERS:
            del self._peers[next(iter(self._peers))]
        return bytes(buffer[:filled])

    def send(self, data: bytes) -> bool:
        """Send to every known peer; true where one took it."""
        taken = [self._send_to(data, peer) for peer in self._peers]
        return any(taken)


class UdpOut(_Udp):
    """Calls one address; answers from anywhere are read, for routers answer from other ports."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        try:
            self._address = (socket.gethostbyname(host), port)
        except OSError as error:
            self.close()
            raise LinkError(
                f"udpout:{host}:{port}: host '{host}' is not known; check the name or use its IP"
            ) from error

    def receive(self, limit: int, now_host_ns: int) -> bytes:  # noqa: ARG002 (part of the protocol)
        """Drain the socket."""
        buffer, filled, receive = self._buffer, 0, self._socket.recv_into
        with contextlib.suppress(BlockingIOError):
            for _ in range(_MOST_DATAGRAMS):
                try:
                    filled += receive(buffer[filled:])
                except ConnectionError:  # nobody listens there yet
                    continue
                if filled >= limit:
                    break
        return bytes(buffer[:filled])

    def send(self, data: bytes) -> bool:
        """Send to the address."""
        return self._send_to(data, self._address)


def _bind_advice(host: str, port: int, error: OSError) -> str:
    where = f"udpin:{host}:{port}"
    if error.errno == errno.EADDRINUSE:
        return f"{where}: the port is taken; stop the other program (MAVProxy, mavlink-router, a second spanwise?)"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{where}: this computer has no address {host}; use 0.0.0.0 to listen on all"
    if error.errno == errno.EACCES:
        return f"{where}: ports below 1024 need privileges; use 14550"
    return f"{where}: {error.strerror or error}"
