"""State of the service for systemd: ready, alive, and a sentence (protocol of sd_notify, without its library).

Datagrams of ``NAME=value`` lines go to the socket named by ``NOTIFY_SOCKET``; without that variable nothing is done.
The process that ticks is a child of the one that systemd started, so ``WATCHDOG_PID`` is not asked: the unit has
``NotifyAccess=all``. Source: sd_notify(3), sd_watchdog_enabled(3).
"""

from __future__ import annotations

import socket
from collections.abc import Mapping

_FEEDS_PER_LIMIT = 4  # chosen: systemd asks for two; one may come late
_LONGEST_STATUS = 200  # characters that fit a line of systemctl (choice)


class ServiceManager:
    """The line to systemd; never blocks and never raises: an unheard word is said again at the next tick.

    ``environment`` has ``NOTIFY_SOCKET``, a path or ``@`` and a name, and ``WATCHDOG_USEC``, the time in us after which
    a service without a sign of life is ended.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        name = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + name[1:] if name.startswith("@") else name
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if name else None
        if self._socket is not None:
            self._socket.setblocking(False)
        limit = environment.get("WATCHDOG_USEC", "")
        self._interval_ns = int(limit) * 1000 // _FEEDS_PER_LIMIT if limit.isdecimal() else 0
        self._next_feed_ns: int | None = 0 if self._interval_ns else None
        self._is_ready = False
        self._status = ""

    def ticked(self, now_host_ns: int, status: str) -> None:
        """Say, where due, that the loop runs (READY once, WATCHDOG four times per limit) and how it stands."""
        if self._socket is None:
            return
        if not self._is_ready:
            self._is_ready = self._notify("READY=1")
        if self._next_feed_ns is not None and now_host_ns >= self._next_feed_ns and self._notify("WATCHDOG=1"):
            self._next_feed_ns = now_host_ns + self._interval_ns
        if status != self._status and self._notify(_status(status)):
            self._status = status

    def close(self) -> None:
        """Release the socket."""
        if self._socket is not None:
            self._socket.close()

    def _notify(self, lines: str) -> bool:
        assert self._socket is not None
        try:
            self._socket.sendto(lines.encode(), self._address)
        except OSError:
            return False
        return True


def _status(text: str) -> str:
    return f"STATUS={' '.join(text.split())[:_LONGEST_STATUS]}"
