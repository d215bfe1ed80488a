"""The process behind the simulated cameras: pulses in, rendered frames out.

Every accepted pulse is an exposure at an exact instant. Rendering may lag, the instants do not move: shots wait in a
bounded queue, and when that is full the oldest that has not been begun is lost, both sides of it; its sequence numbers
are missing then, as with a real camera whose transfer cannot keep up.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import select
import signal
import socket
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.process import BaseProcess
from pathlib import Path

import cv2

from companion.lifetime import die_with_parent
from companion.params.airframe import Airframe
from companion.records import Side
from companion.sim.flight.truth import FlightTruth
from companion.sim.flight.worlds import ImageFaults
from companion.sim.vehicle.starting import opened
from companion.sim.vision.cameras import HEADER, MAGIC, PULSE, Shutters
from companion.sim.vision.renderer import PERFECT, ExposureInterval, Renderer
from companion.sim.vision.scene import Scene

QUEUE_SHOTS = 4  # at 5 a second the last of them is 0.8 s old: still inside the smoother's window (choice)
_READOUT_NS = 6_000_000  # chosen: a fast small sensor's; a slower one only delays what is matched
_IDLE_S = 0.05  # chosen: how late the process sees that it is to end
_START_S = 30.0  # chosen: a busy machine imports slowly


@dataclass(frozen=True, slots=True, eq=False)
class CameraServerConfig:
    """Scene that the server renders, and its address; picklable.

    ``airframe`` is the true one; at host time ``start_host_ns`` the truth's boot time is 0. ``line_path`` and
    ``frames_path`` are local sockets: datagrams with pulses, stream with frames.
    """

    airframe: Airframe
    truth: FlightTruth
    scene: Scene
    seed: int
    start_host_ns: int
    line_path: Path
    frames_path: Path
    queue_shots: int = QUEUE_SHOTS
    images: ImageFaults = PERFECT


@dataclass(frozen=True, slots=True)
class _Job:
    """One exposure that waits for its image; ``exposure`` is on the host clock."""

    side: Side
    shot: int
    exposure: ExposureInterval

    @property
    def ready_ns(self) -> int:
        """Time at which a camera would have read the image out."""
        return self.exposure.mid_boot_ns + self.exposure.exposure_ns // 2 + _READOUT_NS


class CameraServer:
    """The loop of the process. ``counters``: ``shots``, ``busy``, ``dropped``, ``outside``, ``sent``, ``unsent``."""

    def __init__(self, config: CameraServerConfig) -> None:
        cv2.setNumThreads(1)
        self.config = config
        self.counters: Counter[str] = Counter()
        self._shutters = Shutters(config.airframe, config.seed)
        self._renderer = Renderer(config.airframe, config.truth, config.scene, config.seed, config.images)
        self._line = _listening(socket.SOCK_DGRAM, config.line_path)
        self._door = _listening(socket.SOCK_STREAM, config.frames_path)
        self._client: socket.socket | None = None
        self._outgoing = memoryview(b"")
        self._jobs: deque[_Job] = deque()
        self._busy_until_ns = 0

    def step(self) -> None:
        """Take the pulses that have come, pass on what the client takes, then render at most one image."""
        sending = [self._client] if self._client is not None and self._outgoing else []
        due_s = (self._jobs[0].ready_ns - time.monotonic_ns()) * 1e-9 if self._jobs and not sending else _IDLE_S
        readable, writable, _ = select.select([self._line, self._door], sending, [], min(max(due_s, 0.0), _IDLE_S))
        if self._door in readable:
            self._welcome()
        elif writable:
            self._send()
        if self._line in readable:
            for edge_ns in self._pulses():
                self._accept(edge_ns)
        if self._jobs and not self._outgoing and self._jobs[0].ready_ns <= time.monotonic_ns():
            self._finish(self._jobs.popleft())

    def close(self) -> None:
        """Release the sockets."""
        for link in (self._line, self._door, self._client):
            if link is not None:
                link.close()
        for path in (self.config.line_path, self.config.frames_path):
            path.unlink(missing_ok=True)

    def _pulses(self) -> Iterator[int]:
        with contextlib.suppress(BlockingIOError):
            while True:
                data = self._line.recv(PULSE.size)
                if len(data) == PULSE.size:
                    yield PULSE.unpack(data)[1]

    def _accept(self, edge_ns: int) -> None:
        """Expose both cameras, unless they are still busy with the last shot."""
        if edge_ns < self._busy_until_ns:
            self.counters["busy"] += 1
            return
        shot = self.counters["shots"]
        jobs = [_Job(side, shot, self._shutters.exposure(side, edge_ns, shot)) for side in Side]
        self.counters["shots"] += 1
        self._busy_until_ns = max(job.ready_ns for job in jobs)
        waiting = [job.shot for job in self._jobs if job.side is Side.LEFT]  # of which neither image is rendered
        if len(waiting) >= self.config.queue_shots:
            self._jobs = deque(job for job in self._jobs if job.shot != waiting[0])
            self.counters["dropped"] += 1
        self._jobs.extend(jobs)

    def _finish(self, job: _Job) -> None:
        if self._client is None:
            self.counters["unsent"] += 1
            return
        boot = replace(job.exposure, mid_boot_ns=job.exposure.mid_boot_ns - self.config.start_host_ns)
        try:
            image = self._renderer.render(job.side, boot, job.shot)
        except ValueError:  # before take-off or after the flight there is nothing to see
            self.counters["outside"] += 1
            return
        exposure = job.exposure
        times = (exposure.mid_boot_ns, exposure.exposure_ns, exposure.row_time_ns)
        header = HEADER.pack(MAGIC, job.side, job.shot, *times, *image.shape)
        self._outgoing = memoryview(header + image.tobytes())
        self._send()

    def _send(self) -> None:
        """Pass on as much of the image as the client takes; a slow client holds up rendering, never the shutters."""
        assert self._client is not None
        try:
            self._outgoing = self._outgoing[self._client.send(self._outgoing) :]
        except BlockingIOError:
            return
        except OSError:
            self._drop_client()
            return
        if not self._outgoing:
            self.counters["sent"] += 1

    def _drop_client(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
        if self._outgoing:
            self.counters["unsent"] += 1
            self._outgoing = memoryview(b"")

    def _welcome(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:  # of several that have knocked, the last is the living one
                newcomer = self._door.accept()[0]
                self._drop_client()
                self._client = newcomer
                newcomer.setblocking(False)


def serve(config: CameraServerConfig) -> None:
    """Run until terminated."""
    die_with_parent()
    stop: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _frame: stop.append(number))
    parent = os.getppid()
    server = CameraServer(config)
    try:
        while not stop and os.getppid() == parent:
            server.step()
    finally:
        server.close()


def start_camera_server(config: CameraServerConfig) -> BaseProcess:
    """Start the process and return when its line and stream are open; end it with ``terminate()``.

    Raises
    ------
    DeviceError
        When it ends, or has not opened them after half a minute.
    """
    for path in (config.line_path, config.frames_path):
        path.unlink(missing_ok=True)
    process = multiprocessing.get_context("spawn").Process(
        target=serve, args=(config,), name="sim-cameras", daemon=True
    )
    return opened(process, config.frames_path, _START_S)


def _listening(kind: socket.SocketKind, path: Path) -> socket.socket:
    path.unlink(missing_ok=True)
    link = socket.socket(socket.AF_UNIX, kind)
    link.bind(str(path))
    link.setblocking(False)
    if kind == socket.SOCK_STREAM:
        link.listen(4)
    return link
