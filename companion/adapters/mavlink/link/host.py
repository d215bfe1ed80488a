"""Addresses of hosts by their names, without ever holding up who asks."""

from __future__ import annotations

import contextlib
import socket
import threading

from companion.errors import LinkDown


class HostAddress:
    """IP address of a host: a number as it is, a name as a resolver tells it.

    With ``may_be_down`` a name is looked up in a thread, for a resolver without a network takes seconds to give up.
    ``where`` is the link, for the error.

    Raises
    ------
    LinkDown
        Nobody knows the name now, and ``may_be_down`` is not set.
    """

    def __init__(self, where: str, host: str, *, may_be_down: bool) -> None:
        self._host = host
        self._search: threading.Thread | None = None
        self._is_number = _is_number(host)
        self._address: str | None = host if self._is_number else None
        if self._is_number or may_be_down:
            return
        self._look_up()
        if self._address is None:
            raise LinkDown(f"{where}: host '{host}' is not known; check the name or use its IP")

    def newest(self) -> str | None:
        """The address that was told last, None before the first; a name is looked up anew meanwhile."""
        if not self._is_number and (self._search is None or not self._search.is_alive()):
            self._search = threading.Thread(target=self._look_up, name="host-name", daemon=True)
            self._search.start()
        return self._address

    def _look_up(self) -> None:
        with contextlib.suppress(OSError, UnicodeError):  # the latter for names that none can have
            self._address = socket.gethostbyname(self._host)


def _is_number(host: str) -> bool:
    try:
        socket.inet_aton(host)
    except OSError:
        return False
    return True
