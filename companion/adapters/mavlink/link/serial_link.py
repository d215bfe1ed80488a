"""A serial device, opened again when it was unplugged and came back."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import sys
import termios
from typing import Any

import serial

from companion.adapters.mavlink.link.reconnect import Backoff
from companion.errors import LinkDown, LinkError

_MOST_UNSENT_BYTES = 16384  # bound of memory: 1.4 s at 115,200 baud; what would be older is refused
_TAKEN = (errno.EBUSY, errno.EWOULDBLOCK)  # of the kernel's lock and of pyserial's (convention)
_AWAY = (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO)  # of a device that is unplugged (convention)


class SerialTransport:
    """Reads and writes a serial device without blocking, alone: a second reader would take bytes away.

    With ``may_be_down`` a device that cannot be opened is one that was lost, and is looked for again.
    """

    def __init__(self, path: str, baud: int, *, may_be_down: bool = False) -> None:
        self._path = path
        self._baud = baud
        self._backoff = Backoff()
        self._unsent = bytearray()
        self._port: Any = None
        try:
            self._port = self._open()
        except (OSError, ValueError, termios.error) as error:
            if not may_be_down:
                refused = LinkDown if getattr(error, "errno", None) in _AWAY else LinkError
                raise refused(_advice(path, baud, error)) from error

    def fileno(self) -> int:
        """Descriptor of the device, or -1 while it is away."""
        return -1 if self._port is None else int(self._port.fileno())

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        """Read what has arrived, or look for the device again."""
        if self._port is None:
            self._return(now_host_ns)
        if self._port is None:
            return b""
        self._flush()
        if self._port is None:  # the device went while what had waited was written
            return b""
        try:
            data = os.read(self._port.fileno(), limit)
        except BlockingIOError:
            return b""
        except OSError:
            self._lose()
            return b""
        if not data:  # end of file: the device has gone
            self._lose()
        return data

    def send(self, data: bytes) -> bool:
        """Send or keep for later; refuse whole frames when too much waits."""
        if self._port is None or len(self._unsent) + len(data) > _MOST_UNSENT_BYTES:
            return False
        self._unsent += data
        self._flush()
        return True

    @property
    def busy(self) -> bool:
        """Whether bytes wait for the line, here or in the kernel: what is sent now waits behind them."""
        if self._port is None or self._unsent:
            return bool(self._unsent)
        try:
            waiting = fcntl.ioctl(self._port.fileno(), termios.TIOCOUTQ, bytes(4))
        except OSError:  # not every driver can tell
            return False
        return int.from_bytes(waiting, sys.byteorder) > 0

    def close(self) -> None:
        """Release the device."""
        self._lose()

    def _open(self) -> Any:
        port = serial.Serial(self._path, self._baud, timeout=0, write_timeout=0, exclusive=True)
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)  # for programs that do not ask for the lock (root may still open)
        os.set_blocking(port.fileno(), False)
        # pyserial lets a read without data return nothing, which is what a device that was unplugged does too
        attributes = termios.tcgetattr(port.fileno())
        attributes[6][termios.VMIN] = 1
        termios.tcsetattr(port.fileno(), termios.TCSANOW, attributes)
        return port

    def _return(self, now_host_ns: int) -> None:
        if self._backoff.due(now_host_ns):
            try:
                self._port = self._open()
                self._backoff.succeeded()
            except (OSError, ValueError, termios.error):
                self._port = None

    def _lose(self) -> None:
        self._unsent.clear()
        if self._port is not None:
            with contextlib.suppress(OSError):  # it would last for as long as another program has the device open
                fcntl.ioctl(self._port.fileno(), termios.TIOCNXCL)
            self._port.close()
            self._port = None

    def _flush(self) -> None:
        if self._unsent:
            try:
                del self._unsent[: os.write(self._port.fileno(), self._unsent)]
            except BlockingIOError:
                return
            except OSError:
                self._lose()


def _advice(path: str, baud: int, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return f"{path}: no such device; check the cable and 'ls /dev/serial/by-id'"
    if number == errno.EACCES:
        return f"{path}: permission denied; add yourself to the group 'dialout' and log in again"
    if number in _TAKEN:
        return f"{path}: the device is in use; stop the other program (a second spanwise, MAVProxy, ModemManager?)"
    if isinstance(error, ValueError):
        return f"{path}: baud rate {baud} is not supported by this device"
    if os.strerror(errno.ENOTTY) in str(error):  # in pyserial's words, whose errno is None
        return f"{path}: is no serial device"
    return f"{path}: {error}"
