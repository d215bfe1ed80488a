"""A serial device that goes away: the link waits for it, whatever it was doing."""

from __future__ import annotations

import os
import pty
from pathlib import Path

import pytest

from companion.adapters.mavlink.link.serial_link import SerialTransport
from companion.errors import LinkDown

S = 1_000_000_000


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


def _full(*_: object) -> int:
    raise BlockingIOError
