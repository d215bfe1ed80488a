"""A serial device that goes away: the link waits for it, whatever it was doing."""

from __future__ import annotations

import os
import pty
from pathlib import Path

import pytest

from companion.adapters.mavlink.link.serial_link import SerialTransport

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


def _full(*_: object) -> int:
    raise BlockingIOError
