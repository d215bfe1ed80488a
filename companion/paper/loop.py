"""The service's own path without sockets: records and ticks into the pipeline, plans to the shutter, images back."""

from __future__ import annotations

import dataclasses
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np

from companion.core.pipeline import PipelineState, start, step
from companion.core.stereo.matching import match_pair
from companion.core.stereo.vision import VisionState
from companion.evaluation.replay import TICK_NS
from companion.evaluation.true_geometry import TrueGeometry
from companion.paper.shots import Answer, Flown, SlopeSpread, score
from companion.params.settings import Settings
from companion.records import (
    ClockName,
    CorrectedRange,
    Deflection,
    Firing,
    Ints,
    MatchSet,
    OutputRecord,
    Reject,
    Rejected,
    RelativeRotation,
    Shot,
    Tick,
    TriggerPlan,
)
from companion.sim.flight.flight import Flight
from companion.sim.flight.offline import HOST_EPOCH_NS, flight_records
from companion.sim.vision.cameras import Shutters, render_pair
from companion.sim.vision.renderer import Renderer
from companion.sim.vision.scene import Scene

_VISION_NS = 60_000_000  # chosen: what a small companion computer may take for a pair
WARM_UP_S = 2.0
"""Before shots count the planner fires already, so that the trigger's latency is learned (choice)."""

_RANDOM_PLAN = -1  # convention: no plan has a negative number
_PAIR = "pair "


@dataclass(slots=True)
class _Run:
    state: PipelineState
    geometry: TrueGeometry
    vision: VisionState
    renderer: Renderer
    shutters: Shutters
    from_ns: int
    until_ns: int
    waiting: deque[MatchSet] = field(default_factory=deque)
    shots: dict[int, MatchSet] = field(default_factory=dict)
    bends: list[Deflection] = field(default_factory=list)
    turned: RelativeRotation | None = None
    answers: dict[int, Answer] = field(default_factory=dict)
    refused: dict[int, Reject] = field(default_factory=dict)
    plan: TriggerPlan | None = None
    count: int = 0

    def take(self, outputs: list[OutputRecord]) -> None:
        """Keep what the shutter and the score need."""
        for output in outputs:
            if isinstance(output, TriggerPlan):
                self.plan = output if output.firing is not Firing.SKIP else None
            elif isinstance(output, Deflection):
                self.bends = [*self.bends[-1:], output]
            elif isinstance(output, RelativeRotation):
                self.turned = output
            elif isinstance(output, CorrectedRange):
                self.answers[output.pair_id] = Answer(output, self.bends[0], self.bends[1], self.turned)
            elif isinstance(output, Rejected) and output.what.startswith(_PAIR):
                self.refused[int(output.what.removeprefix(_PAIR))] = output.reason

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
        if self.from_ns <= plan.command_host_ns < self.until_ns:
            self.expose(plan.command_host_ns, plan.plan_id)


def fly(
    flight: Flight, scene: Scene, settings: Settings, counted_s: tuple[float, float], random_edges_ns: Ints
) -> Flown:
    """Fly through; shots at the planner's instants and at random edges (n,) (boot ns), within ``counted_s``.

    The planner's shots begin :data:`WARM_UP_S` earlier; those are not scored.
    """
    renderer = Renderer(flight.real.actual, flight.truth, scene, flight.seed)
    from_ns, until_ns = (HOST_EPOCH_NS + round(t_s * 1e9) for t_s in counted_s)
    run = _Run(
        start(flight.airframe, settings),
        TrueGeometry(flight, renderer, settings, HOST_EPOCH_NS),
        VisionState.create(flight.airframe, settings),
        renderer,
        Shutters(flight.real.actual, flight.seed),
        from_ns - round(WARM_UP_S * 1e9),
        until_ns,
    )
    edges = deque((HOST_EPOCH_NS + np.sort(random_edges_ns)).tolist())
    records = deque(flight_records(flight))
    for now_ns in range(HOST_EPOCH_NS + TICK_NS, HOST_EPOCH_NS + round(flight.duration_s * 1e9), TICK_NS):
        while records and records[0].received_host_ns <= now_ns:
            run.feed(records.popleft())
        while run.waiting and run.waiting[0].matched_host_ns <= now_ns:
            run.feed(run.waiting.popleft())
        run.feed(Tick(now_ns))
        run.fire(now_ns + TICK_NS)
        while edges and edges[0] < now_ns + TICK_NS:
            run.expose(edges.popleft(), _RANDOM_PLAN)
    return _counted(run, from_ns)


def _counted(run: _Run, from_ns: int) -> Flown:
    """Score every shot that counts; one without an answer is refused, whatever the reason."""
    counted = [pair_id for pair_id, shot in run.shots.items() if shot.mid_exposure_ns[0] >= from_ns]
    spread = SlopeSpread.of(run.geometry.flight)
    answered = [(run.shots[pair_id], run.answers[pair_id]) for pair_id in counted if pair_id in run.answers]
    shots = tuple(
        score(run.geometry, spread, matches, answer, matches.plan_id != _RANDOM_PLAN) for matches, answer in answered
    )
    refused = Counter(str(run.refused.get(pair_id, "no answer")) for pair_id in counted if pair_id not in run.answers)
    return Flown(shots, len(run.shots) - len(counted), dict(refused))
