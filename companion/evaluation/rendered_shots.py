"""Shots of a simulated flight, rendered and matched as cameras and vision process would, in two processes of their own.

The right image is rendered beside the left one, in the second process; the first matches them.

What comes of a shot depends on the flight's seed and on the shot alone: never on which process made it, nor when.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterable
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
from companion.sim.vision.cameras import Shutters, render_frame
from companion.sim.vision.renderer import PERFECT, Renderer
from companion.sim.vision.scene import Scene
from companion.sim.vision.scenery import scene_of

ShotRecords = list[MatchSet | Rejected | FramePair]
_ENDED = "a process that renders the cameras' images has ended; its messages are above"
# shots begun before the first result is read: pipes hold a few results, and a full one stops both ends (choice)
_AHEAD = 8


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
class ShotRequest:
    """One shot to render: its number, the edge of the trigger line, and when its matches are ready (host ns).

    ``is_shown`` asks for the images too. ``earlier_edge_host_ns`` is the edge of the shot before, whose left image
    shows how features have moved; None: there is none.
    """

    shot: int
    edge_host_ns: int
    matched_host_ns: int
    is_shown: bool = False
    earlier_edge_host_ns: int | None = None


class ShotRenderer:
    """Renders and matches a flight's shots, one by one.

    ``right_image`` gives the right image of each shot in turn, where another process renders it (None: there is none).
    """

    def __init__(self, stage: Stage, right_image: Callable[[], Frame | None] | None = None) -> None:
        cv2.setNumThreads(1)
        self._stage = stage
        self._right_image = right_image
        self._renderer = stage.renderer()
        self._shutters = Shutters(stage.actual, stage.seed)
        self._vision = VisionState.create(stage.belief, stage.settings)
        self._last: Frame | None = None  # left image of the last shot, host clock

    def render(self, request: ShotRequest) -> ShotRecords:
        """Matches of one shot; none before take-off and after the end, where there is nothing to see."""
        earlier = self._earlier(request)
        left = self.image(Side.LEFT, request.shot, request.edge_host_ns)
        if self._right_image is None:
            right = self.image(Side.RIGHT, request.shot, request.edge_host_ns)
        else:
            right = self._right_image()
        if left is None or right is None:
            return []
        vision = dataclasses.replace(self._vision, pairer=FramePairer(next_id=request.shot), newest={}, earlier=earlier)
        self._last = left
        said: ShotRecords = [FramePair(request.shot, left, right)] if request.is_shown else []
        for frame in (left, right):
            said += vision_step(vision, frame, request.matched_host_ns)
        return said

    def image(self, side: Side, shot: int, edge_host_ns: int) -> Frame | None:
        """One image of a shot on the host's clock; None where there is nothing to see."""
        edge_ns = edge_host_ns - self._stage.start_host_ns
        try:
            frame = render_frame(self._renderer, self._shutters, side, edge_ns, shot)
        except ValueError:
            return None
        stamp_ns = frame.mid_exposure_ns + self._stage.start_host_ns
        return dataclasses.replace(frame, clock=ClockName.HOST, mid_exposure_ns=stamp_ns)

    def _earlier(self, request: ShotRequest) -> EarlierView | None:
        """Left image of the shot before: the one that was just made here, or made again."""
        if request.earlier_edge_host_ns is None:
            return None
        number, left = request.shot - 1, self._last
        if left is None or left.sequence != number:
            left = self.image(Side.LEFT, number, request.earlier_edge_host_ns)
        return None if left is None else EarlierView(number, left.mid_exposure_ns, left.image)


class ShotSource(Protocol):
    """Renders shots that were begun, for whoever waits for them."""

    def begin(self, request: ShotRequest) -> None:
        """Begin a shot."""
        ...

    def result(self, shot: int) -> ShotRecords:
        """Matches of a shot that was begun."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class InProcessRenderer:
    """Renders each shot when its matches are asked for, in this process: for a truth that grows meanwhile."""

    def __init__(self, stage: Stage) -> None:
        self._renderer = ShotRenderer(stage)
        self._begun: dict[int, ShotRequest] = {}

    def begin(self, request: ShotRequest) -> None:
        """Note the shot."""
        self._begun[request.shot] = request

    def result(self, shot: int) -> ShotRecords:
        """Render it."""
        return self._renderer.render(self._begun.pop(shot))

    def close(self) -> None:
        """Nothing to end."""


class RendererProcesses:
    """Two processes that render shots in the order in which these were begun. Use as a context manager.

    Raises
    ------
    DeviceError
        A process has died.
    """

    def __init__(self, stage: Stage) -> None:
        spawn = multiprocessing.get_context("spawn")
        from_right, to_left = spawn.Pipe(duplex=False)
        self._ends: list[Connection] = []
        self._processes: list[BaseProcess] = []
        for serve, between in ((_serve_shots, from_right), (_serve_right_images, to_left)):
            ours, theirs = spawn.Pipe()
            process = spawn.Process(target=serve, args=(theirs, between), name=f"sim-{serve.__name__}", daemon=True)
            process.start()
            theirs.close()
            between.close()
            _give(ours, stage)
            self._ends.append(ours)
            self._processes.append(process)
        self._made: dict[int, ShotRecords] = {}

    def begin(self, request: ShotRequest) -> None:
        """Begin a shot."""
        for end in self._ends:
            _give(end, request)

    def result(self, shot: int) -> ShotRecords:
        """Matches of a shot that was begun; waits for them."""
        while shot not in self._made:
            try:
                made, said = self._ends[0].recv()
            except (EOFError, OSError) as error:
                raise DeviceError(_ENDED) from error
            self._made[made] = said
        return self._made.pop(shot)

    def all(self, requests: Iterable[ShotRequest]) -> list[ShotRecords]:
        """Render many shots; what came of each, in their order."""
        made: list[ShotRecords] = []
        begun: deque[int] = deque()
        for request in requests:
            self.begin(request)
            begun.append(request.shot)
            if len(begun) > _AHEAD:
                made.append(self.result(begun.popleft()))
        return made + [self.result(shot) for shot in begun]

    def __enter__(self) -> RendererProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes."""
        for end in self._ends:
            end.close()
        for process in self._processes:
            process.terminate()
            process.join()


def _give(end: Connection, thing: Stage | ShotRequest) -> None:
    try:
        end.send(thing)
    except OSError as error:
        raise DeviceError(_ENDED) from error


def _serve_shots(end: Connection, from_right: Connection) -> None:
    """Be the process that renders left images and matches, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent ends us
    try:
        renderer = ShotRenderer(end.recv(), from_right.recv)
        while True:
            request = end.recv()
            end.send((request.shot, renderer.render(request)))
    except (EOFError, OSError):
        return


def _serve_right_images(end: Connection, to_left: Connection) -> None:
    """Be the process that renders right images, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        renderer = ShotRenderer(end.recv())
        while True:
            request = end.recv()
            to_left.send(renderer.image(Side.RIGHT, request.shot, request.edge_host_ns))
    except (EOFError, OSError):
        return
