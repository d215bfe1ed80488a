"""UDP, listening (``udpin``) or calling (``udpout``)."""

from __future__ import annotations

import contextlib
import errno
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass

from companion.adapters.mavlink.link.datagrams import FRAMES, GUARDED_FRAMES, DatagramReader
from companion.adapters.mavlink.link.dialect import mavlink
from companion.adapters.mavlink.link.host import HostAddress
from companion.adapters.mavlink.link.reconnect import Backoff
from companion.adapters.mavlink.link.scan import MAGIC_2, sender_of, split_frames
from companion.adapters.mavlink.vehicle.senders import Senders
from companion.errors import LinkError

_RECEIVE_BUFFER_BYTES = 1 << 20  # chosen: seconds of inertial frames, so that a pause of the reader loses none
_LARGEST_DATAGRAM = 65536  # bytes, of UDP (by definition)
_MOST_PEERS = 16  # bound of memory
_SILENT_NS = 8_000_000_000  # chosen: autopilots beat every second; some beats are lost
_MOST_DATAGRAMS = 4096  # bound of the time of one read
_MOST_READS = 64  # of 64 system calls each at most; the same bound where many are read at once


def buffer_shortfall() -> tuple[int, int] | None:
    """Bytes that may wait in a UDP socket, and those that we ask for; None where all are granted.

    Linux cuts at ``net.core.rmem_max`` and does not say so.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        granted = trial.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    granted //= 2 if sys.platform == "linux" else 1  # Linux tells twice what it grants (socket(7))
    return (granted, _RECEIVE_BUFFER_BYTES) if granted < _RECEIVE_BUFFER_BYTES else None


class _Udp:
    """A non-blocking datagram socket."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()

    def _send_to(self, data: bytes, address: tuple[str, int]) -> bool:
        try:
            return self._socket.sendto(data, address) == len(data)
        except OSError:  # full buffer, unreachable network, peer gone: a datagram is never waited for
            return False


@dataclass(slots=True)
class _Peer:
    """A sender: its system (0 for a ground station), when it was heard, and the bytes of a frame that is not whole."""

    system: int
    heard_host_ns: int
    tail: bytes = b""


class UdpIn(_Udp):
    """Listens on a port and learns its peers from what they send; what is written goes to all of them.

    Autopilot and wing nodes may come from different ports. A peer is who sent a whole frame of the vehicle's system,
    with a right checksum and, where ``judge`` is set, accepted by it; or a ground station's heartbeat. At most 16 peers
    are kept; the one silent longest leaves first, but none that has a guarded id. Frames are put together for each
    sender apart, and a guarded id is one sender's (:class:`Senders`).

    ``judge`` decides whether a frame may come in; with it all else stays out. What it lets in and the guard admits is
    shown to ``accept``: a route's copy that the guard refuses must not make the original an old frame.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self.judge: Callable[[bytes], bool] | None = None
        self.accept: Callable[[bytes], None] | None = None
        self.senders = Senders()
        self._peers: dict[tuple[str, int], _Peer] = {}
        self._strangers: dict[tuple[str, int], bytes] = {}
        self._reader = DatagramReader(self._socket)
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
        return sorted(self._peers, key=lambda address: self._peers[address].heard_host_ns)

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        """Drain the socket."""
        filled, reader, senders = 0, self._reader, self.senders
        came: list[bytes] = []
        for _ in range(_MOST_READS):
            try:
                read = reader.read(limit - filled, senders.guarded, senders.system)
            except ConnectionError:  # an earlier datagram of ours was refused; says nothing of this one
                continue
            for address, data, form in read:
                filled += len(data)
                came.append(self._sifted(address, data, form, now_host_ns))
            if reader.drained or filled >= limit:
                break
        return b"".join(came)

    def send(self, data: bytes) -> bool:
        """Send to every known peer; true where one took it."""
        taken = [self._send_to(data, address) for address, peer in self._peers.items() if self._counts(peer.system)]
        return any(taken)

    def _counts(self, system: int) -> bool:
        """Whether a sender of this system is one to be told anything."""
        return system == 0 or self.senders.system in (None, system)

    def _sifted(self, address: tuple[str, int], data: bytes, form: int, now_host_ns: int) -> bytes:
        """Admitted bytes of a datagram, or of several of the form ``FRAMES``."""
        peer = self._peers.get(address)
        usual = peer is not None and not peer.tail and self._counts(peer.system) and self.judge is None
        plain = form == FRAMES or (form == GUARDED_FRAMES and usual and self._has_all(address, data, now_host_ns))
        if peer is not None and usual and plain:
            peer.heard_host_ns = now_host_ns
            return data
        tail = self._strangers.pop(address, b"") if peer is None else peer.tail
        came, tail = self._frame_by_frame(address, tail + data, now_host_ns)
        peer = self._peers.get(address)
        if peer is not None:
            peer.tail = tail
        elif tail:
            self._strangers[address] = tail
            while len(self._strangers) > _MOST_PEERS:
                del self._strangers[next(iter(self._strangers))]
        return came

    def _has_all(self, address: tuple[str, int], data: bytes, now_host_ns: int) -> bool:
        """Whether whole frames have no guarded id but the sender's own."""
        guarded = self._reader.guarded_frames(data, self.senders.system)
        return all(self.senders.has(address, key, frame, now_host_ns) for key, frame in guarded)

    def _frame_by_frame(self, address: tuple[str, int], data: bytes, now_host_ns: int) -> tuple[bytes, bytes]:
        """Admitted frames of some bytes, and the bytes that wait for more."""
        pieces, tail = split_frames(data)
        came = [
            piece
            for piece, is_frame in pieces  # damage is counted where frames are read
            if (self._admits(address, piece, now_host_ns) if is_frame else self.judge is None)
        ]
        return b"".join(came), tail

    def _admits(self, address: tuple[str, int], frame: bytes, now_host_ns: int) -> bool:
        key = sender_of(frame)[:2]
        is_guarded = self.senders.guards(key)
        if self.judge is not None:
            if is_guarded and self.senders.refuse_copy(address, key, frame):
                return False
            if not self.judge(frame):
                return False
        if is_guarded and not self.senders.admit(address, key, frame, now_host_ns):
            return False
        if self.accept is not None:
            self.accept(frame)
        system = 0 if _is_station(frame) else key[0]
        peer = self._peers.get(address)
        if peer is not None:
            peer.heard_host_ns = now_host_ns
            peer.system = peer.system if self._counts(peer.system) else system
        elif self._counts(system):
            self._learn(address, _Peer(system, now_host_ns))
        return True

    def _learn(self, address: tuple[str, int], newcomer: _Peer) -> None:
        if len(self._peers) >= _MOST_PEERS:
            free = [peer for peer in self._peers if not self.senders.holds_any(peer)]
            if not free:
                return
            del self._peers[min(free, key=lambda peer: self._peers[peer].heard_host_ns)]
        self._peers[address] = newcomer


