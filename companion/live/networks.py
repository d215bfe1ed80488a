"""The addresses by which other devices can open the live view, asked of the kernel alone: nothing is sent."""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import re
import socket
import struct
from collections.abc import Callable
from pathlib import Path

_FLAGS_REQUEST, _ADDRESS_REQUEST = 0x8913, 0x8915  # SIOCGIFFLAGS and SIOCGIFADDR of Linux
_UP, _LOOPBACK, _RUNNING = 0x1, 0x8, 0x40  # flags of a network interface
_GLOBAL_SCOPE = 0  # of /proc/net/if_inet6
_INTERFACE_BYTES = 16  # of a name in a request
_INSIDE = re.compile(r"docker\d|br-[0-9a-f]{12}$|veth|virbr|lxcbr|lxdbr|cni|podman")
"""Networks of containers and virtual machines inside this computer, which no other device is in."""


def open_addresses(host: str, networks: Callable[[int], list[tuple[str, str]]] | None = None) -> list[str]:
    """Addresses by which a server bound to ``host`` is opened from elsewhere.

    Those of this computer in its networks where ``host`` means all of them, loopback where it is in none; any other
    host is its address itself. ``networks`` gives name and address of every network of an address family.
    """
    try:
        bound = ipaddress.ip_address(host)
    except ValueError:
        return [host]
    if not bound.is_unspecified:
        return [host]
    family, loopback = (socket.AF_INET, "127.0.0.1") if bound.version == 4 else (socket.AF_INET6, "::1")
    listed = (networks or list_networks)(family)
    return [address for name, address in listed if not _INSIDE.match(name)] or [loopback]


def list_networks(family: int) -> list[tuple[str, str]]:
    """Name and address of the interfaces that are up, loopback and addresses of one link alone left out."""
    return _addresses_v4() if family == socket.AF_INET else _addresses_v6()


def _addresses_v4() -> list[tuple[str, str]]:
    listed = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[: _INTERFACE_BYTES - 1])
            with contextlib.suppress(OSError):  # an interface without an address
                (flags,) = struct.unpack_from("H", fcntl.ioctl(asked, _FLAGS_REQUEST, request), _INTERFACE_BYTES)
                if flags & _UP and flags & _RUNNING and not flags & _LOOPBACK:
                    answer = fcntl.ioctl(asked, _ADDRESS_REQUEST, request)
                    listed.append((name, socket.inet_ntoa(answer[20:24])))
    return listed


def _addresses_v6() -> list[tuple[str, str]]:
    """Lines are address, index, length of the prefix, scope and flags in hexadecimal, and the name."""
    try:
        lines = Path("/proc/net/if_inet6").read_text(encoding="ascii").splitlines()
    except OSError:
        return []
    rows = [line.split() for line in lines]
    return [(row[5], str(ipaddress.IPv6Address(int(row[0], 16)))) for row in rows if int(row[3], 16) == _GLOBAL_SCOPE]
