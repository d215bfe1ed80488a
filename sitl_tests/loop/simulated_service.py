"""The service's own loop against the simulated vehicle, in simulated time: no process, no socket, no waiting.

The cameras are this file's; the autopilot adapter, the decoder, the loop, the pipeline and the simulated vehicle are
the real ones, on the clock and the wire of ``companion.sim.vehicle.lockstep``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.core.pipeline import start
from companion.core.stereo.geometry import Rig
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.ports import Recorder
from companion.records import ClockName, Firing, MatchSet, Record, Rejected, Shot, TriggerPlan
from companion.service.inertial import InertialLoop
from companion.sim.flight.flight import Flight
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.lockstep import EPOCH_NS, LockStepClock, MemoryWire
from companion.sim.vehicle.world import World, WorldOptions
from sitl_tests.unit.stereo_cases import ground_below, raw_pixels

GROUND_M = 40.0
MS = 1_000_000
_EXPOSURE_NS = 2 * MS
_LATENCY_NS = 8 * MS
_VISION_NS = 60 * MS


@dataclass
class Cameras:
    """Trigger, cameras and vision at once: exact matches of level ground, as the truly bent wing sees it."""

    flight: Flight
    clock: LockStepClock
    plan: TriggerPlan | None = None
    coming: deque[MatchSet] = field(default_factory=deque)
    made: int = 0

    def __post_init__(self) -> None:
        self._rig = Rig.from_airframe(self.flight.airframe)

    def send(self, plan: TriggerPlan) -> None:
        self.plan = None if plan.firing is Firing.SKIP else plan

    def poll(self) -> list[Shot | Rejected]:
        plan, now_ns = self.plan, self.clock.now_ns()
        if plan is None or now_ns < plan.command_host_ns:
            return []
        self.plan = None
        fired_ns = plan.command_host_ns + 30_000
        self.coming.append(self._matches(plan.plan_id, fired_ns + _LATENCY_NS + _EXPOSURE_NS // 2))
        return [Shot(plan.plan_id, plan.command_host_ns, fired_ns)]

    def warnings(self) -> list[str]:
        return []

    def ready_matches(self) -> list[Record]:
        """Matches that vision has ready by now."""
        ready: list[Record] = []
        while self.coming and self.coming[0].matched_host_ns <= self.clock.now_ns():
            ready.append(self.coming.popleft())
        return ready

    def _matches(self, plan_id: int, middle_ns: int) -> MatchSet:
        self.made += 1
        truth = self.flight.truth.at(middle_ns - EPOCH_NS)
        points = ground_below(GROUND_M, 60, seed=self.made)
        slope, lift = tuple(truth.slope_rad.tolist()), tuple(truth.lift_m.tolist())
        left_px, right_px = raw_pixels(self._rig, points, slope, lift)
        noise = 0.05 * np.random.default_rng(self.made).standard_normal((2, len(points), 2))
        return MatchSet(
            pair_id=self.made,
            plan_id=plan_id,
            clocks=(ClockName.HOST, ClockName.HOST),
            mid_exposure_ns=np.array([middle_ns, middle_ns]),
            exposure_ns=_EXPOSURE_NS,
            row_time_ns=0,
            left_px=left_px + noise[0],
            right_px=right_px + noise[1],
            sigma_px=np.full(len(points), 0.05),
            matched_host_ns=middle_ns + _VISION_NS,
        )


@dataclass
class Tape:
    """Keeps what was recorded, in memory and, where there is a writer, in a file."""

    writer: McapWriter | None = None
    records: list[Record] = field(default_factory=list)

    def write(self, record: Record) -> None:
        self.records.append(record)
        if self.writer is not None:
            self.writer.write(record)

    def close(self) -> None:
        if self.writer is not None:
            self.writer.close()

    def of(self, kind: type[Any], since_s: float = 0.0, until_s: float = 1e9) -> list[Any]:
        """Records of one kind with the flight seconds in between; the time is that of the last tick before."""
        of_kind, at_s = [], 0.0
        for record in self.records:
            at_s = (getattr(record, "now_host_ns", 0) - EPOCH_NS) * 1e-9 if hasattr(record, "now_host_ns") else at_s
            if isinstance(record, kind) and since_s <= at_s < until_s:
                of_kind.append(record)
        return of_kind


class SimulatedService:
    """One run of the loop; :meth:`fly` turns it for some seconds of flight."""

    def __init__(
        self,
        flight: Flight,
        *,
        faults: Faults | None = None,
        settings: Settings | None = None,
        recording: Path | None = None,
        airframe: Airframe | None = None,
        parameters: dict[str, float] | None = None,
        px4: bool = False,
        cameras: Callable[[Flight, LockStepClock], Cameras] = Cameras,
    ) -> None:
        airframe, settings = airframe or flight.airframe, settings or Settings()
        self.wire = MemoryWire()
        options = WorldOptions(faults=faults or Faults(), parameters=parameters or {}, px4=px4)
        self.world = World(flight, options, self.wire)
        self.clock = LockStepClock(self.world)
        link = Link(0, "simulated", self.wire, self.clock)
        self.autopilot = MavlinkAutopilot([link], airframe, settings, self.clock)
        self.cameras = cameras(flight, self.clock)
        self.tape = Tape(McapWriter(recording, About.of(airframe, settings)) if recording else None)
        recorder: Recorder = self.tape
        self.loop = InertialLoop(
            state=start(airframe, settings),
            autopilot=self.autopilot,
            clock=self.clock,
            shots=self.cameras,
            inbox=self.cameras.ready_matches,
            show=lambda record: None,
            recorder=recorder,
        )

    @property
    def flown_s(self) -> float:
        return (self.clock.now_ns() - EPOCH_NS) * 1e-9

    def fly(self, until_s: float) -> Tape:
        """Turn the loop until some second of the flight."""
        while self.flown_s < until_s:
            self.loop.run_once()
        return self.tape

    def close(self) -> None:
        self.autopilot.close()
        self.tape.close()
