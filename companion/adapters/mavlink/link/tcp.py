"""TCP, calling (``tcp``, opened again when lost) or listening (``tcpin``, one client at a time)."""

from __future__ import annotations

import contextlib
import errno
import select
import socket

from companion.adapters.mavlink.link.host import HostAddress
from companion.adapters.mavlink.link.reconnect import Backoff
from companion.errors import LinkDown, LinkError

_FIRST_CONNECT_S = 3.0  # chosen: a host in the same network answers within it, and the start is not held up longer
_LONGEST_CALL_NS = 3_000_000_000  # chosen: the system's own pauses between tries grow to a minute
_GONE_MS = 5000  # chosen: without an answer so long, and a peer has vanished; a radio's pauses are shorter
_KEEPALIVE_S = 1  # chosen: several questions before a silent peer is given up
_UNDER_WAY = (0, errno.EINPROGRESS)  # by definition: of a call that does not wait, connect(2)
_MOST_UNSENT_BYTES = 65536  # bound of memory: what a stalled peer may leave waiting


class _BufferedSocket:
    """A connected stream socket with a bounded buffer for what the kernel cannot take at once.

    A peer that vanished without a word (a cable, a power switch) is gone after five seconds, whether we write to it or
    not: the system alone would wait for a quarter of an hour.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        with contextlib.suppress(OSError, AttributeError):  # the latter on systems that have not all of them
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option, value in (
                (socket.TCP_KEEPIDLE, _KEEPALIVE_S),
                (socket.TCP_KEEPINTVL, _KEEPALIVE_S),
                (socket.TCP_USER_TIMEOUT, _GONE_MS),
            ):
                connection.setsockopt(socket.IPPROTO_TCP, option, value)
        self.socket = connection
        self._unsent = bytearray()

    def receive(self, limit: int) -> bytes | None:
        """Give what has arrived; None where the other side has gone."""
        self.flush()
        try:
            data = self.socket.recv(limit)
        except BlockingIOError:
            return b""
        except OSError:
            return None
        return data or None

    def send(self, data: bytes) -> bool:
        """Send or keep for later; refuse whole frames when too much waits."""
        if len(self._unsent) + len(data) > _MOST_UNSENT_BYTES:
            return False
        self._unsent += data
        self.flush()
        return True

    @property
    def waits(self) -> bool:
        """Whether something is kept for later."""
        return bool(self._unsent)

    def flush(self) -> None:
        """Hand the kernel what it takes."""
        if self._unsent:
            with contextlib.suppress(OSError):
                del self._unsent[: self.socket.send(self._unsent)]

    def close(self) -> None:
        self.socket.close()


class _TcpTransport:
    """Connection of a client or a server, which read and write it alike."""

    _stream: _BufferedSocket | None = None

    @property
    def busy(self) -> bool:
        """Whether bytes wait that the system could not take."""
        return self._stream is not None and self._stream.waits

    def send(self, data: bytes) -> bool:
        """Send where connected."""
        return self._stream is not None and self._stream.send(data)

    def _read(self, limit: int) -> bytes:
        """Read where connected; the connection is given up when the other side has gone."""
        data = b"" if self._stream is None else self._stream.receive(limit)
        if data is None and self._stream is not None:
            self._stream.close()
            self._stream = None
        return data or b""


class TcpClient(_TcpTransport):
    """Calls an address; after a loss it calls again with growing pauses, without blocking.

    With ``may_be_down`` the first call does not block either: it begins with the first :meth:`receive`.
    """

    def __init__(self, host: str, port: int, *, may_be_down: bool = False) -> None:
        where = f"tcp:{host}:{port}"
        self._host, self._port = HostAddress(where, host, may_be_down=may_be_down), port
        if not may_be_down:
            self._stream = _BufferedSocket(_connected(where, (self._host.newest() or host, port)))
        self._calling: socket.socket | None = None
        self._called_host_ns = 0
        self._backoff = Backoff()

    def fileno(self) -> int:
        """Descriptor of the connection, or -1."""
        return self._stream.socket.fileno() if self._stream else -1

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        """Read, or go on with connecting again."""
        if self._stream is None:
            self._call(now_host_ns)
        return self._read(limit)

    def close(self) -> None:
        """Release the sockets."""
        for held in (self._stream, self._calling):
            if held is not None:
                held.close()

    def _call(self, now_host_ns: int) -> None:
        if self._calling is None:
            if not self._backoff.due(now_host_ns):
                return
            address = self._host.newest()
            if address is None:
                return
            self._calling = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._calling.setblocking(False)
            self._called_host_ns = now_host_ns
            if self._calling.connect_ex((address, self._port)) not in _UNDER_WAY:
                self._calling.close()  # no way there, which a socket that never called does not tell later
                self._calling = None
                return
        calling = self._calling
        _, writable, _ = select.select([], [calling], [], 0)
        if not writable:
            if now_host_ns - self._called_host_ns > _LONGEST_CALL_NS:
                self._calling.close()
                self._calling = None
            return
        self._calling = None
        if calling.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            calling.close()
            return
        self._stream = _BufferedSocket(calling)
        self._backoff.succeeded()


def _connected(where: str, address: tuple[str, int]) -> socket.socket:
    try:
        return socket.create_connection(address, timeout=_FIRST_CONNECT_S)
    except ConnectionRefusedError as error:
        raise LinkDown(f"{where}: nothing listens there; start the autopilot or router first") from error
    except OSError as error:
        raise LinkDown(f"{where}: cannot be reached ({error}); check address and network") from error


class TcpServer(_TcpTransport):
    """Waits for one client; when it leaves, waits for the next."""

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((host, port))
        except OSError as error:
            self._listener.close()
            taken = "the port is taken; stop the other program" if error.errno == errno.EADDRINUSE else error.strerror
            raise LinkError(f"tcpin:{host}:{port}: {taken}") from error
        self._listener.listen(1)
        self._listener.setblocking(False)

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return int(self._listener.getsockname()[1])

    def fileno(self) -> int:
        """Descriptor of the client, or of the listener while there is none."""
        return self._stream.socket.fileno() if self._stream else self._listener.fileno()

    def receive(self, limit: int, now_host_ns: int) -> bytes:  # noqa: ARG002 (part of the protocol)
        """Read from the client, or take a new one."""
        if self._stream is None:
            with contextlib.suppress(OSError):
                connection, _ = self._listener.accept()
                self._stream = _BufferedSocket(connection)
        return self._read(limit)

    def close(self) -> None:
        """Release the sockets."""
        if self._stream is not None:
            self._stream.close()
        self._listener.close()