def _is_station(frame: bytes) -> bool:
    """Whether a frame is a ground station's heartbeat; zeros at a payload's end are not sent."""
    kind = 14 if frame[0] == MAGIC_2 else 10  # after custom_mode, 4 bytes
    is_heartbeat = sender_of(frame)[2] == mavlink.MAVLINK_MSG_ID_HEARTBEAT
    return bool(is_heartbeat and frame[1] > 4 and frame[kind] == mavlink.MAV_TYPE_GCS)


class UdpOut(_Udp):
    """Calls one address; answers from anywhere are read, for routers answer from other ports.

    With ``may_be_down`` a name that nobody knows yet is asked for again in growing pauses, and so is the name of a host
    that has become silent: it may have another address by now.
    """

    def __init__(self, host: str, port: int, *, may_be_down: bool = False) -> None:
        self._host = HostAddress(f"udpout:{host}:{port}", host, may_be_down=may_be_down)
        self._address, self._port = self._host.newest(), port
        self._backoff, self._heard_host_ns = Backoff(), 0
        self._buffer = memoryview(bytearray(2 * _LARGEST_DATAGRAM))
        super().__init__()

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        """Drain the socket."""
        silent = self._address is None or now_host_ns - self._heard_host_ns > _SILENT_NS
        if silent and self._backoff.due(now_host_ns):
            self._address = self._host.newest()
        buffer, filled, receive = self._buffer, 0, self._socket.recv_into
        with contextlib.suppress(BlockingIOError):
            for _ in range(_MOST_DATAGRAMS):
                try:
                    filled += receive(buffer[filled:])
                except ConnectionError:  # nobody listens there yet
                    continue
                if filled >= limit:
                    break
        if filled:
            self._heard_host_ns = now_host_ns
            self._backoff.succeeded()
        return bytes(buffer[:filled])

    def send(self, data: bytes) -> bool:
        """Send to the address."""
        return self._address is not None and self._send_to(data, (self._address, self._port))


def _bind_advice(host: str, port: int, error: OSError) -> str:
    where = f"udpin:{host}:{port}"
    if error.errno == errno.EADDRINUSE:
        return f"{where}: the port is taken; stop the other program (MAVProxy, mavlink-router, a second spanwise?)"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{where}: this computer has no address {host}; use 0.0.0.0 to listen on all"
    if error.errno == errno.EACCES:
        return f"{where}: ports below 1024 need privileges; use 14550"
    return f"{where}: {error.strerror or error}"
