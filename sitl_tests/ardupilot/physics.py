"""The process that ArduPilot's ``--model JSON`` talks to: physics frames in real time, wing nodes, the cameras' line.

ArduPilot sends its servo outputs once a frame and waits for the sensors of the next. Frames are due every 1/1200 s of
the host's monotonic clock, and what a stall delays is made up for at once: its boot time never drifts from ours. (While
the autopilot starts up it stalls for seconds; only when it has kept pace for one is its clock pinned to the host's.) A
rising edge on a camera's servo is passed on to the simulated cameras' trigger line, with the instant of its arrival.
"""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import socket
import struct
import time
from array import array
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import DeviceError
from companion.params.airframe import Airframe
from companion.records import PLAN_UNKNOWN
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.perturb import TrueClock
from companion.sim.flight.sensors import SensorStream
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.nodes import WingNode
from companion.sim.vehicle.world import VehicleLink
from companion.sim.vision.cameras import SimTriggerLine
from sitl_tests.ardupilot.rail import LAUNCH_S, RATE_HZ, flight_motion, launch_motion, lines, stamp_of
from sitl_tests.ardupilot.steered import SteeredFrames

SERVOS_16, SERVOS_32 = 18458, 29569
SERVO_HEAD = struct.Struct("<HHI")
CAMERA_OFF_PWM, CAMERA_ON_PWM = 1100, 1300
CAMERA_CHANNELS = (9, 10)
_MIDDLE_PWM = 1200
_PATIENCE_S = 0.002
_SPIN_NS = 100_000
_NODE_TURN_NS = 1_000_000
_LATE_NS, _STEADY_NS = 100_000_000, 1_000_000_000
_LISTEN_NS = 50_000_000


@dataclass(frozen=True, slots=True)
class PhysicsOptions:
    """The flight, and who is told of it; picklable.

    Attributes
    ----------
    nodes : str
        Where the wing nodes speak, ``udpout:host:port``; empty for an aircraft whose nodes are off.
    trigger_line : Path, optional
        The simulated cameras' line.
    steered : bool
        The autopilot's surfaces and motor fly the flexible aeroplane from standing on its wheels; otherwise it is
        carried along a prescribed flight. Wing nodes and cameras belong to the prescribed flight.
    """

    airframe: Airframe
    seed: int
    duration_s: float
    port: int
    nodes: str = ""
    trigger_line: Path | None = None
    steered: bool = False


class Frames:
    """The JSON line of every frame: hanging still until the launch, then the flight; at its end it stands still."""

    def __init__(self, flight: Flight, duration_s: float) -> None:
        self._moving = lines(launch_motion(flight.truth)) + lines(flight_motion(flight.truth, duration_s))
        self.launch_frame = 1 << 62

    def steer(self, servos: tuple[int, ...]) -> None:
        """Surfaces do not steer what is carried."""

    def line(self, frame: int) -> bytes:
        """Sensors of one frame."""
        row = min(max(frame - self.launch_frame, 0), len(self._moving) - 1)
        return stamp_of(frame) + self._moving[row]


class Nodes:
    """The wing nodes on a link of their own: until the flight they beat and keep time, then they stream.

    A node's clock shows ``clock.from_boot(now - start)``, ``start`` being the instant at which the physics began.
    """

    def __init__(self, flight: Flight, connection: str, start_ns: int) -> None:
        self._clocks = flight.real.clocks
        self._streams = [stream for _, stream in sorted(flight.nodes.items())]
        self._nodes = [WingNode(_silent(s), self._clocks[s.clock], Faults()) for s in self._streams]
        self._link = VehicleLink(connection)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._zero_ns = start_ns
        self._turned_ns = 0

    def fly(self, flight_ns: int) -> None:
        """Stream from a host instant on; clocks and sequence numbers go on as they were."""
        old, self._nodes = self._nodes, []
        for before, stream in zip(old, self._streams, strict=True):
            clock = self._clocks[stream.clock]
            begun = TrueClock(clock.from_boot(flight_ns - self._zero_ns), clock.skew_ppm)
            stamps = stream.stamp_ns + (begun.epoch_ns - clock.epoch_ns)
            node = WingNode(dataclasses.replace(stream, stamp_ns=stamps), begun, Faults())
            node.sender = before.sender
            self._nodes.append(node)
        self._zero_ns = flight_ns

    def turn(self, now_ns: int) -> None:
        """Answer and send what is due."""
        if now_ns - self._turned_ns < _NODE_TURN_NS:
            return
        self._turned_ns = now_ns
        data = self._link.drain()
        for message in (self._parser.parse_buffer(data) or []) if data else []:
            for node in self._nodes:
                node.receive(message, now_ns - self._zero_ns)
        frames: list[bytes] = []
        for node in self._nodes:
            frames += node.advance(now_ns - self._zero_ns)
        self._link.send(frames)


def _silent(stream: SensorStream) -> SensorStream:
    """The stream of a sensor that has not said anything yet."""
    return dataclasses.replace(
        stream, sent_boot_ns=stream.sent_boot_ns[:0], stamp_ns=stream.stamp_ns[:0], values=stream.values[:0]
    )


