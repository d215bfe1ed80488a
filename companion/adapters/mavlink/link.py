"""Links: bytes in and out of UDP, TCP and serial connections, in bulk and without ever blocking.

Spelled as pymavlink's mavutil spells them: ``udpin:host:port`` (also ``udp:``), ``udpout:host:port``,
``tcp:host:port``, ``tcpin:host:port``, and a serial device path with ``,baud`` (115200 where it is left out).
"""

from __future__ import annotations

from typing import Protocol

from companion.adapters.mavlink.serial_link import SerialTransport
from companion.adapters.mavlink.signing import SignedTransport, Signing
from companion.adapters.mavlink.tcp import TcpClient, TcpServer
from companion.adapters.mavlink.udp import UdpIn, UdpOut
from companion.errors import LinkError
from companion.ports import Clock
from companion.records import RawChunk

CHUNK_BYTES = 65536
_SPELLINGS = (
    "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a serial device such as /dev/ttyAMA0,921600"
)


class Transport(Protocol):
    """What carries the bytes. Nothing here blocks; a lost connection is opened again with growing pauses."""

    def fileno(self) -> int:
        """Descriptor to wait on, or -1 while there is none."""
        ...

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        """Give what has arrived, about ``limit`` bytes at most; empty where there is nothing."""
        ...

    def send(self, data: bytes) -> bool:
        """Send all of ``data`` or, where that cannot be done at once, nothing."""
        ...

    def close(self) -> None:
        """Release the device or socket."""
        ...


class Link:
    """One connection to the vehicle, with a number that stands in its chunks.

    Attributes
    ----------
    knocks : bool
        Whether the other side learns of us only when we speak first.
    unsent : int
        Writes given up because the connection was down or could not take them at once.
    """

    def __init__(self, number: int, spelling: str, transport: Transport, clock: Clock, *, knocks: bool = False) -> None:
        self.number = number
        self.spelling = spelling
        self.knocks = knocks
        self.unsent = 0
        self._transport = transport
        self._clock = clock

    def fileno(self) -> int:
        """Descriptor to wait on, or -1 while the connection is down."""
        return self._transport.fileno()

    def read(self) -> RawChunk | None:
        """Drain the connection into one chunk of about 64 KiB at most; nothing where nothing has come."""
        data = self._transport.receive(CHUNK_BYTES, self._clock.now_ns())
        if not data:
            return None
        return RawChunk(self.number, self._clock.now_ns(), data)

    def write(self, data: bytes) -> bool:
        """Send one frame, or count it as unsent."""
        done = self._transport.send(data)
        self.unsent += not done
        return done

    def close(self) -> None:
        """Release the connection."""
        self._transport.close()


def open_link(spelling: str, clock: Clock, number: int = 0, signing: Signing | None = None) -> Link:
    """Open a link; with ``signing`` only signed frames come in, and all that go out are signed.

    Raises
    ------
    LinkError
        The spelling is wrong, or the connection cannot be opened; the message says what to do.
    """
    transport = _open_transport(spelling)
    if signing is not None:
        transport = SignedTransport(transport, signing, number)
    return Link(number, spelling, transport, clock, knocks=spelling.startswith("udpout:"))


def _open_transport(spelling: str) -> Transport:
    scheme, _, rest = spelling.partition(":")
    if scheme in ("udp", "udpin"):
        return UdpIn(*_address(spelling, rest))
    if scheme == "udpout":
        return UdpOut(*_address(spelling, rest))
    if scheme == "tcp":
        return TcpClient(*_address(spelling, rest))
    if scheme == "tcpin":
        return TcpServer(*_address(spelling, rest))
    if spelling.startswith(("/", "./")):
        return SerialTransport(*_device(spelling))
    raise LinkError(f"'{spelling}' is not a connection; use {_SPELLINGS}")


def _address(spelling: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.rpartition(":")
    if not host or not port.isdigit() or not 0 <= int(port) <= 65535:
        raise LinkError(f"'{spelling}' needs a host and a port, as in udpin:0.0.0.0:14550")
    return host, int(port)


def _device(spelling: str) -> tuple[str, int]:
    path, comma, baud = spelling.partition(",")
    if comma and not (baud.isdigit() and int(baud) > 0):
        raise LinkError(f"'{spelling}': the baud rate must be a number, as in {path},921600")
    return path, int(baud) if comma else 115200
