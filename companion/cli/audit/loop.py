"""The service's own path without sockets: records and ticks into the pipeline, plans to the shutter, images back."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.cli.judge import Judge, Reading
from companion.core.pipeline import PipelineState, start, step
from companion.core.stereo.matching import match_pair
from companion.core.stereo.vision import VisionState
from companion.params.settings import Settings
from companion.records import (
    ClockName,
    CorrectedRange,
    Deflection,
    Firing,
    Ints,
    MatchSet,
    OutputRecord,
    Shot,
    Side,
    Tick,
    TriggerPlan,
)
from companion.sim.cameras import Shutters, render_pair
from companion.sim.flight import Flight
from companion.sim.offline import HOST_EPOCH_NS, flight_records
from companion.sim.renderer import Renderer
from companion.sim.scene import Scene

_TICK_NS = 10_000_000
_VISION_NS = 60_000_000
_RANDOM_PLAN = -1


@dataclass(frozen=True, slots=True)
class Scored:
    """One shot: what triggered it, what every way reads (None: no reading), and what the wing did.

    ``tip_rad`` is the true slope of the left and right tip beyond rest, ``toe_rad`` their sum; ``blur_px`` is what
    bending alone smears in the worse camera.
    """

    planned: bool
    rigid: Reading | None
    in_trim: Reading | None
    corrected: Reading | None
    oracle: Reading | None
    trusted: bool
    tip_rad: tuple[float, float]
    blur_px: float

    @property
    def toe_rad(self) -> float:
        """Relative toe beyond rest."""
        return sum(self.tip_rad)


@dataclass(slots=True)
class _Run:
    state: PipelineState
    judge: Judge
    vision: VisionState
    renderer: Renderer
    shutters: Shutters
    from_ns: int
    waiting: deque[MatchSet] = field(default_factory=deque)
    shots: dict[int, MatchSet] = field(default_factory=dict)
    bends: list[Deflection] = field(default_factory=list)
    found: dict[int, tuple[CorrectedRange, Deflection, Deflection]] = field(default_factory=dict)
    plan: TriggerPlan | None = None
    count: int = 0

    def take(self, outputs: list[OutputRecord]) -> None:
        """Keep what the shutter and the score need."""
        for output in outputs:
            if isinstance(output, TriggerPlan):
                self.plan = output if output.firing is not Firing.SKIP else None
            elif isinstance(output, Deflection):
                self.bends = [*self.bends[-1:], output]
            elif isinstance(output, CorrectedRange):
                self.found[output.pair_id] = (output, self.bends[0], self.bends[1])

    def feed(self, record: object) -> None:
        """One input of the pipeline."""
        self.state, outputs = step(self.state, record)  # type: ignore[arg-type]
        self.take(outputs)

    def expose(self, edge_host_ns: int, plan_id: int) -> None:
        """Open both shutters, match what they saw, and let the matches wait for the vision process's time."""
        pair = render_pair(self.renderer, self.shutters, edge_host_ns - HOST_EPOCH_NS, self.count)
        matched = match_pair(pair, self.vision.rig, self.vision.search, edge_host_ns + _VISION_NS)
        on_host = dataclasses.replace(
            matched,
            pair_id=self.count,
            plan_id=plan_id,
            clocks=(ClockName.HOST, ClockName.HOST),
            mid_exposure_ns=matched.mid_exposure_ns + HOST_EPOCH_NS,
        )
        self.shots[self.count] = on_host
        self.waiting.append(on_host)
        self.count += 1

    def fire(self, until_host_ns: int) -> None:
        """Fire the open plan when its command comes before the next tick."""
        plan = self.plan
        if plan is None or plan.command_host_ns >= until_host_ns:
            return
        self.plan = None
        self.feed(Shot(plan.plan_id, plan.command_host_ns, plan.command_host_ns))
        if plan.command_host_ns >= self.from_ns:
            self.expose(plan.command_host_ns, plan.plan_id)


def fly(
    flight: Flight, scene: Scene, settings: Settings, from_s: float, random_edges_ns: Ints, warm_s: float = 2.0
) -> list[Scored]:
    """Fly through; shots at the planner's instants, and further ones at random edges (boot ns), from ``from_s`` on.

    The planner's shots begin ``warm_s`` earlier, so that the trigger's latency is learned; those are not scored.
    """
    renderer = Renderer(flight.real.actual, flight.truth, scene, flight.seed)
    run = _Run(
        start(flight.airframe, settings),
        Judge(flight, renderer, settings, HOST_EPOCH_NS),
        VisionState.create(flight.airframe, settings),
        renderer,
        Shutters(flight.real.actual, flight.seed),
        HOST_EPOCH_NS + round((from_s - warm_s) * 1e9),
    )
    edges = deque((HOST_EPOCH_NS + np.sort(random_edges_ns)).tolist())
    records = deque(flight_records(flight))
    for now_ns in _ticks(flight):
        while records and records[0].received_host_ns <= now_ns:
            run.feed(records.popleft())
        while run.waiting and run.waiting[0].matched_host_ns <= now_ns:
            run.feed(run.waiting.popleft())
        run.feed(Tick(now_ns))
        run.fire(now_ns + _TICK_NS)
        while edges and edges[0] < now_ns + _TICK_NS:
            run.expose(edges.popleft(), _RANDOM_PLAN)
    scored_from_ns = HOST_EPOCH_NS + round(from_s * 1e9)
    return [_scored(run, pair_id) for pair_id in run.found if run.shots[pair_id].mid_exposure_ns[0] >= scored_from_ns]


def _ticks(flight: Flight) -> Iterator[int]:
    yield from range(HOST_EPOCH_NS + _TICK_NS, HOST_EPOCH_NS + round(flight.duration_s * 1e9), _TICK_NS)


def _scored(run: _Run, pair_id: int) -> Scored:
    matches = run.shots[pair_id]
    answer, left, right = run.found[pair_id]
    judge, truth = run.judge, run.judge.flight.truth
    samples = [truth.at(int(t_ns) - HOST_EPOCH_NS) for t_ns in matches.mid_exposure_ns]
    rest = run.judge.flight.model
    still = rest.tip_slope_rad(rest.q_static(1.0))
    left_rad, right_rad = (float(samples[side].slope_rad[side] - still[side]) for side in Side)
    rate = max(abs(float(samples[side].slope_rate_radps[side])) for side in Side)
    return Scored(
        planned=matches.plan_id != _RANDOM_PLAN,
        rigid=judge.rigid(matches),
        in_trim=judge.rigid_in_trim(matches),
        corrected=judge.corrected(matches, left, right),
        oracle=judge.oracle(matches),
        trusted=answer.trusted,
        tip_rad=(left_rad, right_rad),
        blur_px=run.renderer.rig.left.lens.focal_px * matches.exposure_ns * 1e-9 * rate,
    )
