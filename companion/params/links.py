"""How a MAVLink link is spelled: one grammar for every command, mission script and simulated vehicle.

Written as pymavlink's mavutil does: ``udpin:0.0.0.0:14550``, ``udpout:host:port``, ``tcp:host:port``,
``tcpin:host:port``, ``/dev/ttyAMA0,921600``. MAVSDK's spelling (``udpin://0.0.0.0:14550``, ``tcpout://host:port``,
``serial:///dev/ttyAMA0:921600``) means the same and is taken everywhere too. Behind either, ``,unsigned`` says that
the other side of this link has no signing key: ``/dev/ttyUSB0,921600,unsigned``.
"""

from __future__ import annotations

import dataclasses
import enum
from dataclasses import dataclass

from companion.errors import LinkError

_LAST_PORT = 65535  # by definition: two bytes of a header (RFC 768)
DEFAULT_BAUD = 115200
"""Bits per second of a serial device whose rate is left out (a convention of pymavlink's)."""

_UNSIGNED = ",unsigned"  # ends a spelling (choice)
_SPELLINGS = (
    "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or a serial device such as /dev/ttyAMA0,921600"
)


class LinkKind(enum.StrEnum):
    """Carrier of the bytes; the value is mavutil's word."""

    UDP_LISTEN = "udpin"
    UDP_CALL = "udpout"
    TCP_CALL = "tcp"
    TCP_LISTEN = "tcpin"
    SERIAL = "serial"


_ALIASES = {"udp": LinkKind.UDP_LISTEN, "tcpout": LinkKind.TCP_CALL}
_MAVSDK = {LinkKind.TCP_CALL: "tcpout"}


@dataclass(frozen=True, slots=True)
class LinkAddress:
    """Where a link leads: ``host`` and ``port``, or for a serial device its path and its bits per second.

    ``str()`` gives mavutil's spelling. ``signed`` is whether a signing key, where there is one, holds for this link.
    """

    kind: LinkKind
    host: str
    port: int
    signed: bool = True

    def __str__(self) -> str:
        if self.kind is LinkKind.SERIAL:
            return f"{self.host},{self.port}"
        return f"{self.kind}:{self.host}:{self.port}"

    @property
    def mavsdk_url(self) -> str:
        """The same in MAVSDK's spelling."""
        return f"{_MAVSDK.get(self.kind, str(self.kind))}://{self.host}:{self.port}"


def parse_link(spelling: str) -> LinkAddress:
    """Read either spelling.

    Raises
    ------
    LinkError
        It is neither; the message shows how it is written.
    """
    if spelling.endswith(_UNSIGNED):
        return dataclasses.replace(parse_link(spelling.removesuffix(_UNSIGNED)), signed=False)
    if spelling.startswith(("/", "./")):
        return _serial(spelling, *spelling.partition(","))
    scheme, _, rest = spelling.partition(":")
    rest = rest.removeprefix("//")
    if scheme == LinkKind.SERIAL and rest.startswith("/"):
        device, separator, baud = rest.rpartition("," if "," in rest else ":")
        return _serial(spelling, device, separator, baud) if device else _serial(spelling, rest, "", "")
    if scheme not in _ALIASES and scheme not in list(LinkKind)[:-1]:
        raise LinkError(f"'{spelling}' is not a connection; use {_SPELLINGS}")
    host, _, port = rest.rpartition(":")
    if host and port.isdecimal() and int(port) > _LAST_PORT:
        raise LinkError(f"'{spelling}': a port is at most {_LAST_PORT}")
    if not host or not port.isdecimal():
        raise LinkError(f"'{spelling}' needs a host and a port, as in udpin:0.0.0.0:14550")
    return LinkAddress(_ALIASES.get(scheme) or LinkKind(scheme), host, int(port))


def _serial(spelling: str, device: str, separator: str, baud: str) -> LinkAddress:
    if separator and not (baud.isdecimal() and int(baud) > 0):
        raise LinkError(f"'{spelling}': the baud rate must be a number, as in {device},921600")
    return LinkAddress(LinkKind.SERIAL, device, int(baud) if separator else DEFAULT_BAUD)
