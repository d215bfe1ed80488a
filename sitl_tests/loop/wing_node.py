"""The wing node's firmware, built for this machine, on a pseudo-terminal that a test reads and writes."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import struct
import subprocess
import time
import tty
from collections import Counter
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

SOURCE = Path(__file__).resolve().parents[2] / "tools" / "wing_node"
HOST = (1, 191)


def build(folder: Path) -> Path:
    """Compile the node and give the program."""
    subprocess.run(["make", "-s", "-C", str(SOURCE), f"OUT={folder}"], check=True, timeout=60)
    return folder / "wing_node"


def timesync(tc1: int, ts1: int, system: int, component: int) -> bytes:
    """A TIMESYNC frame with its target fields, which pymavlink 2.4.50 does not know yet."""
    payload = struct.pack("<qqBB", tc1, ts1, system, component).rstrip(b"\0")
    head = struct.pack("<BBBBBBBHB", 0xFD, len(payload), 0, 0, 0, *HOST, 111, 0)
    checksum = mavlink.x25crc(head[1:] + payload + bytes([mavlink.MAVLink_timesync_message.crc_extra])).crc
    return head + payload + struct.pack("<H", checksum)


class Node:
    """A running node, the other end of its line, and the truth about its clock."""

    def __init__(
        self,
        program: Path,
        *,
        component: int = 200,
        rate_hz: float = 1000,
        average: int = 1,
        skew_ppm: float = 0,
        stall_ms: float = 0,
    ) -> None:
        self.line, slave = pty.openpty()
        tty.setraw(self.line)
        numbers = (component, rate_hz, average, skew_ppm, stall_ms)
        self.process = subprocess.Popen(
            [str(program), str(slave), *(str(number) for number in numbers)], stdout=subprocess.PIPE, pass_fds=[slave]
        )
        os.close(slave)
        os.set_blocking(self.line, False)
        assert self.process.stdout is not None
        self.start_ns = int(self.process.stdout.readline())
        self.rate_hz = rate_hz
        self.skew = skew_ppm * 1e-6
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.packer = mavlink.MAVLink(None, *HOST)
        self.heard: list[tuple[Any, int]] = []

    def node_ns(self, host_ns: int) -> float:
        """The node's true time at an instant of CLOCK_MONOTONIC."""
        return (host_ns - self.start_ns) * (1.0 + self.skew)

    def say(self, message: Any) -> None:
        """Send a message as the companion."""
        self.write(message.pack(self.packer))

    def write(self, data: bytes) -> None:
        """Send bytes."""
        os.write(self.line, data)

    def listen(self, seconds: float) -> list[Any]:
        """Read for a while; give what was understood in it."""
        began, ends = len(self.heard), time.monotonic() + seconds
        while (left := ends - time.monotonic()) > 0:
            if not select.select([self.line], [], [], left)[0]:
                break
            with contextlib.suppress(BlockingIOError, OSError):
                data = os.read(self.line, 65536)
                now_ns = time.monotonic_ns()
                self.heard += [(message, now_ns) for message in self.parser.parse_buffer(data) or []]
        return [message for message, _ in self.heard[began:]]

    def ask_time(self, system: int = 0, component: int = 0, within_s: float = 5.0) -> list[tuple[Any, int, int]]:
        """Send a TIMESYNC request; give its answers with the instants of asking and hearing."""
        asked_ns, ends = time.monotonic_ns(), time.monotonic() + within_s
        self.write(timesync(0, asked_ns, system, component))
        answers: list[tuple[Any, int, int]] = []
        while not answers and time.monotonic() < ends:
            self.listen(0.05)
            answers = [
                (message, asked_ns, heard_ns)
                for message, heard_ns in self.heard
                if message.get_type() == "TIMESYNC" and message.ts1 == asked_ns
            ]
        return answers

    def counters(self) -> dict[str, int]:
        """The newest NAMED_VALUE_INTs."""
        messages = [message for message, _ in self.heard if message.get_type() == "NAMED_VALUE_INT"]
        return {message.name: message.value for message in messages}

    def kinds(self) -> Counter[str]:
        """How many of each message were heard."""
        return Counter(message.get_type() for message, _ in self.heard)

    def close(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()
        os.close(self.line)
