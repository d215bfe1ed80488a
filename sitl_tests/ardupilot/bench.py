"""Everything of one run together: physics, autopilot, ground station, cameras, service; ended in order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest

from companion.params.airframe import Airframe
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.vision.camera_server import CameraServerConfig
from companion.sim.vision.scene import ground_scene, obstacle_scene
from sitl_tests.ardupilot.eyes import NOT_YET_NS, open_eyes
from sitl_tests.ardupilot.physics import PhysicsOptions, start_physics
from sitl_tests.ardupilot.station import COMPANION, Station
from sitl_tests.ardupilot.vehicle import Ports, Vehicle, keep_pace

ROOT = Path(__file__).resolve().parents[2]
_SPANWISE = str(Path(sys.executable).with_name("spanwise"))
_START_S, _SERVICE_S = 60.0, 180.0
_END_S = 15.0


@dataclass
class Run:
    """The flight under way. Use as a context manager.

    ``start_ns`` is the host time at which the autopilot's boot clock was 0, ``flight_ns`` that of the flight's first
    instant, which :meth:`launch` sets.
    """

    executable: Path
    folder: Path
    airframe: Airframe
    airframe_name: str
    parameters: Mapping[str, float]
    seed: int = 1
    duration_s: float = 5.0
    eyes: bool = False
    ports: Ports = field(default_factory=Ports.free)
    start_ns: int = 0
    flight_ns: int = 0
    report: dict[str, Any] = field(default_factory=dict)

    def __enter__(self) -> Run:
        self.folder.mkdir(parents=True, exist_ok=True)
        self._processes: list[BaseProcess] = []
        self._services: list[subprocess.Popen[bytes]] = []
        line = self.folder / "line" if self.eyes else None
        nodes = f"udpout:127.0.0.1:{self.ports.nodes}"
        options = PhysicsOptions(self.airframe, self.seed, self.duration_s, self.ports.physics, nodes, line)
        physics, self._control = start_physics(options)
        self._processes.append(physics)
        if physics.pid is not None:
            keep_pace(physics.pid)
        self.station = Station(self.ports.station)
        self.vehicle = Vehicle(self.executable, self.folder, self.ports, self.parameters)
        try:
            self._await_start()
            if self.eyes:
                self._open_eyes()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _await_start(self) -> None:
        ends = time.monotonic() + _START_S
        while not self._control.poll(0.1):
            self.vehicle.check()
            if time.monotonic() > ends:
                load = os.getloadavg()[0]
                pytest.skip(
                    f"ArduPilot did not keep pace with the physics for a second in {_START_S:g} s: load {load:.1f}"
                )
        kind, self.start_ns = self._control.recv()
        assert kind == "started"
        heartbeat = self.station.wait("HEARTBEAT", component=1, seconds=_START_S)
        self.vehicle.check()
        assert heartbeat is not None, "no heartbeat of the autopilot on its first link"

    def _open_eyes(self) -> None:
        self.flight: Flight = build_flight(self.airframe, self.seed, self.duration_s)
        down = self.airframe.looks_down
        scene = ground_scene(self.seed) if down else obstacle_scene(self.flight.truth, self.seed)
        truth, actual = self.flight.truth, self.flight.real.actual
        line, frames = self.folder / "line", self.folder / "frames"
        config = CameraServerConfig(actual, truth, scene, self.seed, NOT_YET_NS, line, frames)
        process, self._eyes = open_eyes(config, _START_S)
        self._processes.append(process)

    def launch(self) -> None:
        """Begin the run-up; the flight itself begins a few seconds later, at ``flight_ns``."""
        self._control.send("launch")
        assert self._control.poll(_END_S), "the physics does not answer"
        kind, self.flight_ns = self._control.recv()
        assert kind == "flying"
        if self.eyes:
            self._eyes.send(self.flight_ns)

    # ------------------------------------------------------------------------------------------ the service

    @property
    def recording(self) -> Path:
        """Where the service records."""
        return self.folder / "flight.mcap"

    def service(self, *settings: str) -> subprocess.Popen[bytes]:
        """Start ``spanwise run`` on the autopilot's second link and the nodes' own one."""
        seeing = [sys.executable, "-m", "sitl_tests.ardupilot.camera_service", "--frames", str(self.folder / "frames")]
        command = [*seeing, "--trigger", "mavlink"] if self.eyes else [_SPANWISE, "run"]
        command += [
            *self.links, "--airframe", self.airframe_name, "--record", str(self.recording),
            "--parameters", str(self.folder / "kept.parameters"), "--plain",
        ]  # fmt: skip
        for setting in settings:
            command += ["--set", setting]
        with (self.folder / "service.txt").open("wb") as out:
            process = subprocess.Popen(
                command, cwd=ROOT, stdout=out, stderr=subprocess.STDOUT, start_new_session=True, env=_environment()
            )
        self._services.append(process)
        return process

    def await_service(self, ready_s: float = 0.0) -> None:
        """Wait until the ground station hears the service, and so much longer; a busy machine is slow to start it."""
        heard = self.station.wait("HEARTBEAT", component=COMPANION, seconds=_SERVICE_S)
        self.vehicle.check()
        assert heard is not None, f"the service is not heard: {(self.folder / 'service.txt').read_text()[-2000:]}"
        self.sleep_until(time.monotonic_ns() + round(ready_s * 1e9))

    @property
    def links(self) -> list[str]:
        """``--connect`` options of service and doctor."""
        return [
            "--connect", f"udpin:127.0.0.1:{self.ports.service}", "--connect", f"udpin:127.0.0.1:{self.ports.nodes}",
        ]  # fmt: skip

    def spanwise(self, *arguments: str, seconds: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run another ``spanwise`` command to its end."""
        return subprocess.run(
            [_SPANWISE, *arguments],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
            env=_environment(),
        )

    def end_service(self) -> None:
        """Stop the service as Ctrl-C does, so that its recording is finished."""
        for process in self._services:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self._services:
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def sleep_until(self, host_ns: int) -> None:
        """Wait, and look after the autopilot meanwhile."""
        while time.monotonic_ns() < host_ns:
            self.vehicle.check()
            time.sleep(min(0.2, max(host_ns - time.monotonic_ns(), 0) * 1e-9))

    def __exit__(self, *_: object) -> None:
        self.end_service()
        self.vehicle.end()
        self.report = _report(self._control)
        for process in self._processes:
            process.terminate()
            process.join()
        self.station.close()


def _report(control: Connection) -> dict[str, Any]:
    control.send("stop")
    while control.poll(_END_S):
        kind, content = control.recv()
        if kind == "report":
            return dict(content)
    return {}


def _environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
