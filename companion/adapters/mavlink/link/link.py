"""Links: bytes in and out of UDP, TCP and serial connections, in bulk and without ever blocking.

mavutil's connections block, believe every sender that reaches a UDP port, and stamp a message after parsing it. Ours
never block, guard who may speak under which id, and stamp bytes as they arrive, which TIMESYNC's accuracy rests on.
How a link is spelled is told by :mod:`companion.params.links`.
"""

from __future__ import annotations

from companion.adapters.mavlink.link.serial_link import SerialTransport
from companion.adapters.mavlink.link.signing import SignedTransport, Signing
from companion.adapters.mavlink.link.tcp import TcpClient, TcpServer
from companion.adapters.mavlink.link.transport import Transport
from companion.adapters.mavlink.link.udp import UdpIn, UdpOut
from companion.adapters.mavlink.vehicle.senders import Senders
from companion.params.links import LinkAddress, LinkKind, parse_link
from companion.ports import Clock
from companion.records import RawChunk

CHUNK_BYTES = 65536  # most bytes of a read: 0.7 s of a 921,600 baud line (choice)


class Link:
    """One connection to the vehicle, with a number that stands in its chunks.

    ``speaks_first`` is whether the other side learns of us only so. ``unsent`` counts writes given up
    because the connection was down or could not take them at once.
    """

    def __init__(
        self, number: int, spelling: str, transport: Transport, clock: Clock, *, speaks_first: bool = False
    ) -> None:
        self.number = number
        self.spelling = spelling
        self.speaks_first = speaks_first
        self.unsent = 0
        self._transport = transport
        self._clock = clock

    @property
    def senders(self) -> Senders | None:
        """Who has which id, where many can reach this link."""
        return getattr(self._transport, "senders", None)

    @property
    def busy(self) -> bool:
        """Whether bytes wait for a slow line; a datagram never waits."""
        return bool(getattr(self._transport, "busy", False))

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


def open_link(
    spelling: str, clock: Clock, number: int = 0, signing: Signing | None = None, *, may_be_down: bool = False
) -> Link:
    """Open a link; with ``signing`` only signed frames come in, and all that go out are signed.

    Where the spelling ends with ``,unsigned`` the key does not hold for this link.

    With ``may_be_down`` a serial device, a TCP server or a host's name that is not there is waited for, as if lost.

    Raises
    ------
    LinkError
        The spelling is wrong, or the connection cannot be opened; the message says what to do.
    """
    address = parse_link(spelling)
    transport = _open_transport(address, may_be_down=may_be_down)
    if signing is not None and address.signed:
        transport = SignedTransport(transport, signing, number)
    return Link(number, str(address), transport, clock, speaks_first=address.kind is LinkKind.UDP_CALL)


def _open_transport(address: LinkAddress, *, may_be_down: bool) -> Transport:
    match address.kind:
        case LinkKind.UDP_LISTEN:
            return UdpIn(address.host, address.port)
        case LinkKind.UDP_CALL:
            return UdpOut(address.host, address.port, may_be_down=may_be_down)
        case LinkKind.TCP_CALL:
            return TcpClient(address.host, address.port, may_be_down=may_be_down)
        case LinkKind.TCP_LISTEN:
            return TcpServer(address.host, address.port)
        case LinkKind.SERIAL:
            return SerialTransport(address.host, address.port, may_be_down=may_be_down)
