"""A mission script against the simulated vehicle: real UDP, MAVSDK on one end, the vehicle in a thread on the other."""

from __future__ import annotations

import dataclasses
import functools
import os
import signal
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from companion.params.airframe import Airframe
from companion.params.files import dump_airframe, load_airframe
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.rehearsal.vehicle import RehearsalVehicle
from companion.sim.vehicle.faults import Faults
from sitl_tests.ports import free_port

Script = Callable[[Sequence[str]], int]
SPEED = 8.0
SLOW_LOOP = {"SCHED_LOOP_RATE": 100.0}
"""80 Hz of IMU at most: a link eight times faster than real must not drown in it."""


def airframe(orientation: int = 25) -> Airframe:
    """All sensors inside the autopilot, so that a tlog is enough; cameras, so that there is a baseline."""
    cameras = load_airframe("nadir-2m" if orientation else "forward-2m")
    return dataclasses.replace(
        load_airframe("sitl-plane"),
        name="mission-plane",
        orientation=orientation,
        left_camera=cameras.left_camera,
        right_camera=cameras.right_camera,
    )


@functools.cache
def flight(orientation: int = 25, seconds: float = 3.0) -> Flight:
    return build_flight(airframe(orientation), 5, seconds)


class Stage:
    """The vehicle of one test; what shall happen in flight is said with :meth:`when`."""

    def __init__(
        self,
        folder: Path,
        *,
        orientation: int = 25,
        height_m: float = 60.0,
        speed: float = SPEED,
        faults: Faults | None = None,
        obstacle_m: tuple[float, float] | None = None,
        seconds: float = 3.0,
        parameters: dict[str, float] | None = None,
        second_link: bool = False,
    ) -> None:
        self.folder = folder
        self._port, self.second_port = free_port(), free_port()
        ports = [self._port, self.second_port] if second_link else [self._port]
        self.flight = flight(orientation, seconds)
        self.airframe_path = folder / "airframe.toml"
        self.airframe_path.write_text(dump_airframe(airframe(orientation)), encoding="utf-8")
        self.vehicle = RehearsalVehicle(
            self.flight,
            [f"udpout:127.0.0.1:{port}" for port in ports],
            height_m=height_m,
            speed=speed,
            ranges=not second_link,  # one companion at a time
            obstacle_m=obstacle_m,
            faults=faults,
            parameters=SLOW_LOOP if parameters is None else parameters,
        )
        self._every: list[Callable[[], object]] = []
        self._when: list[tuple[Callable[[], bool], Callable[[], None]]] = []
        self._stop = threading.Event()

    @property
    def pilot(self):  # type: ignore[no-untyped-def]
        return self.vehicle.pilot

    @property
    def ranges(self):  # type: ignore[no-untyped-def]
        return self.vehicle.companion.faults

    def when(self, condition: Callable[[], bool], action: Callable[[], None]) -> None:
        """Once, as soon as the condition holds (looked at every turn of the vehicle)."""
        self._when.append((condition, action))

    def every(self, action: Callable[[], object]) -> None:
        """At every turn of the vehicle."""
        self._every.append(action)

    def on_item(self, item: int, action: Callable[[], None], below_m: float = 1e9) -> None:
        """Once this mission item is flown, and below some height."""
        self.when(
            lambda: self.pilot.mode == 10 and self.pilot.current == item and self.pilot.height_m < below_m, action
        )

    def fly(self, script: Script, *options: str) -> int:
        """Run a script to its exit code."""
        thread = threading.Thread(target=self.vehicle.run, args=(self._ended,))
        thread.start()
        try:
            return script(
                [
                    f"--connect=udpin://127.0.0.1:{self._port}",
                    f"--airframe={self.airframe_path}",
                    f"--out={self.folder}",
                    *options,
                ]
            )
        finally:
            self._stop.set()
            thread.join()

    def _ended(self) -> bool:
        for each in self._every:
            each()
        for entry in list(self._when):
            condition, action = entry
            if condition():
                self._when.remove(entry)
                action()
        return self._stop.is_set()

    def log(self) -> str:
        return (self.folder / "mission.log").read_text(encoding="utf-8")


def interrupt() -> None:
    """Ctrl-C."""
    os.kill(os.getpid(), signal.SIGINT)
