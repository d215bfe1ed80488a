"""``spanwise vehicle``: the simulated aircraft on a link, for a tour of run and doctor without hardware."""

from __future__ import annotations

import argparse
import signal
import threading
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from companion.cli.steps.numbers import seconds, seed
from companion.cli.steps.options import make_folder
from companion.cli.steps.simulated_devices import frames_path, line_path
from companion.cli.terminal.progress import say
from companion.errors import NOTHING_TO_ESTIMATE, ConfigError, DeviceError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.worlds import IDEAL, WORLDS
from companion.sim.vehicle.routing import Port, Router
from companion.sim.vehicle.world import VehicleLink, WorldOptions, serve
from companion.sim.vision.camera_server import CameraServerConfig, start_camera_server
from companion.sim.vision.scene import Scene
from companion.sim.vision.scenery import scene_of

_LINKS = ("udpout:127.0.0.1:14550", "udpout:127.0.0.1:14551")
_WAIT_S = 600.0  # somebody types the other command meanwhile (choice)
_OPENING_S = 5.0  # chosen: longer than a connection takes; a stuck one holds the end up no longer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--airframe", default="nadir-2m", metavar="NAME", help="name or path of an airframe file")
    parser.add_argument("--seed", type=seed, default=1, help="of the flight: gusts, true airframe, noise")
    parser.add_argument("--world", choices=list(WORLDS), default=IDEAL.name, help="what the aircraft flies in")
    parser.add_argument("--duration", type=seconds, default=240.0, metavar="SECONDS", help="length of the flight")
    parser.add_argument(
        "--connect", action="append", metavar="LINK",
        help="udpout:HOST:PORT (somebody listens there) or udpin:HOST:PORT; may be repeated "
        f"(default: {' and '.join(_LINKS)}, one for run, one for doctor)",
    )  # fmt: skip
    parser.add_argument(
        "--cameras", type=Path, metavar="FOLDER",
        help="render the airframe's camera pair too; run takes it as --cameras sim:FOLDER --trigger sim:FOLDER",
    )  # fmt: skip


class _Control:
    """Hears Ctrl-C for the loop that flies, and opens the cameras at take-off, beside it."""

    def __init__(self, flight: Flight, folder: Path | None) -> None:
        self._flight, self._folder = flight, folder
        self._cameras: BaseProcess | None = None
        self._opening: threading.Thread | None = None
        self._landed = threading.Event()
        self._stopped: list[int] = []

    def send(self, message: tuple[str, Any], /) -> None:
        kind, content = message
        if kind != "started":
            return
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda caught, _: self._stopped.append(caught))
        say(f"somebody answered: flying for {self._flight.duration_s:g} s; Ctrl-C ends it")
        if self._folder is not None:
            self._opening = threading.Thread(target=self._open, args=(self._folder, content), daemon=True)
            self._opening.start()

    def poll(self, timeout: float = 0.0, /) -> bool:  # noqa: ARG002 (part of the protocol)
        return bool(self._stopped)

    def recv(self) -> None:
        """Nothing but the end is ever said."""

    def close(self) -> None:
        """Put the cameras away."""
        self._landed.set()
        if self._opening is not None:
            self._opening.join(_OPENING_S)
        if self._cameras is not None:
            self._cameras.terminate()
            self._cameras.join()

    def _open(self, folder: Path, start_host_ns: int) -> None:
        try:
            self._cameras = open_cameras(self._flight, scene_of(self._flight), folder, start_host_ns)
        except DeviceError as error:
            say(f"spanwise vehicle: {error}")
        self._landed.wait()  # a child ends with the thread that started it, not only with the process


def execute(options: argparse.Namespace) -> int:
    """Wait for a companion, fly, and say what arrived."""
    airframe = load_airframe(options.airframe)
    _check(options, airframe)
    links = options.connect or list(_LINKS)
    router = Router(_opened(links))  # before the flight is built, which takes a while
    say(f"building {options.duration:g} s of {airframe.name}, seed {options.seed} ...")
    flight = build_flight(airframe, options.seed, options.duration, world=WORLDS[options.world])
    control = _Control(flight, options.cameras)
    waiting = WorldOptions(wait_s=_WAIT_S, trigger_line=options.cameras and line_path(options.cameras))
    say(f"on {' and '.join(links)}, waiting for spanwise run or doctor ...")
    try:
        report = serve(flight, waiting, control, link=router)
    finally:
        control.close()
    received = ", ".join(f"{count} {name}" for name, count in report["received"].items())
    print(f"flew {report['flown_s']:.0f} s; received {received or 'nothing: was run connected to this link?'}")
    return 0 if received else NOTHING_TO_ESTIMATE


def _check(options: argparse.Namespace, airframe: Airframe) -> None:
    if not 1.0 <= options.duration <= 3600.0:
        raise ConfigError(f"--duration {options.duration:g}: give 1 to 3600 s")
    if options.cameras is None:
        return
    if airframe.left_camera is None or airframe.right_camera is None:
        raise ConfigError(f"--cameras: airframe '{airframe.name}' has no camera pair")
    make_folder(options.cameras, "--cameras")


def _opened(spellings: list[str]) -> list[Port]:
    links: list[Port] = []
    try:
        for spelling in spellings:
            links.append(VehicleLink(spelling))
    except BaseException:
        for link in links:
            link.close()
        raise
    return links


def open_cameras(flight: Flight, scene: Scene, folder: Path, start_host_ns: int) -> BaseProcess:
    """Start the process that renders a flight's camera pair; it needs to know when the flight began."""
    return start_camera_server(
        CameraServerConfig(
            airframe=flight.real.actual,
            truth=flight.truth,
            scene=scene,
            images=flight.world.images,
            seed=flight.seed,
            start_host_ns=start_host_ns,
            line_path=line_path(folder),
            frames_path=frames_path(folder),
        )
    )
