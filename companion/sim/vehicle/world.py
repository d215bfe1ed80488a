"""The simulated vehicle in real time: autopilot and wing nodes behind one UDP socket, in a process of its own."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import DeviceError, LinkError
from companion.lifetime import die_with_parent
from companion.params.airframe import Airframe
from companion.params.links import LinkKind, parse_link
from companion.records import PLAN_UNKNOWN
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.worlds import Conditions
from companion.sim.vehicle.autopilot import SimAutopilot, Trigger
from companion.sim.vehicle.command_protocol import CommandProtocol
from companion.sim.vehicle.faults import Faults, Wire
from companion.sim.vehicle.nodes import WingNode
from companion.sim.vehicle.px4 import SimPx4
from companion.sim.vehicle.routing import Port
from companion.sim.vision.cameras import SimTriggerLine

_DATAGRAM = 1400  # bytes that fit Ethernet's 1500 beside the headers (derived)
_WAKE_NS = 1_000_000  # chosen: finer than the autopilot's 400 Hz loop


class Control(Protocol):
    """The parent's end of a pipe (:func:`multiprocessing.Pipe`)."""

    def send(self, obj: Any, /) -> None:
        """Pass a message on."""
        ...

    def poll(self, timeout: float = 0.0, /) -> bool:
        """Tell whether a message waits."""
        ...

    def recv(self) -> Any:
        """Take a message."""
        ...


@dataclass(frozen=True, slots=True)
class WorldOptions:
    """How to serve a flight.

    ``connection`` is ``udpout:host:port`` (the companion listens there) or ``udpin:host:port`` (it speaks first).
    ``speed`` is flight seconds per real second; clocks can only be synced at 1. The flight starts after the companion's
    first datagram or ``wait_s``, while heartbeats go out, or at ``start_host_ns`` where other processes must know the
    start beforehand (0: when all is ready). ``parameters`` of the autopilot differ from a good set-up.
    IMAGE_START_CAPTURE pulses ``trigger_line``, the simulated cameras'. With ``pilot_height_m`` the vehicle flies
    as a ground station orders (:mod:`companion.sim.vehicle.command_protocol`), from this height (0: on the ground,
    disarmed), instead of the prescribed path. With ``px4`` the autopilot behaves as PX4 does on the link
    (:mod:`companion.sim.vehicle.px4`), not as ArduPilot.
    """

    connection: str = "udpout:127.0.0.1:14550"
    speed: float = 1.0
    wait_s: float = 0.0
    faults: Faults = field(default_factory=Faults)
    parameters: Mapping[str, float] = field(default_factory=dict)
    start_host_ns: int = 0
    trigger_line: Path | None = None
    pilot_height_m: float | None = None
    px4: bool = False


class VehicleLink:
    """A UDP socket that remembers its peer."""

    def __init__(self, connection: str) -> None:
        address = parse_link(connection)
        if address.kind not in (LinkKind.UDP_LISTEN, LinkKind.UDP_CALL):
            raise LinkError(f"the simulated vehicle speaks udpin:host:port or udpout:host:port, not '{connection}'")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        try:
            if address.kind is LinkKind.UDP_LISTEN:
                self._socket.bind((address.host, address.port))
            else:
                self._socket.bind(("", 0))
                ends = socket.getaddrinfo(address.host, address.port, socket.AF_INET, socket.SOCK_DGRAM)
                self._peer = str(ends[0][4][0]), address.port
        except (OSError, UnicodeError) as error:
            self._socket.close()
            said = error.strerror if isinstance(error, OSError) else "this is no name of a host"
            raise LinkError(f"cannot open {connection}: {said}; give another HOST:PORT") from error

    def send(self, frames: list[bytes]) -> None:
        """Send frames in as few datagrams as fit; what nobody takes is lost, as on any UDP link."""
        if self._peer is None or not frames:
            return
        block = b""
        for frame in frames:
            if block and len(block) + len(frame) > _DATAGRAM:
                self._put(block)
                block = b""
            block += frame
        self._put(block)

    def _put(self, block: bytes) -> None:
        with contextlib.suppress(OSError):  # also a network that is gone, and comes again
            self._socket.sendto(block, self._peer or ("", 0))

    def drain(self) -> bytes:
        """Everything that has arrived."""
        blocks: list[bytes] = []
        while True:
            try:
                data, self._peer = self._socket.recvfrom(65535)
            except OSError:
                return b"".join(blocks)
            blocks.append(data)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class World:
    """Autopilot and nodes of one flight on one link; :meth:`run_once` is one pass of the loop."""

    def __init__(self, flight: Flight, options: WorldOptions, link: Port, on_trigger: Trigger | None = None) -> None:
        faults = options.faults
        self.flight = flight
        protocol = None if options.pilot_height_m is None else CommandProtocol(options.pilot_height_m, options.speed)
        autopilot = SimPx4 if options.px4 else SimAutopilot
        self.autopilot = autopilot(flight, faults, options.parameters, on_trigger, protocol)
        self.nodes = [
            WingNode(stream, flight.real.clocks[stream.clock], faults) for _, stream in sorted(flight.nodes.items())
        ]
        self._link = link
        self._wire = Wire(faults, flight.generator("wire"))
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    def run_once(self, now_boot_ns: int, host_ns: int) -> None:
        """Take in what arrived, and send what is due."""
        for message in self._arrived():
            self.autopilot.receive(message, now_boot_ns, host_ns)
            for node in self.nodes:
                node.receive(message, now_boot_ns)
        frames = self.autopilot.advance(now_boot_ns)
        for node in self.nodes:
            frames += node.advance(now_boot_ns)
        self._link.send(self._wire.carry(frames, now_boot_ns))

    def heard(self) -> bool:
        """Whether the companion has said anything yet; heartbeats go out while it is waited for."""
        self._link.send([self.autopilot.greeting(), *(node.greeting() for node in self.nodes)])
        return bool(self._link.drain())

    def report(self) -> dict[str, Any]:
        """Companion's traffic as the vehicle received it, in plain values."""
        received = self.autopilot.received
        sent = {str(self.autopilot.sender.component): dict(self.autopilot.sender.sent)}
        sent.update({str(node.component): dict(node.sender.sent) for node in self.nodes})
        return {
            "received": dict(received.counts),
            "ranges": [asdict(entry) for entry in received.ranges],
            "ranges_used": sum(entry.used for entry in received.ranges),
            "range_timeouts": received.timeouts,
            "range_alive": received.has_range_data,
            "problems": list(received.problems),
            "named_values": dict(received.named),
            "heartbeat_states": list(received.states),
            "statustexts": list(received.texts),
            "commands": list(self.autopilot.commands),
            "granted_ms": dict(self.autopilot.granted),
            "sent": sent,
            "lost": self._wire.lost,
        }

    def _arrived(self) -> list[Any]:
        data = self._link.drain()
        if not data:
            return []
        messages = self._parser.parse_buffer(data) or []
        return [m for m in messages if m.get_type() != "BAD_DATA" and not self._wire.drops()]


