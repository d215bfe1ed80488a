"""The links' own faults, struck for real: cables, connections and keys; measured from their end to the next sample.

A wing node sends 200 samples a second through a real pseudo-terminal, TCP connection or UDP socket to our adapter; the
link breaks for two seconds. Part of the fault table (:mod:`sitl_tests.faults.vehicle_faults`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import pty
import socket
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.clocks import MonotonicClock
from companion.adapters.mavlink.link.link import open_link
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import CorrectedRange, Health, ImuBatch, Notice, ServiceStatus
from companion.service.config import ServiceConfig
from companion.service.wiring import Service
from companion.sim.flight.flight import build_flight
from sitl_tests.faults.test_link_strangers import NODE, PILOT, Choosing, Port
from sitl_tests.faults.test_process_lifetime import record_on_a_full_disk
from sitl_tests.faults.test_process_restart import Vehicle, killed_and_back
from sitl_tests.faults.test_signing_links import NOW, OTHER, SECOND, Other, Ours
from sitl_tests.loop.simulated_service import SimulatedService

PERIOD_S, BEFORE_S, BROKEN_S, AFTER_S = 0.005, 1.0, 2.0, 12.0


@dataclass(frozen=True)
class LinkOutcome:
    """One row: what was sent and did not arrive while the link was whole again or about to break."""

    name: str
    happened: str
    recovery_s: float
    lost: int | None
    wrong: int


class Cable(Protocol):
    """The vehicle's side of a link that can be cut."""

    spelling: str

    def send(self, frame: bytes) -> None:
        """Send, or lose."""

    def cut(self) -> None:
        """Break the link."""

    def mend(self) -> None:
        """Make it whole."""


class SerialCable:
    """A USB serial device that is pulled out and comes back under the same name."""

    def __init__(self, folder: Path) -> None:
        self._node = folder / "ttyACM0"
        self.spelling = f"{self._node},921600"
        self.mend()

    def send(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._master, frame)

    def cut(self) -> None:
        self._node.unlink()
        os.close(self._slave)
        os.close(self._master)
        self._master = -1

    def mend(self) -> None:
        self._master, self._slave = pty.openpty()
        os.set_blocking(self._master, False)
        self._node.symlink_to(os.ttyname(self._slave))


