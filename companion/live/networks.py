"""The addresses by which other devices can open the live view, asked of the kernel alone: nothing is sent."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Callable

from companion.errors import import_extra

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
    psutil = import_extra("psutil", "live pages", "live")
    states = psutil.net_if_stats()
    listed = [
        (name, entry.address.partition("%")[0])
        for name, entries in psutil.net_if_addrs().items()
        for entry in entries
        if entry.family == family and name in states and states[name].isup
    ]
    return [(name, address) for name, address in listed if _reaches_out(ipaddress.ip_address(address))]


def _reaches_out(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    return not (address.is_loopback or address.is_link_local)
