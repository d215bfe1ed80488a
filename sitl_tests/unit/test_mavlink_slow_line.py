"""Files and parameters that are asked of our component make no range and no TIMESYNC late where the line is slow."""

from __future__ import annotations

import os
import pty
import struct
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.link.serial_link import SerialTransport
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.params.files import load_airframe
from companion.params.metadata import metadata_files
from companion.params.settings import Settings
from companion.records import NoRange, Reject
from sitl_tests.loop.ground_stations import TurnedClock, Wire

MS, S = 1_000_000, 1_000_000_000
BYTES_PER_S = 5760  # of 57,600 baud
OPEN, BURST = 4, 15


class SlowLine(Wire):
    """A serial line of 57,600 baud with a queue; tells how long each message was on its way."""

    def __init__(self, clock: TurnedClock) -> None:
        super().__init__()
        self.clock, self.parser = clock, mavlink.MAVLink(None)
        self.free_ns = clock.now
        self.took: list[tuple[Any, float]] = []

    @property
    def busy(self) -> bool:
        return self.free_ns > self.clock.now

    def send(self, data: bytes) -> bool:
        self.free_ns = max(self.free_ns, self.clock.now) + len(data) * S // BYTES_PER_S
        for message in self.parser.parse_buffer(data) or []:
            self.took.append((message, (self.free_ns - self.clock.now) / S))
        return True


def asked(packer: mavlink.MAVLink, opcode: int, data: bytes = b"") -> bytes:
    head = struct.pack("<HBBBBBBI", opcode, 0, opcode, len(data), 0, 0, 0, 0)
    message = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 191, list((head + data).ljust(251, b"\0")))
    return bytes(message.pack(packer))


@pytest.fixture
def flown() -> Iterator[SlowLine]:
    """Three seconds in which a ground station has a file in bursts and the list of parameters."""
    clock = TurnedClock()
    line, autopilot, station = SlowLine(clock), mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 255, 190)
    pilot = MavlinkAutopilot([Link(0, "slow", line, clock)], load_airframe("nadir-2m"), Settings(), clock)
    path, _ = max(metadata_files(191).items(), key=lambda entry: len(entry[1]))
    for step in range(1500):
        if step % 500 == 0:
            line.inbox += bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(autopilot))
        if step == 400:
            line.inbox += asked(station, OPEN, path.encode()) + asked(station, BURST)
            line.inbox += bytes(mavlink.MAVLink_param_request_list_message(1, 191).pack(station))
        list(pilot.poll(0.0))
        if step % 50 == 0:
            pilot.publish(NoRange(clock.now, 25, Reject.STALE))
        clock.now += 2 * MS
    yield line
    pilot.close()


def test_a_range_waits_for_no_file(flown: SlowLine) -> None:
    longest_s = {
        kind: max(s for message, s in flown.took if message.get_type() == kind)
        for kind in ("DISTANCE_SENSOR", "TIMESYNC")
    }
    assert max(longest_s.values()) < 0.15, "a packet of a file, 46 ms, and what else is due"
    count = sum(message.get_type() == "FILE_TRANSFER_PROTOCOL" for message, _ in flown.took)
    assert count > 15, "it goes on beside the ranges"


def test_a_serial_device_is_busy_until_its_line_has_taken_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    device = tmp_path / "ttyUSB0"
    device.symlink_to(os.ttyname(slave))
    transport, waiting = SerialTransport(str(device), 57600), 5
    monkeypatch.setattr(
        "companion.adapters.mavlink.link.serial_link.fcntl.ioctl",
        lambda descriptor, request, room: waiting.to_bytes(4, "little") if request == termios.TIOCOUTQ else room,
    )
    link = Link(0, "serial", transport, TurnedClock())
    assert link.busy
    waiting = 0
    assert not link.busy
    monkeypatch.undo()
    transport.close()
    assert not link.busy
    os.close(master)
    os.close(slave)
