"""Messages of the service to systemd: ready once, alive while the inertial loop turns, nothing while it does not."""

from __future__ import annotations

import dataclasses
import itertools
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.adapters.systemd import ServiceManager
from companion.core.pipeline import start
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.service.inertial import InertialLoop
from sitl_tests.manual_clock import ManualClock

MS = 1_000_000
SECOND = 1_000_000_000
LIMIT_NS = 2 * SECOND


@dataclasses.dataclass
class Listener:
    """systemd's end: a datagram socket, and the time at which each line was read from it."""

    end: socket.socket
    address: str
    heard: list[tuple[int, str]] = dataclasses.field(default_factory=list)

    def listen(self, now_ns: int) -> None:
        while True:
            try:
                lines = self.end.recv(4096).decode().splitlines()
            except BlockingIOError:
                return
            self.heard += [(now_ns, line) for line in lines]

    def times_ns(self, line: str) -> list[int]:
        return [at_ns for at_ns, said in self.heard if said == line]

    def surroundings(self, **more: str) -> dict[str, str]:
        return {"NOTIFY_SOCKET": self.address, "WATCHDOG_USEC": str(LIMIT_NS // 1000), "WATCHDOG_PID": "1", **more}


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Listener]:
    path = str(tmp_path / "notify")
    address, name = (path, path) if request.param == "path" else ("@" + path, "\0" + path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(name)
        end.setblocking(False)
        yield Listener(end, address)


class Vehicle:
    """Nothing arrives, and each look at the link takes some time."""

    def __init__(self, clock: ManualClock, turn_ms: int = 5) -> None:
        self.clock, self.turn_ms = clock, turn_ms

    def poll(self, timeout_s: float) -> list[Any]:
        self.clock.sleep_until(self.clock.now_ns() + self.turn_ms * MS)
        return []

    def publish(self, record: object) -> None: ...

    def close(self) -> None: ...


class Nothing:
    """No trigger, no recorder."""

    def send(self, plan: object) -> None: ...

    def poll(self) -> list[Any]:
        return []

    def warnings(self) -> list[str]:
        return []

    def write(self, record: object) -> None: ...

    def close(self) -> None: ...


def turned(vehicle: Vehicle, manager: ServiceManager) -> InertialLoop:
    """The service's own inertial loop, to be turned by hand."""
    nothing: Any = Nothing()
    state = start(load_airframe("nadir-2m"), Settings())
    return InertialLoop(state, vehicle, vehicle.clock, nothing, list, bool, nothing, alive=manager.ticked)


def test_the_inertial_loop_feeds_the_watchdog_and_a_stalled_one_does_not(systemd: Listener) -> None:
    clock = ManualClock(SECOND)
    vehicle = Vehicle(clock)
    loop = turned(vehicle, ServiceManager(systemd.surroundings()))
    while clock.now_ns() < 11 * SECOND:
        loop.run_once()
        systemd.listen(clock.now_ns())
    assert len(systemd.times_ns("READY=1")) == 1
    fed = systemd.times_ns("WATCHDOG=1")
    assert max(later - earlier for earlier, later in itertools.pairwise(fed)) <= LIMIT_NS // 2
    assert 10 * SECOND // LIMIT_NS * 2 <= len(fed) <= 30, "twice per limit at least, and not at every tick"
    before = len(systemd.heard)
    clock.sleep_until(clock.now_ns() + 3 * LIMIT_NS)  # no turn in all that time
    systemd.listen(clock.now_ns())
    assert len(systemd.heard) == before


def test_the_loop_s_state_is_systemd_s_status(systemd: Listener) -> None:
    clock = ManualClock(SECOND)
    loop = turned(Vehicle(clock), ServiceManager(systemd.surroundings()))
    while clock.now_ns() < 4 * SECOND:
        loop.run_once()
    systemd.listen(clock.now_ns())
    said = [line for _, line in systemd.heard if line.startswith("STATUS=")]
    assert said
    assert said[-1] == f"STATUS={loop.status}"
    assert loop.status.split(":")[0] in ("boot", "standby")


def test_without_a_watchdog_only_readiness_is_told(systemd: Listener) -> None:
    manager = ServiceManager({"NOTIFY_SOCKET": systemd.address})
    for tick in range(1000):
        manager.ticked(tick * 10 * MS, "")
    systemd.listen(0)
    assert systemd.heard == [(0, "READY=1")]


def test_without_systemd_nothing_is_done() -> None:
    manager = ServiceManager({"WATCHDOG_USEC": "1000000"})
    manager.ticked(SECOND, "active: tracking")
    manager.close()


def test_a_socket_that_is_full_or_gone_never_stops_the_loop_and_the_word_is_said_again(systemd: Listener) -> None:
    manager = ServiceManager(systemd.surroundings())
    flood = ServiceManager({"NOTIFY_SOCKET": systemd.address})
    for turn in range(5000):  # until the listener's queue is full
        flood.ticked(turn * 10 * SECOND, str(turn))
    manager.ticked(SECOND, "standby: nothing arrives")
    systemd.listen(0)
    systemd.heard.clear()
    manager.ticked(SECOND + 10 * MS, "standby: nothing arrives")
    systemd.listen(0)
    assert [line for _, line in systemd.heard] == ["READY=1", "WATCHDOG=1", "STATUS=standby: nothing arrives"]
    systemd.end.close()
    manager.ticked(10 * SECOND, "active: tracking")
    manager.close()
