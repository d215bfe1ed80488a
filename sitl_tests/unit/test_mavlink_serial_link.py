"""A serial device that goes away: the link waits for it, whatever it was doing."""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import struct
from pathlib import Path

import pytest

from companion.adapters.mavlink.link.serial_link import SerialTransport
from companion.errors import LinkDown, LinkError

S = 1_000_000_000
TIOCGEXCL = 0x80045440  # of asm-generic/ioctls.h


@pytest.mark.parametrize("waiting", [b"", b"a frame that the device did not take"])
def test_a_device_that_goes_while_bytes_wait_is_opened_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, waiting: bytes
) -> None:
    master, slave = pty.openpty()
    device = tmp_path / "ttyUSB0"
    device.symlink_to(os.ttyname(slave))
    transport = SerialTransport(str(device), 57600)
    with monkeypatch.context() as full:
        full.setattr("companion.adapters.mavlink.link.serial_link.os.write", _full)
        assert transport.send(waiting)
    os.close(slave)
    os.close(master)  # unplugged
    device.unlink()
    for k in range(3):
        assert transport.receive(4096, k * S) == b""
    assert transport.fileno() == -1
    master, slave = pty.openpty()
    device.symlink_to(os.ttyname(slave))
    assert transport.receive(4096, 60 * S) == b""
    assert transport.fileno() >= 0
    os.write(master, b"hello")
    assert transport.receive(4096, 61 * S) == b"hello"
    transport.close()
    os.close(master)
    os.close(slave)


def test_a_device_that_is_not_there_at_the_start_is_waited_for_where_that_is_allowed(tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0"
    with pytest.raises(LinkDown, match="no such device"):
        SerialTransport(str(device), 57600)
    transport = SerialTransport(str(device), 57600, may_be_down=True)
    assert transport.fileno() == -1
    assert not transport.send(b"nobody yet")
    assert transport.receive(4096, 0) == b""
    master, slave = pty.openpty()
    device.symlink_to(os.ttyname(slave))
    assert transport.receive(4096, 1 * S) == b""
    os.write(master, b"hello")
    assert transport.receive(4096, 2 * S) == b"hello"
    transport.close()
    os.close(master)
    os.close(slave)


def test_a_device_is_one_program_s_until_it_is_closed(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    device = tmp_path / "ttyUSB0"
    device.symlink_to(os.ttyname(slave))
    for _ in range(2):  # closed, it is free again, although another program has it open
        transport = SerialTransport(str(device), 57600)
        assert _exclusive(slave)
        with pytest.raises(LinkError, match="the device is in use; stop the other program"):
            SerialTransport(str(device), 57600)
        os.write(master, b"hello")
        assert transport.receive(4096, 0) == b"hello"
        transport.close()
        assert not _exclusive(slave)
    os.close(master)
    os.close(slave)


def test_a_device_that_the_kernel_keeps_for_another_program_is_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(*_: object) -> int:
        raise OSError(errno.EBUSY, "Device or resource busy")

    monkeypatch.setattr("serial.serialposix.os.open", busy)
    with pytest.raises(LinkError, match="the device is in use; stop the other program"):
        SerialTransport(str(tmp_path / "ttyUSB0"), 57600)


def _exclusive(descriptor: int) -> bool:
    """Whether the kernel lets nobody else open the terminal."""
    return bool(struct.unpack("i", fcntl.ioctl(descriptor, TIOCGEXCL, bytes(4)))[0])


def _full(*_: object) -> int:
    raise BlockingIOError