class TcpCable:
    """A server that goes away and listens again on the same port."""

    def __init__(self, folder: Path) -> None:
        del folder
        self._port = 0
        self._client: socket.socket | None = None
        self.mend()
        self.spelling = f"tcp:127.0.0.1:{self._port}"

    def send(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):
            if self._client is None:
                self._client = self._server.accept()[0]
            self._client.sendall(frame)

    def cut(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
        self._server.close()

    def mend(self) -> None:
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.bind(("127.0.0.1", self._port))
        self._server.listen(1)
        self._server.setblocking(False)
        self._port = int(self._server.getsockname()[1])


class UdpCable:
    """A sender that goes away and comes back from another port."""

    def __init__(self, folder: Path) -> None:
        del folder
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._to = probe.getsockname()
        self.spelling = f"udpin:127.0.0.1:{self._to[1]}"
        self.mend()

    def send(self, frame: bytes) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto(frame, self._to)

    def cut(self) -> None:
        self._socket.close()

    def mend(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def broken(name: str, happened: str, make: type[SerialCable] | type[TcpCable] | type[UdpCable]) -> LinkOutcome:
    """Send, cut, mend; give the time from the mend to the next sample, and what was lost around it."""
    with tempfile.TemporaryDirectory() as folder:
        cable = make(Path(folder))
        clock = MonotonicClock()
        pilot = MavlinkAutopilot([open_link(cable.spelling, clock)], load_airframe("nadir-2m"), Settings(), clock)
        try:
            sent, heard = _fly(cable, pilot)
        finally:
            pilot.close()
            cable.cut()
    began_s = sent[0][1]
    mended_s = began_s + BEFORE_S + BROKEN_S
    arrived = {number for number, _ in heard}
    recovery_s = min((at_s for _, at_s in heard if at_s >= mended_s), default=float("inf")) - mended_s
    lost = sum(number not in arrived for number, at_s in sent if not began_s + BEFORE_S <= at_s < mended_s + recovery_s)
    wrong = len(arrived - {number for number, _ in sent})
    return LinkOutcome(name, happened, recovery_s, lost, wrong)


def _fly(cable: Cable, pilot: MavlinkAutopilot) -> tuple[list[tuple[int, float]], list[tuple[int, float]]]:
    """Numbers of the samples that were sent and that were heard, each with its time; a number is its stamp in us."""
    packer, sent, heard = mavlink.MAVLink(None, 1, 200), [], []
    began_s = time.monotonic()
    connected, next_s, done_s = True, began_s, None
    while done_s is None or time.monotonic() < done_s:
        now_s = time.monotonic()
        if connected and began_s + BEFORE_S <= now_s < began_s + BEFORE_S + BROKEN_S:
            connected = False
            cable.cut()
        elif not connected and now_s >= began_s + BEFORE_S + BROKEN_S:
            connected = True
            cable.mend()
        if now_s >= next_s:
            next_s += PERIOD_S
            number = len(sent) + 1
            sent.append((number, now_s))
            if connected:
                values = (0.0, 0.0, -9.8, 0.0, 0.0, 0.0)
                cable.send(mavlink.MAVLink_highres_imu_message(number, *values, *[0] * 7, 63).pack(packer))
        for record in pilot.poll(0.001):
            if isinstance(record, ImuBatch):
                heard += [(int(stamp) // 1000, time.monotonic()) for stamp in record.t_ns]
        again = heard and heard[-1][1] > began_s + BEFORE_S + BROKEN_S
        if done_s is None and (again or now_s > began_s + AFTER_S):
            done_s = now_s + 1.0
    return sent, heard


def signed(name: str) -> LinkOutcome:
    """Frames that must not come in over a signed link, among those that must."""
    ours = Ours()
    friend, thief = Other(), Other(key=OTHER, link=9)
    unsigned, late = Other(key=None), Other(timestamp=NOW - 61 * SECOND, link=7)
    taken = wanted = foreign = 0
    for k in range(100):
        good = friend.frame(k)
        bad = thief.frame(k) + unsigned.frame(k) + good + late.frame(k)
        old = mavlink.MAVLink_heartbeat_message(1, 3, 0, k, 4, 3).pack(mavlink.MAVLink(None, 3, 1), force_mavlink1=True)
        got = ours.take(good + bad + bytes(old))
        wanted += 1
        taken += got.startswith(good)
        foreign += len(got) > len(good)
    refused = ", ".join(f"{count} {reason}" for reason, count in sorted(ours.signing.refused.items()))
    return LinkOutcome(name, f"refused {refused}", 0.0, wanted - taken, foreign)


def killed(name: str) -> LinkOutcome:
    """The process that must never stall is killed; counted until its spare answers the ground station."""
    config = ServiceConfig(load_airframe("nadir-2m"), Settings(), ("udpin:127.0.0.1:0",), standby=True)
    cable = UdpCable(Path())
    cable.cut()
    config = dataclasses.replace(config, connections=(cable.spelling,))
    with Service(config) as service:
        vehicle = Vehicle(int(cable.spelling.rpartition(":")[2]))
        vehicle.until("PARAM_VALUE", lambda m: m.param_id == "TRG_RATE", 120.0, lambda: vehicle.read("TRG_RATE"))
        return LinkOutcome(name, "spare took over", killed_and_back(service, vehicle), None, 0)


def junk(name: str) -> LinkOutcome:
    """Seventeen sockets send bytes for two seconds; what the autopilot hears of all that is sent."""
    port = Port()
    try:
        pilot, strangers = port.talker(PILOT), [port.talker(66) for _ in range(17)]
        pilot.beat()
        port.run()
        sent, carry = [0], port.udp.send

        def send(data: bytes) -> bool:
            sent[0] += 1
            return carry(data)

        port.udp.send = send  # type: ignore[method-assign]
        pilot.heard()  # what came before
        heard = 0
        for _ in range(200):
            for talker in strangers:
                talker.send(b"x")
            pilot.beat()
            port.run(0.01)
            heard += pilot.heard()
        wrong = sum(talker.heard() > 0 for talker in strangers)
        return LinkOutcome(name, f"{len(port.udp.peers)} peer kept", 0.0, sent[0] - heard, wrong)
    finally:
        port.close()


def second_sender(name: str) -> LinkOutcome:
    """A second address sends samples under a node's id for two seconds."""
    port = Port()
    try:
        pilot, first, thief = port.talker(PILOT), port.talker(NODE), port.talker(NODE)
        pilot.beat()
        port.run()
        for number in range(800):
            first.sample(1_000_000 + 5000 * number, -9.8)
            if 200 <= number < 600:
                thief.sample(90_000_000 + 5000 * number, -3.0)
            port.run(0.01)
        warnings = [text for text in port.texts() if thief.where in text]
        taken = port.samples()
        return LinkOutcome(name, f"refused, told {len(warnings)} x by name", 0.0, 800 - taken[-9.8], taken[-3.0])
    finally:
        port.close()


def stray_autopilot(name: str) -> LinkOutcome:
    """One heartbeat of another vehicle comes before ours; from its end to the change."""
    choosing = Choosing()
    choosing.run(0.1, (77,))
    waited_s = 0.0
    while choosing.served != 1 and waited_s < AFTER_S:
        choosing.run(0.1, (1,) if round(waited_s * 10) % 10 == 0 else ())
        waited_s += 0.1
    return LinkOutcome(name, "the one that is there took over", waited_s, None, 0)


def full_disk(name: str) -> LinkOutcome:
    """The recorder finds no room; its producer must not wait, nor may an empty file stay."""
    with tempfile.TemporaryDirectory() as folder:
        said, waited_s = record_on_a_full_disk(Path(folder))
        files = len(list(Path(folder).iterdir()))
    return LinkOutcome(name, f"told {said} x, {files} files left", waited_s, None, 0)


def silencing(name: str, setting: str, value: float) -> LinkOutcome:
    """A setting that ends all ranges: from the first tracked second to the sentence that says why."""
    service = SimulatedService(
        build_flight(load_airframe("nadir-2m"), 6, 21.0), settings=Settings().replace(setting, value)
    )
    tape = service.fly(20.0)
    service.close()
    active = next(status for status in tape.of(ServiceStatus) if status.health is Health.ACTIVE)
    explanation = next(notice for notice in tape.of(Notice) if notice.text.startswith("no range"))
    waited_s = (explanation.at_host_ns - active.at_host_ns) * 1e-9
    return LinkOutcome(name, explanation.text, waited_s, None, sum(entry.trusted for entry in tape.of(CorrectedRange)))


def outcomes() -> Iterator[LinkOutcome]:
    """Strike with every one."""
    yield junk("one byte each from 17 UDP sockets, 2 s")
    yield second_sender("second sender of a node's id, 2 s")
    yield stray_autopilot("another autopilot's heartbeat came first")
    yield full_disk("disk full at the start")
    yield silencing("RNG_MIN 100 above the ground's 40 m (time until told)", "RNG_MIN", 100.0)
    yield silencing("TRG_POLICY 2 (time until told)", "TRG_POLICY", 2.0)
    yield broken("serial device unplugged, 2 s", "opened again by its name", SerialCable)
    yield broken("TCP connection lost, 2 s", "connected again", TcpCable)
    yield broken("UDP sender back on another port, 2 s", "new peer learned", UdpCable)
    yield killed("inertial process killed")
    yield signed("signed link: forged, replayed, stale, unsigned and MAVLink 1 frames")


def table(rows: list[LinkOutcome]) -> str:
    """The rows as Markdown."""
    head = (
        "| fault | what happened | recovery after its end | messages lost beside it | wrong samples |\n"
        "|---|---|---|---|---|\n"
    )
    lines = []
    for row in rows:
        lost = "not counted" if row.lost is None else str(row.lost)
        lines.append(f"| {row.name} | {row.happened} | {row.recovery_s:.2f} s | {lost} | {row.wrong} |")
    return head + "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(table(list(outcomes())))