def serve(
    flight: Flight, options: WorldOptions, control: Control | None = None, link: Port | None = None
) -> dict[str, Any]:
    """Play a flight in real time until it ends or the control says anything.

    ``link`` stands in for the connection of the options. Through ``control`` go ``("started", host monotonic ns of boot
    time 0)`` and at the end ``("report", report)``.

    Returns :meth:`World.report`, with ``start_host_ns``, ``flown_s``, ``cpu_s`` and how late the loop woke (ms).
    """
    link = link or VehicleLink(options.connection)
    try:
        world = World(flight, options, link)
        _await_companion(world, options.wait_s)
        start_ns = options.start_host_ns or time.monotonic_ns() + 20_000_000
        if options.trigger_line is not None:
            world.autopilot.on_trigger = _pulses(options.trigger_line, start_ns, options.speed)
        if control is not None:
            control.send(("started", start_ns))
        report = _play(world, options.speed, start_ns, control)
    finally:
        link.close()
    if control is not None:
        control.send(("report", report))
    return report


def serve_new(
    airframe: Airframe, seed: int, duration_s: float, conditions: Conditions, options: WorldOptions, control: Control
) -> None:
    """Entry of a process of its own: build the flight from its seed and serve it."""
    die_with_parent()
    serve(build_flight(airframe, seed, duration_s, world=conditions), options, control)


def _pulses(path: Path, start_ns: int, speed: float) -> Trigger:
    """Pulls the cameras' line at a boot time; a line that nobody watches is no reason to fall out of the sky."""
    line = SimTriggerLine(path)

    def pulse(boot_ns: int) -> None:
        with contextlib.suppress(DeviceError):
            line.pulse(PLAN_UNKNOWN, start_ns + round(boot_ns / speed))

    return pulse


def _await_companion(world: World, wait_s: float) -> None:
    for _ in range(round(wait_s / 0.1)):
        if world.heard():
            return
        time.sleep(0.1)


def _play(world: World, speed: float, start_ns: int, control: Control | None) -> dict[str, Any]:
    end_ns = round(world.flight.duration_s * 1e9)
    cpu_s = time.process_time()
    late: list[int] = []
    target = start_ns
    boot_ns = 0
    while boot_ns < end_ns:
        now = time.monotonic_ns()
        if now < target:
            time.sleep((target - now) * 1e-9)
            now = time.monotonic_ns()
        late.append(now - target)
        boot_ns = min(int((now - start_ns) * speed), end_ns)
        world.run_once(boot_ns, now)
        # after a stall the beats that were missed are not made up for one by one
        target = max(target + _WAKE_NS, now - 10 * _WAKE_NS)
        if control is not None and len(late) % 64 == 0 and control.poll(0):
            control.recv()
            break
    median, p99, worst = (np.percentile(late, [50, 99, 100]) * 1e-6).tolist()
    report = world.report()
    report.update(
        start_host_ns=start_ns,
        flown_s=boot_ns * 1e-9,
        cpu_s=time.process_time() - cpu_s,
        wake_late_ms={"median": median, "p99": p99, "max": worst},
    )
    return report
