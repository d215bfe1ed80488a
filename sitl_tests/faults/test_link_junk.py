"""Bytes that are no frames cost little, wherever they arrive.

A megabyte costs at most forty loops of the interpreter over its bytes, timed beside it (18 measured, where such a loop
takes 30 ms).
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.bulk import BulkDecoder
from companion.adapters.mavlink.decode.source_map import build_mapping
from companion.adapters.mavlink.link.scan import Scanner
from companion.adapters.mavlink.link.signing import SignedTransport, Signing
from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.params.files import load_airframe
from sitl_tests.loop.ground_stations import TurnedClock, Wire

MB, CHUNK = 1_000_000, 65_536
MOST_LOOPS = 40


def bad_frame(magic: int) -> bytes:
    """As long as a frame can be, of a known message, every byte of it the beginning of another, its checksum wrong."""
    head = bytes([0xFD, 255, 0, 0, 0, 1, 1, *(385).to_bytes(3, "little")])
    return (head if magic == 0xFD else bytes([0xFE, 255, 0, 1, 1, 110])) + bytes([magic] * 255) + b"\1\2"


def megabyte(pattern: bytes) -> bytes:
    return (pattern * (MB // len(pattern) + 1))[:MB]


JUNK = {
    "random": random.Random(1).randbytes(MB),
    "only 0xFD": megabyte(b"\xfd"),
    "only 0xFE": megabyte(b"\xfe"),
    "bad MAVLink 2 frames": megabyte(bad_frame(0xFD)),
    "bad MAVLink 1 frames": megabyte(bad_frame(0xFE)),
    "MAVLink 1 headers in each other": megabyte(b"\xfe\x6e"),
    "heartbeats of 128 bytes": megabyte(b"\xfd\x80\x00\x00\x00"),
}
WAYS = ["plain", "compiled"]


def loop() -> None:
    """One step of the interpreter for each byte: the yardstick, which is as slow as the machine is."""
    total = 0
    for byte in JUNK["random"]:
        total += byte


def cost_s(run: Callable[[], None]) -> float:
    """Processor time of a run."""
    begun_s = time.process_time()
    run()
    return time.process_time() - begun_s


def cheapest_loops(run: Callable[[], None]) -> float:
    """Cost of a run over that of the loop: the least of at most three, for what else the machine does only adds."""
    costs: list[float] = []
    while len(costs) < 3 and (not costs or min(costs) >= MOST_LOOPS):
        costs.append(cost_s(run) / cost_s(loop))
    return min(costs)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", JUNK)
def test_in_the_scanner(kind: str, way: str) -> None:
    def run() -> None:
        bulk = BulkDecoder(build_mapping(load_airframe("nadir-2m")).sources) if way == "compiled" else None
        scanner = Scanner(bulk)
        frames = [frame for at in range(0, MB, CHUNK) for frame in scanner.scan(JUNK[kind][at : at + CHUNK], 1).frames]
        assert len(frames) < 10
        assert scanner.counters.skipped_bytes > 0.99 * MB

    assert cheapest_loops(run) < MOST_LOOPS


@pytest.mark.parametrize("kind", JUNK)
def test_on_a_signed_link(kind: str) -> None:
    def run() -> None:
        clock, wire = TurnedClock(), Wire()
        transport = SignedTransport(wire, Signing(bytes(32), clock), 0)
        for at in range(0, MB, CHUNK):
            wire.inbox += JUNK[kind][at : at + CHUNK]
            assert transport.receive(CHUNK, 0) == b""

    assert cheapest_loops(run) < MOST_LOOPS


@pytest.mark.parametrize("kind", JUNK)
def test_in_a_log(kind: str, tmp_path: Path) -> None:
    beat = bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 1, 1)))
    good = (1_700_000_000_000_000).to_bytes(8, "big") + beat
    path = tmp_path / "flight.tlog"
    path.write_bytes(good + JUNK[kind] + good)

    def run() -> None:
        recording = TlogRecording(path, load_airframe("sitl-plane"))
        assert [frame for _, frame in recording.frames()] == [beat, beat]

    assert cheapest_loops(run) < MOST_LOOPS
