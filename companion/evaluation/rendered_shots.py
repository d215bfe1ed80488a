"""Shots of a simulated flight, rendered and matched as cameras and vision process would, in processes of their own.

What comes of a shot depends on the flight's seed and on the shot alone: never on which process made it, nor when.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import signal
from collections.abc import Iterable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Protocol

import cv2

from companion.core.pipeline import VisionState, vision_step
from companion.core.stereo.flow_matching import EarlierView
from companion.core.stereo.pairing import FramePairer
from companion.errors import DeviceError
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, FramePair, MatchSet, Rejected, Side
from companion.sim.flight.flight import Flight
from companion.sim.flight.truth import FlightTruth
from companion.sim.flight.worlds import ImageFaults
from companion.sim.vision.cameras import Shutters, render_frame, render_pair
from companion.sim.vision.renderer import PERFECT, Renderer
from companion.sim.vision.scene import Scene
from companion.sim.vision.scenery import scene_of

ShotRecords = list[MatchSet | Rejected | FramePair]
_ENDED = "a process that renders the cameras' images has ended; its messages are above"
_WORKERS = 2  # shots overlap by one at most: a third would wait


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Scene and cameras of a flight; picklable. Matching goes by ``belief``, the airframe that flies is ``actual``."""

    belief: Airframe
    actual: Airframe
    truth: FlightTruth
    scene: Scene
    seed: int
    settings: Settings
    start_host_ns: int
    images: ImageFaults = PERFECT

    @classmethod
    def of(cls, flight: Flight, settings: Settings, start_host_ns: int) -> Stage:
        """The stage of a flight."""
        actual, scene = flight.real.actual, scene_of(flight)
        images = flight.world.images
        return cls(flight.airframe, actual, flight.truth, scene, flight.seed, settings, start_host_ns, images)

    def renderer(self) -> Renderer:
        """The cameras of the aircraft that flies."""
        return Renderer(self.actual, self.truth, self.scene, self.seed, self.images)


@dataclass(frozen=True, slots=True)
class Pull:
    """One pull of the line: number of the shot, instant of the edge, and when its matches are ready (host ns).

    ``is_shown`` asks for the images too. ``earlier_edge_host_ns`` is the edge of the shot before, whose left image
    shows how features have moved; None: there is none.
    """

    shot: int
    edge_host_ns: int
    matched_host_ns: int
    is_shown: bool = False
    earlier_edge_host_ns: int | None = None


class Studio:
    """Makes shots, one by one."""

    def __init__(self, stage: Stage) -> None:
        cv2.setNumThreads(1)
        self._stage = stage
        self._renderer = stage.renderer()
        self._shutters = Shutters(stage.actual, stage.seed)
        self._vision = VisionState.create(stage.belief, stage.settings)
        self._last: Frame | None = None  # left image of the last shot, host clock

    def shoot(self, pull: Pull) -> ShotRecords:
        """Matches of one shot; none before take-off and after the end, where there is nothing to see."""
        earlier = self._earlier(pull)
        try:
            edge_ns = pull.edge_host_ns - self._stage.start_host_ns
            pair = render_pair(self._renderer, self._shutters, edge_ns, pull.shot)
        except ValueError:
            return []
        vision = dataclasses.replace(self._vision, pairer=FramePairer(next_id=pull.shot), numbers={}, earlier=earlier)
        left, right = self._on_host(pair.left), self._on_host(pair.right)
        self._last = left
        said: ShotRecords = [FramePair(pull.shot, left, right)] if pull.is_shown else []
        for frame in (left, right):
            said += vision_step(vision, frame, pull.matched_host_ns)
        return said

    def _earlier(self, pull: Pull) -> EarlierView | None:
        """Left image of the shot before: the one that was just made here, or made again."""
        if pull.earlier_edge_host_ns is None:
            return None
        number, left = pull.shot - 1, self._last
        if left is None or left.sequence != number:
            edge_ns = pull.earlier_edge_host_ns - self._stage.start_host_ns
            try:
                left = self._on_host(render_frame(self._renderer, self._shutters, Side.LEFT, edge_ns, number))
            except ValueError:
                return None
        return EarlierView(number, left.mid_exposure_ns, left.image)

    def _on_host(self, frame: Frame) -> Frame:
        stamp_ns = frame.mid_exposure_ns + self._stage.start_host_ns
        return dataclasses.replace(frame, clock=ClockName.HOST, mid_exposure_ns=stamp_ns)


class StudioPort(Protocol):
    """Makes shots that were begun, for whoever waits for them."""

    def begin(self, pull: Pull) -> None:
        """Begin a shot."""
        ...

    def result(self, shot: int) -> ShotRecords:
        """Matches of a shot that was begun."""
        ...

    def __exit__(self, *_: object) -> None:
        """End it."""
        ...


class InProcessStudio:
    """Makes each shot when its matches are asked for, in this process: for a truth that grows meanwhile."""

    def __init__(self, stage: Stage) -> None:
        self._studio = Studio(stage)
        self._pulled: dict[int, Pull] = {}

    def begin(self, pull: Pull) -> None:
        """Note the shot."""
        self._pulled[pull.shot] = pull

    def result(self, shot: int) -> ShotRecords:
        """Make it."""
        return self._studio.shoot(self._pulled.pop(shot))

    def __exit__(self, *_: object) -> None:
        """Nothing to end."""


class Studios:
    """Processes that make shots. Use as a context manager.

    Raises
    ------
    DeviceError
        A process has died.
    """

    def __init__(self, stage: Stage, workers: int = _WORKERS) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._ends: list[Connection] = []
        self._processes: list[BaseProcess] = []
        for number in range(workers):
            ours, theirs = spawn.Pipe()
            process = spawn.Process(target=_serve, args=(theirs,), name=f"sim-studio-{number}", daemon=True)
            process.start()
            theirs.close()
            _give(ours, stage)
            self._ends.append(ours)
            self._processes.append(process)
        self._worker_of_shot: dict[int, int] = {}
        self._made: dict[int, ShotRecords] = {}

    def begin(self, pull: Pull) -> None:
        """Give a shot to the process with the least to do."""
        busy = list(self._worker_of_shot.values())
        worker = min(range(len(self._ends)), key=busy.count)
        self._worker_of_shot[pull.shot] = worker
        _give(self._ends[worker], pull)

    def result(self, shot: int) -> ShotRecords:
        """Matches of a shot that was begun; waits for them."""
        while shot not in self._made:
            try:
                made, frames = self._ends[self._worker_of_shot[shot]].recv()
            except (EOFError, OSError) as error:
                raise DeviceError(_ENDED) from error
            self._made[made] = frames
            del self._worker_of_shot[made]
        return self._made.pop(shot)

    def all(self, pulls: Iterable[Pull]) -> list[ShotRecords]:
        """Make many shots; what came of each, in their order."""
        listed = list(pulls)
        for pull in listed:
            self.begin(pull)
        return [self.result(pull.shot) for pull in listed]

    def __enter__(self) -> Studios:
        return self

    def __exit__(self, *_: object) -> None:
        for end in self._ends:
            end.close()
        for process in self._processes:
            process.terminate()
            process.join()


def _give(end: Connection, thing: Stage | Pull) -> None:
    try:
        end.send(thing)
    except OSError as error:
        raise DeviceError(_ENDED) from error


def _serve(end: Connection) -> None:
    """Be one of the processes, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent ends us
    try:
        studio = Studio(end.recv())
        while True:
            pull = end.recv()
            end.send((pull.shot, studio.shoot(pull)))
    except (EOFError, OSError):
        return
