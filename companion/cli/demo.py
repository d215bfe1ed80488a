"""``spanwise demo``: a simulated aircraft speaks MAVLink to the live service; then its truth judges the flight."""

from __future__ import annotations

import argparse
import functools
import json
import multiprocessing
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from companion.cli.debrief import debrief
from companion.cli.flying import fly
from companion.cli.options import add_settings, read_settings
from companion.cli.picture import draw
from companion.cli.summary import print_summary
from companion.cli.view import View
from companion.errors import ConfigError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.service.config import ServiceConfig
from companion.sim.camera_server import CameraServerConfig, start_camera_server
from companion.sim.cameras import SimCameraPair, SimTriggerLine
from companion.sim.flight import Flight, build_flight
from companion.sim.scene import Scene, ground_scene, obstacle_scene
from companion.sim.world import WorldOptions, serve_new

_DOWN = 25
_SETTLE_S = 1.5
_START_S = 300.0  # the first start of all compiles the estimator
_NOTHING = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--airframe", default="nadir-2m", metavar="NAME", help="an airframe with two cameras")
    parser.add_argument("--seed", type=int, default=1, help="of the flight: gusts, true airframe, noise")
    parser.add_argument("--duration", type=float, default=60.0, metavar="SECONDS", help="length of the flight")
    parser.add_argument("--out", type=Path, default=Path("out/demo"), metavar="FOLDER", help="where the results go")
    parser.add_argument("--json", action="store_true", help="print summary.json instead of the tables")
    parser.add_argument("--plain", action="store_true", help="a line every few seconds instead of the live view")
    parser.add_argument("--no-compare", action="store_true", help="leave out the two comparison replays")
    add_settings(parser)


@dataclass(slots=True)
class SimulatedVehicle:
    """The simulated side: the flight, its processes, and what they report."""

    flight: Flight
    scene: Scene
    control: Connection
    folder: Path
    start_host_ns: int = 0
    report: dict[str, Any] = field(default_factory=dict)
    cameras: BaseProcess | None = None
    over_s: float | None = None

    def ended(self) -> bool:
        """Tend the processes; True a little after the flight, so that the last shots get through the smoother's lag."""
        while self.control.poll(0):
            kind, content = self.control.recv()
            if kind == "started":
                self.start_host_ns = content
                self._open_eyes()
            else:
                self.report, self.over_s = content, time.monotonic()
        return self.over_s is not None and time.monotonic() - self.over_s > _SETTLE_S

    def _open_eyes(self) -> None:
        """The cameras need to know when the flight began."""
        self.cameras = start_camera_server(
            CameraServerConfig(
                airframe=self.flight.real.actual,
                truth=self.flight.truth,
                scene=self.scene,
                seed=self.flight.seed,
                start_host_ns=self.start_host_ns,
                line_path=self.folder / "line",
                frames_path=self.folder / "frames",
            )
        )


def execute(options: argparse.Namespace) -> int:
    """Fly, judge, show."""
    airframe = load_airframe(options.airframe)
    if airframe.left_camera is None or airframe.right_camera is None:
        raise ConfigError(f"airframe '{airframe.name}' has no camera pair; the demo needs one")
    settings = read_settings(options)
    options.out.mkdir(parents=True, exist_ok=True)
    recording = options.out / "flight.mcap"
    recording.unlink(missing_ok=True)
    _say(f"building flight {options.seed} of {airframe.name} ({options.duration:g} s) ...")
    port = _free_port()
    with (
        tempfile.TemporaryDirectory(prefix="spanwise-") as folder,
        _vehicle(airframe, options, port, Path(folder)) as vehicle,
    ):
        config = ServiceConfig(
            airframe=airframe,
            settings=settings,
            connections=(f"udpin:127.0.0.1:{port}",),
            cameras=functools.partial(SimCameraPair, Path(folder) / "frames"),
            trigger=functools.partial(SimTriggerLine, Path(folder) / "line"),
            recording=recording,
        )
        view = View(f"spanwise demo {airframe.name}, seed {options.seed}")
        live = sys.stdout.isatty() and not options.plain and not options.json
        fly(config, view, vehicle.ended, live=live)
    _say("judging the flight by its truth ...")
    summary = debrief(vehicle.flight, vehicle.scene, recording, vehicle.start_host_ns, vehicle.report,
                      settings, compare=not options.no_compare, say=_say)  # fmt: skip
    (options.out / "summary.json").write_text(json.dumps(summary.plain, indent=2) + "\n", encoding="utf-8")
    draw(summary, options.out / "summary.png")
    print(json.dumps(summary.plain, indent=2)) if options.json else print_summary(summary.plain)
    _say(f"wrote {options.out / 'summary.json'}, {options.out / 'summary.png'} and {recording}")
    return 0 if summary.plain["shots"]["corrected"] else _NOTHING


@contextmanager
def _vehicle(airframe: Airframe, options: argparse.Namespace, port: int, folder: Path) -> Iterator[SimulatedVehicle]:
    """Start autopilot and wing nodes; they wait for the service before they fly."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    waiting = WorldOptions(connection=f"udpout:127.0.0.1:{port}", wait_s=_START_S)
    world = spawn.Process(
        target=serve_new, args=(airframe, options.seed, options.duration, waiting, theirs), name="sim-world"
    )
    world.start()
    flight = build_flight(airframe, options.seed, options.duration)
    down = airframe.orientation == _DOWN
    scene = ground_scene(options.seed) if down else obstacle_scene(flight.truth, options.seed)
    vehicle = SimulatedVehicle(flight, scene, ours, folder)
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


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)
