"""The adapter on a real socket while the link is dirty: garbage, cut frames, foreign floods, NaN, a reboot."""

from __future__ import annotations

import math
import random
import select
import socket
import time
import tracemalloc
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.link.udp import UdpIn
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, ClockRestart, ImuBatch, Record, Reject, Rejected, Station, TimesyncReply


class RealClock:
    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until(self, target_host_ns: int) -> None:
        time.sleep(max(0, target_host_ns - self.now_ns()) / 1e9)


class Loopback:
    """The adapter on a real port, and a vehicle that speaks to it from two."""

    def __init__(self) -> None:
        transport = UdpIn("127.0.0.1", 0)
        self.address = ("127.0.0.1", transport.port)
        self.pilot = MavlinkAutopilot(
            [Link(0, "udpin", transport, RealClock())], load_airframe("nadir-2m"), Settings(), RealClock()
        )
        self.sockets = {component: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for component in (1, 200)}
        self.packers: dict[int, Any] = {}
        self.heard: list[Any] = []
        self.parser = mavlink.MAVLink(None)

    def frame(self, message: Any, component: int = 1, system: int = 1) -> bytes:
        return bytes(message.pack(mavlink.MAVLink(None, system, component)))

    def send(self, data: bytes, component: int = 1) -> None:
        self.sockets[component].sendto(data, self.address)

    def heartbeat(self) -> None:
        self.send(self.frame(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)))

    def poll(self, times: int = 3) -> list[Record]:
        return [record for _ in range(times) for record in self.pilot.poll(0.01)]

    def hear(self) -> list[Any]:
        """Bytes that the adapter sent to the autopilot's port."""
        messages = []
        while select.select([self.sockets[1]], [], [], 0.02)[0]:
            messages += self.parser.parse_buffer(self.sockets[1].recv(65536)) or []
        return messages


@pytest.fixture
def loopback() -> Iterator[Loopback]:
    made = Loopback()
    yield made
    made.pilot.close()
    for open_socket in made.sockets.values():
        open_socket.close()


def highres(t_us: int, z: float = -9.8) -> Any:
    return mavlink.MAVLink_highres_imu_message(t_us, 0, 0, z, 0, 0, 0, 0, 0, 0, 0, 0, 0, 20, 63)


def left(records: list[Record]) -> list[int]:
    """Stamps of the left tip in us."""
    batches = [record for record in records if isinstance(record, ImuBatch) and record.station == Station.LEFT]
    return [int(stamp) // 1000 for batch in batches for stamp in batch.t_ns]


def test_garbage_and_cut_frames_cost_no_good_frame(loopback: Loopback) -> None:
    rng = random.Random(7)
    records: list[Record] = []
    for k in range(200):
        good, other = loopback.frame(highres(1000 * k), 200), loopback.frame(highres(1000 * k), 1)
        loopback.send(rng.randbytes(rng.randint(0, 30)) + other[: rng.randrange(len(other))] + good, 200)
        records += loopback.poll(1)
    # a header in the garbage can keep a frame back until 280 more bytes have come
    loopback.send(bytes(300), 200)
    records += loopback.poll()
    assert left(records) == [1000 * k for k in range(200)]


def foreign(records: Sequence[Record]) -> int:
    refused = (record for record in records if isinstance(record, Rejected))
    return sum(record.count for record in refused if record.reason is Reject.FOREIGN_SOURCE)


def test_a_foreign_flood_is_counted_and_takes_no_memory(loopback: Loopback) -> None:
    loopback.heartbeat()
    loopback.poll()
    flood = b"".join(loopback.frame(highres(k), component=158) for k in range(20))

    def burst(start: int) -> list[Record]:
        for k in range(100):
            loopback.send(flood)
            if k % 10 == 0:
                loopback.send(loopback.frame(highres(1000 * (start + k)), 200), 200)
        return loopback.poll(4)

    stamps = left(burst(0))
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    refused = 0
    for round_number in range(1, 6):
        records = burst(round_number * 100)
        stamps += left(records)
        refused += foreign(records)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 1_000_000
    refused += foreign(loopback.pilot.decoder.refusals.due(2**62))
    assert refused >= 1000
    assert stamps == sorted(stamps)
    assert len(stamps) >= 30  # a full socket buffer may drop what comes behind a burst


def test_a_value_that_is_not_a_number_never_passes(loopback: Loopback) -> None:
    for k in range(1, 9):
        loopback.send(loopback.frame(highres(1000 * k, math.nan if k % 2 else -9.8), 200), 200)
    records = loopback.poll()
    assert left(records) == [2000, 4000, 6000, 8000]
    assert all(np.isfinite(record.values).all() for record in records if isinstance(record, ImuBatch))
    refused = [record for record in records if isinstance(record, Rejected)]
    assert {record.reason for record in refused} == {Reject.NOT_FINITE}


@pytest.mark.slow
def test_time_is_kept_through_a_reboot_of_the_vehicle(loopback: Loopback) -> None:
    records: list[Record] = []
    for boot_ns in (90 * 10**9, 3 * 10**9):
        offset = boot_ns - time.monotonic_ns()
        loopback.heartbeat()
        for _ in range(60):
            records += loopback.poll(1)
            for message in loopback.hear():
                if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    answer = mavlink.MAVLink_timesync_message(time.monotonic_ns() + offset, message.ts1)
                    loopback.send(loopback.frame(answer))
    kinds = [type(record) for record in records if isinstance(record, TimesyncReply | ClockRestart)]
    assert kinds.count(ClockRestart) == 1
    cut = kinds.index(ClockRestart)
    assert cut >= 3
    assert len(kinds) - cut >= 4
    replies = [record for record in records if isinstance(record, TimesyncReply)]
    assert all(reply.clock == ClockName.BOOT for reply in replies)
    assert all(0 < reply.received_host_ns - reply.sent_host_ns < 200_000_000 for reply in replies)
