"""The simulated camera pair, its trigger line and its shutter: the ports' other implementations.

A pulse on the line is a datagram on a local socket that carries the instant of the edge, so that a busy camera process
sees it as a camera's hardware does, not when its scheduler gets round to it. Frames come over a local stream.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.errors import DeviceError
from companion.params.airframe import Airframe, Camera
from companion.records import PLAN_UNKNOWN, ClockName, Frame, FramePair, Shot, Side, TriggerPlan
from companion.sim.vision.renderer import ExposureInterval, Renderer

PULSE = struct.Struct("<qq")
"""plan id, instant of the edge (host ns)."""

HEADER = struct.Struct("<IIqqqqII")
"""magic, side, sequence, mid-exposure (host ns), exposure ns, row time ns, rows, columns; then the pixels."""

MAGIC = 0x53574652  # "SWFR" in ASCII (convention)

_LATENCY_JITTER_S = 0.00015  # chosen: a path that repeats well, and whose rest the service has to bear
# chosen: five minutes, for a machine that renders its first images under load
_CONNECT_TRIES, _CONNECT_WAIT_S = 3000, 0.1
_READ_BYTES = 1 << 20  # chosen: an image of 640 x 480 in one read


class Shutters:
    """From an edge on the line to the exposures of both cameras: latency of each, and jitter of every shot.

    Deterministic from the seed and the number of the shot.
    """

    def __init__(self, airframe: Airframe, seed: int) -> None:
        self.cameras: tuple[Camera, Camera] = airframe.camera_pair
        self.seed = seed

    def exposure(self, side: Side, edge_ns: int, shot: int) -> ExposureInterval:
        """The exposure that an edge starts, on the clock of the edge (``mid_boot_ns`` included)."""
        camera = self.cameras[side]
        jitter_s = _LATENCY_JITTER_S * float(np.random.default_rng([self.seed, side, shot, 0x5407]).standard_normal())
        latency_s = max(camera.latency_s.value + jitter_s, 0.0)
        exposure_ns, row_ns = round(camera.exposure_s * 1e9), round(camera.row_time_s * 1e9)
        start_ns = edge_ns + round(latency_s * 1e9)
        middle_row_ns = round(row_ns * 0.5 * (camera.height_px - 1))
        return ExposureInterval(start_ns + middle_row_ns + exposure_ns // 2, exposure_ns, row_ns)


def render_pair(renderer: Renderer, shutters: Shutters, edge_boot_ns: int, shot: int) -> FramePair:
    """Both images of one edge without any socket, stamped on the boot clock: for replay and scoring."""
    left, right = (render_frame(renderer, shutters, side, edge_boot_ns, shot) for side in Side)
    return FramePair(shot, left, right)


def render_frame(renderer: Renderer, shutters: Shutters, side: Side, edge_boot_ns: int, shot: int) -> Frame:
    """One of these images."""
    exposure = shutters.exposure(side, edge_boot_ns, shot)
    image, clock = renderer.render(side, exposure, shot), ClockName.BOOT
    times = (exposure.mid_boot_ns, exposure.exposure_ns, exposure.row_time_ns)
    return Frame(side, shot, clock, *times, PLAN_UNKNOWN, image)


class SimTriggerLine:
    """Implements :class:`companion.ports.Trigger`: pulls the line that the simulated cameras watch."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def fire(self, plan: TriggerPlan) -> Shot:
        """Pull the line now.

        Raises
        ------
        DeviceError
            When no camera listens.
        """
        edge_ns = time.monotonic_ns()
        self.pulse(plan.plan_id, edge_ns)
        return Shot(plan.plan_id, plan.command_host_ns, edge_ns)

    def pulse(self, plan_id: int, edge_host_ns: int) -> None:
        """Pull the line at a stated instant; errors as :meth:`fire`."""
        try:
            self._socket.sendto(PULSE.pack(plan_id, edge_host_ns), self._path)
        except OSError as error:
            raise DeviceError(f"no simulated camera listens at {self._path}: {error}") from error

    def close(self) -> None:
        """Release the line."""
        self._socket.close()


@dataclass(slots=True)
class _FrameStream:
    """Bytes of the frame stream that have not made a whole frame yet."""

    pending: bytearray

    def frames(self) -> Iterator[Frame]:
        """Cut off whole frames."""
        while len(self.pending) >= HEADER.size:
            magic, side, sequence, mid_ns, exposure_ns, row_ns, rows, columns = HEADER.unpack_from(self.pending)
            if magic != MAGIC:
                raise DeviceError("the simulated cameras' stream is out of step")
            end = HEADER.size + rows * columns
            if len(self.pending) < end:
                return
            pixels = np.frombuffer(bytes(self.pending[HEADER.size : end]), np.uint8).reshape(rows, columns)
            del self.pending[:end]
            yield Frame(Side(side), sequence, ClockName.HOST, mid_ns, exposure_ns, row_ns, PLAN_UNKNOWN, pixels)


class SimCameraPair:
    """Implements :class:`companion.ports.CameraPair` over the camera server's stream."""

    def __init__(self, path: Path) -> None:
        self._socket = _connected(str(path))
        self._stream = _FrameStream(bytearray())

    def poll(self, timeout_s: float) -> list[Frame]:
        """Frames that have arrived within the timeout.

        Raises
        ------
        DeviceError
            When the cameras are gone.
        """
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return []
        try:
            data = self._socket.recv(_READ_BYTES)
        except OSError as error:
            raise DeviceError(f"the simulated cameras are gone: {error}") from error
        if not data:
            raise DeviceError("the simulated cameras have closed the stream")
        self._stream.pending += data
        return list(self._stream.frames())

    def close(self) -> None:
        """Release the stream."""
        self._socket.close()


def _connected(path: str) -> socket.socket:
    """Connect, waiting five minutes: cameras open at take-off, and before a first one the estimator is compiled."""
    for attempt in range(_CONNECT_TRIES):
        link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            link.connect(path)
        except OSError as error:
            link.close()
            if attempt + 1 == _CONNECT_TRIES:
                raise DeviceError(f"no simulated cameras at {path}: {error}") from error
            time.sleep(_CONNECT_WAIT_S)
        else:
            return link
    raise AssertionError("unreachable")
