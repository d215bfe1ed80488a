"""Protocol of what carries a link's bytes: UDP, TCP, a serial device, or one of them signed."""

from __future__ import annotations

from typing import Protocol


class Transport(Protocol):
    """Carrier of the bytes. Nothing here blocks; a lost connection is opened again with growing pauses."""

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
