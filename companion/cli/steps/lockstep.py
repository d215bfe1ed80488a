"""The service in lock-step with the simulated vehicle: simulated time stands while either computes.

The loop, the autopilot adapter, the trigger's rules, the vision step and the recording's writer are the live service's
own. What the machine would decide is stated here instead: how late the line is pulled, and when a pair is matched.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any, Self

from companion.adapters.mavlink.component.component import OnboardComponent
from companion.adapters.mavlink.component.onboard_computer_status import OnboardComputerStatus
from companion.adapters.mavlink.component.parameter_server import ParameterServer
from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.triggers.firing import WaitingPlan
from companion.core.pipeline import start
from companion.evaluation.rendered_shots import RendererProcesses, ShotRequest, ShotSource, Stage
from companion.live.session import LiveSession
from companion.ports import Clock, Recorder
from companion.records import FramePair, Record, Rejected, Shot, Side, TriggerPlan
from companion.service.config import ServiceConfig
from companion.service.inertial import InertialLoop
from companion.sim.flight.flight import Flight
from companion.sim.vehicle.lockstep import EPOCH_NS, LockStepClock, MemoryWire
from companion.sim.vehicle.world import World, WorldOptions
from companion.sim.vision.cameras import Shutters

READOUT_NS = 6_000_000  # convention: the simulated cameras' own (sim/vision/camera_server.py)
MATCHING_NS = 80_000_000
"""What a small companion computer may take for a pair; a desktop core takes 30 to 35 ms for 640 x 480 (choice)."""
FIRE_LATE_NS = 8_000
"""Mean of the exponential by which the line is pulled late: 99 % within 37 us, as the bench measured (README)."""
_IMAGE_PERIOD_NS = 500_000_000  # convention: the live view's two pairs a second (live/feed.py)
_AFTER_S = 0.7  # the last shots get through the smoother's lag, and the vehicle's silence is not yet a fault (choice)


class LockStepCameras:
    """Trigger, cameras and vision on simulated time; implements the inertial loop's ``Shots`` and ``ports.Trigger``.

    A shot is begun in another process when its line is pulled, and is waited for only when its matches are due.
    """

    def __init__(self, flight: Flight, shot_source: ShotSource, clock: Clock, live: LiveSession | None = None) -> None:
        self._shot_source = shot_source
        self._clock = clock
        self._live = live
        self._shown_ns = 0
        self._shutters = Shutters(flight.real.actual, flight.seed)
        self._waiting = WaitingPlan()
        self._lateness = flight.generator("fire late")
        self._sent_ns = 0
        self._reports: list[Shot | Rejected] = []
        self._coming: deque[ShotRequest] = deque()
        self._busy_until_ns = self._matched_ns = self._shots = 0
        self._edge_ns: int | None = None

    def send(self, plan: TriggerPlan) -> None:
        """Hand over the newest plan."""
        self._fire_due()
        self._sent_ns = self._clock.now_ns()
        self._waiting.take(plan)

    def poll(self) -> list[Shot | Rejected]:
        """Shots and refusals since the last call."""
        self._fire_due()
        taken, self._reports = self._reports, []
        return taken

    def warnings(self) -> list[str]:
        """Nothing to be warned of."""
        return []

    def fire(self, plan: TriggerPlan) -> Shot:
        """Pull the line; a pair that is still being read out misses the edge."""
        edge_ns = self._due_ns(plan) + round(FIRE_LATE_NS * float(self._lateness.standard_exponential()))
        if edge_ns >= self._busy_until_ns:
            self._expose(edge_ns)
        return Shot(plan.plan_id, plan.command_host_ns, edge_ns)

    def close(self) -> None:
        """Nothing to release."""

    def matched(self) -> list[Record]:
        """Matches that are ready by now."""
        said: list[Record] = []
        now_ns = self._clock.now_ns()
        while self._coming and self._coming[0].matched_host_ns <= now_ns:
            for record in self._shot_source.result(self._coming.popleft().shot):
                if not isinstance(record, FramePair):
                    said.append(record)
                elif self._live is not None:
                    self._live.publish(record)
        return said

    def _fire_due(self) -> None:
        plan = self._waiting.plan
        if plan is not None and plan.command_host_ns <= self._clock.now_ns():
            self._reports.append(self._waiting.fire(self, self._due_ns(plan)))

    def _due_ns(self, plan: TriggerPlan) -> int:
        """The plan's instant, or that at which it came to the line, too late."""
        return max(plan.command_host_ns, self._sent_ns)

    def _expose(self, edge_ns: int) -> None:
        exposures = [self._shutters.exposure(side, edge_ns, self._shots) for side in Side]
        self._busy_until_ns = max(each.mid_boot_ns + each.exposure_ns // 2 for each in exposures) + READOUT_NS
        self._matched_ns = max(self._busy_until_ns, self._matched_ns) + MATCHING_NS
        is_shown = self._live is not None and edge_ns - self._shown_ns >= _IMAGE_PERIOD_NS
        self._shown_ns = edge_ns if is_shown else self._shown_ns
        request = ShotRequest(self._shots, edge_ns, self._matched_ns, is_shown, self._edge_ns)
        self._shots += 1
        self._edge_ns = edge_ns
        self._coming.append(request)
        self._shot_source.begin(request)


class _Unrecorded:
    """Stands where no recording is wanted."""

    def write(self, record: Record) -> None:
        """Drop it."""

    def close(self) -> None:
        """Nothing to close."""


class _Watched:
    """The recorder, and beside it the live view."""

    def __init__(self, recorder: Recorder, live: LiveSession) -> None:
        self._recorder, self._live = recorder, live

    def write(self, record: Record) -> None:
        """Record, and show to who looks."""
        self._recorder.write(record)
        self._live.publish(record)

    def close(self) -> None:
        """Finish the file."""
        self._recorder.close()


class LockStepService:
    """Stands where :class:`companion.service.wiring.Service` stands, together with the vehicle. A context manager.

    Connections, devices and parameter file of ``config`` are not looked at. ``world`` is the vehicle at the other end
    of ``wire``, ``shot_source`` its cameras; ``live`` shows it meanwhile.
    """

    def __init__(
        self,
        config: ServiceConfig,
        world: World,
        wire: MemoryWire,
        shot_source: ShotSource,
        live: LiveSession | None = None,
    ) -> None:
        flight = world.flight
        self.world = world
        self.shot_source = shot_source
        self.clock = LockStepClock(self.world)
        self._shown: list[Record] = []
        self._ends_s = flight.duration_s + _AFTER_S
        self._began_s: float | None = None
        link = Link(0, "lock-step", wire, self.clock)
        component = OnboardComponent(ParameterServer(config.settings), computer=OnboardComputerStatus(root=None))
        autopilot = MavlinkAutopilot([link], config.airframe, config.settings, self.clock, component=component)
        recorder: Recorder = _Unrecorded()
        if config.recording is not None:
            recorder = McapWriter(config.recording, About.of(config.airframe, config.settings))
        cameras = LockStepCameras(flight, self.shot_source, self.clock, live)
        self.loop = InertialLoop(
            state=start(config.airframe, config.settings),
            autopilot=autopilot,
            clock=self.clock,
            shots=cameras,
            inbox=cameras.matched,
            show=self._shown.append,
            recorder=recorder if live is None else _Watched(recorder, live),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.autopilot.close()
        self.loop.recorder.close()
        self.shot_source.close()

    def shown(self) -> list[Record]:
        """Records for the display since the last call."""
        taken = self._shown[:]
        self._shown.clear()
        return taken

    def tend(self) -> list[str]:
        """Nothing is restarted here."""
        return []

    def failed(self) -> list[str]:
        """An error ends the command itself."""
        return []

    def over(self) -> bool:
        """Whether the flight has ended, and the last shots have been ranged."""
        return self.clock.flown_s >= self._ends_s

    def wait(self, seconds: float) -> None:
        """Fly on for some seconds of the machine's time."""
        now_s = time.monotonic()
        if self._began_s is None:
            self._began_s = now_s
        while not self.over() and time.monotonic() < now_s + seconds:
            self.loop.run_once()

    def progress(self) -> str:
        """How far the flight has come, and how fast."""
        flown_s, length_s = self.clock.flown_s, self.world.flight.duration_s
        if self._began_s is None:
            return f"flight of {length_s:g} s"
        pace = flown_s / max(time.monotonic() - self._began_s, 1e-3)
        return f"flight {min(flown_s, length_s):3.0f} of {length_s:g} s, {pace:.1f} x real time"

    def report(self) -> dict[str, Any]:
        """Counts of what the vehicle received."""
        return self.world.report()


def lock_step_service(config: ServiceConfig, flight: Flight, live: LiveSession | None = None) -> LockStepService:
    """The service with a vehicle that flies ``flight``, whose images two processes render."""
    wire = MemoryWire()
    shot_source = RendererProcesses(Stage.of(flight, config.settings, EPOCH_NS))
    return LockStepService(config, World(flight, WorldOptions(), wire), wire, shot_source, live)
