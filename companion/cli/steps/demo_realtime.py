"""The demo in real time: the live service's processes, a simulated vehicle beside them, sockets in between.

What comes out depends on how fast the machine is, and differs from run to run as any live service's does.
"""

from __future__ import annotations

import functools
import multiprocessing
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from companion.cli.steps.simulated_devices import frames_path, line_path
from companion.cli.terminal.run_loop import run_service
from companion.cli.terminal.status_view import View
from companion.cli.vehicle import open_cameras
from companion.errors import DeviceError
from companion.service.config import ServiceConfig
from companion.service.wiring import Service
from companion.sim.flight.flight import Flight
from companion.sim.vehicle.world import WorldOptions, serve_new
from companion.sim.vision.cameras import SimCameraPair, SimTriggerLine
from companion.sim.vision.scene import Scene
from companion.sim.vision.scenery import scene_of

_SETTLE_S = 1.5  # chosen: the last shots get through the smoother's lag and the recorder
_START_S = 300.0  # a machine may be busy (choice)


@dataclass(slots=True)
class SimulatedVehicle:
    """The simulated side: the flight, its processes, and what they report."""

    flight: Flight
    scene: Scene
    control: Connection
    folder: Path
    aircraft: BaseProcess
    start_host_ns: int = 0
    report: dict[str, Any] = field(default_factory=dict)
    cameras: BaseProcess | None = None
    over_s: float | None = None

    def ended(self) -> bool:
        """Tend the processes; True a little after the flight, so that the last shots get through the smoother's lag.

        Raises
        ------
        DeviceError
            The aircraft's process has ended without a report.
        """
        alive = self.aircraft.is_alive()
        while self.control.poll(0):
            kind, content = self.control.recv()
            if kind == "started":
                self.start_host_ns = content
                self.cameras = open_cameras(self.flight, self.scene, self.folder, content)
            else:
                self.report, self.over_s = content, time.monotonic()
        if not alive and self.over_s is None:
            raise DeviceError(f"the simulated aircraft's process has ended ({self.aircraft.exitcode})")
        return self.over_s is not None and time.monotonic() - self.over_s > _SETTLE_S


def fly_in_real_time(config: ServiceConfig, flight: Flight, view: View, *, live: bool) -> tuple[int, dict[str, Any]]:
    """Fly with the live service; give the host time of boot time 0, and what the vehicle reports."""
    port = _free_port()
    with tempfile.TemporaryDirectory(prefix="spanwise-") as folder, _vehicle(flight, port, Path(folder)) as vehicle:
        config = replace(
            config,
            connections=(f"udpin:127.0.0.1:{port}",),
            cameras=functools.partial(SimCameraPair, frames_path(Path(folder))),
            trigger=functools.partial(SimTriggerLine, line_path(Path(folder))),
        )
        run_service(Service(config), view, vehicle.ended, live=live)
    return vehicle.start_host_ns, vehicle.report


@contextmanager
def _vehicle(flight: Flight, port: int, folder: Path) -> Iterator[SimulatedVehicle]:
    """Start autopilot and wing nodes; they wait for the service before they fly."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    waiting = WorldOptions(connection=f"udpout:127.0.0.1:{port}", wait_s=_START_S)
    world = spawn.Process(
        target=serve_new,
        args=(flight.airframe, flight.seed, flight.duration_s, flight.world, waiting, theirs),
        name="sim-world",
    )
    world.start()
    vehicle = SimulatedVehicle(flight, scene_of(flight), ours, folder, world)
    try:
        yield vehicle
    finally:
        for process in (vehicle.cameras, world):
            if process is not None:
                process.terminate()
                process.join()


def _free_port() -> int:
    """A UDP port that nobody listens on now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