@dataclass(slots=True)
class Shutter:
    """Watches the camera servos; ``edges`` are (host ns, channel) of every rising one."""

    line: SimTriggerLine | None
    edges: list[tuple[int, int]]
    high: dict[int, bool]

    def watch(self, servos: tuple[int, ...], now_ns: int) -> None:
        """Compare the outputs with those before; the first camera's edge exposes both, as their wire does."""
        for channel in CAMERA_CHANNELS:
            high = servos[channel - 1] > _MIDDLE_PWM
            if high and not self.high.get(channel, True):
                self.edges.append((now_ns, channel))
                if channel == CAMERA_CHANNELS[0] and self.line is not None:
                    with contextlib.suppress(DeviceError):
                        self.line.pulse(PLAN_UNKNOWN, now_ns)
            self.high[channel] = high


def servo_outputs(data: bytes) -> tuple[int, ...] | None:
    """PWM of the outputs in one packet, or None for what is no servo packet."""
    if len(data) < SERVO_HEAD.size:
        return None
    magic, _, _ = SERVO_HEAD.unpack_from(data)
    count = {SERVOS_16: 16, SERVOS_32: 32}.get(magic, 0)
    if not count or len(data) != SERVO_HEAD.size + 2 * count:
        return None
    return struct.unpack_from(f"<{count}H", data, SERVO_HEAD.size)


class Physics:
    """The loop of the process."""

    def __init__(self, options: PhysicsOptions) -> None:
        self.flight = build_flight(options.airframe, options.seed, options.duration_s)
        self._options = options
        self._frames: Frames | SteeredFrames = Frames(self.flight, options.duration_s)
        if options.steered:
            self._frames = SteeredFrames(options.airframe)
        self._nodes: Nodes | None = None
        line = None if options.trigger_line is None else SimTriggerLine(options.trigger_line)
        self._shutter = Shutter(line, [], {})
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", options.port))
        self._socket.settimeout(_PATIENCE_S)
        self.start_ns = 0
        self.flight_ns = 0
        self.pinned = False
        self._late_host_ns = 0
        self._waiting = False
        self.sent_ns = array("q")

    def launch(self) -> None:
        """Begin the run-up with the next frame, and let the nodes stream from the flight's first instant on."""
        launch_frame = len(self.sent_ns)
        if isinstance(self._frames, Frames):
            self._frames.launch_frame = launch_frame
        first = launch_frame + round(LAUNCH_S * RATE_HZ)
        self.flight_ns = self.start_ns + first * 1_000_000_000 // RATE_HZ
        self._waiting = True

    def turn(self) -> None:
        """Take the servos of one frame and give the sensors of the next when they are due."""
        data, peer = b"", ("", 0)
        with contextlib.suppress(TimeoutError, ConnectionRefusedError):
            data, peer = self._socket.recvfrom(256)
        now_ns = time.monotonic_ns()
        servos = servo_outputs(data)
        if servos is not None:
            self._shutter.watch(servos, now_ns)
            self._frames.steer(servos)
            self._pin(now_ns)
        if self._nodes is not None:
            if self._waiting and now_ns >= self.flight_ns:
                self._waiting = False
                self._nodes.fly(self.flight_ns)
            self._nodes.turn(now_ns)
        if servos is not None:
            self._answer(peer)

    def _pin(self, now_ns: int) -> None:
        """Until the autopilot keeps pace, let boot time begin so that the frame asked for now is due now."""
        if self.pinned:
            return
        behind_ns = now_ns - self.start_ns - len(self.sent_ns) * 1_000_000_000 // RATE_HZ
        if behind_ns > _LATE_NS:
            self.start_ns += behind_ns
            self._late_host_ns = now_ns
        self.pinned = now_ns - self._late_host_ns > _STEADY_NS
        if self.pinned and self._options.nodes:
            self._nodes = Nodes(self.flight, self._options.nodes, self.start_ns)

    def _answer(self, peer: tuple[str, int]) -> None:
        frame = len(self.sent_ns)
        due_ns = self.start_ns + frame * 1_000_000_000 // RATE_HZ
        wait_ns = due_ns - time.monotonic_ns()
        if wait_ns > _SPIN_NS:
            time.sleep((wait_ns - _SPIN_NS) * 1e-9)
        line = self._frames.line(frame)
        with contextlib.suppress(ConnectionRefusedError):
            self._socket.sendto(line, peer)
        self.sent_ns.append(time.monotonic_ns())

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def report(self) -> dict[str, Any]:
        """Course of a flight, as plain values."""
        return {
            "start_ns": self.start_ns,
            "flight_ns": self.flight_ns,
            "sent_ns": self.sent_ns.tobytes(),
            "edges": self._shutter.edges,
        }


def serve(options: PhysicsOptions, control: Connection) -> None:
    """Entry of the process: launch when told to, run until told to stop, then report."""
    physics = Physics(options)
    control.send(("ready", None))
    started, listened_ns = False, 0
    while True:
        now_ns = time.monotonic_ns()
        if now_ns - listened_ns > _LISTEN_NS:
            listened_ns = now_ns
            if control.poll(0):
                if control.recv() != "launch":
                    break
                physics.launch()
                control.send(("flying", physics.flight_ns))
        physics.turn()
        if physics.pinned and not started:
            started = True
            control.send(("started", physics.start_ns))
    control.send(("report", physics.report()))


def start_physics(options: PhysicsOptions) -> tuple[BaseProcess, Connection]:
    """Start the process; its port is open when this returns."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=serve, args=(options, theirs), name="sim-physics", daemon=True)
    process.start()
    kind, _ = ours.recv()
    assert kind == "ready"
    return process, ours
