"""Evaluation of a simulated flight by its truth, and of the same flight replayed in two other ways.

"Vertical accelerometers alone" replays the recording with every other axis of the wing nodes hidden; "random instants"
renders the same flight at instants that have nothing to do with the wing, and corrects those with the same estimates.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.recording_factory import open_recording
from companion.evaluation.accuracy_targets import (
    published_off_axis,
    sigma_calibration,
    targets,
    trigger_summary,
    wing_blur_px,
)
from companion.evaluation.metrics import SETTLED_S, UNANSWERED_S, Scored, range_summary, toe_summary
from companion.evaluation.rendered_shots import RendererProcesses, ShotRecords, ShotRequest, Stage
from companion.evaluation.replay import own_inputs
from companion.evaluation.shot_scores import PipelineOutputs, Shots, collect, paired, replayed, score_shots
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Axis, Floats, ImuBatch, MatchSet, Record, Reject, Station, Tick
from companion.reporting.numbers import finite
from companion.sim.flight.flight import Flight

TRUSTED_FROM_S = 15.0  # chosen: clocks, tracker and latency have settled
_RANDOM_RATE_HZ = 4.0  # chosen: some hundred instants in half a minute
_RANDOM_SEED = 0xA11  # convention: keeps random instants apart from the flight's own draws
_ARRIVAL_NS = 100_000_000  # chosen: read-out and matching of a small companion computer
_NO_RANGE = (Reject.FRAME_LOST, Reject.FROZEN, Reject.UNPAIRED, Reject.OUT_OF_WINDOW, Reject.QUEUE_FULL)
"""What happens to images on their way; nothing else is refused for these reasons."""


@dataclass(frozen=True, slots=True)
class FlightEvaluation:
    """``plain`` is summary.json; ``series`` are the arrays that the picture shows."""

    plain: dict[str, Any]
    series: dict[str, Floats]


def evaluate_flight(
    flight: Flight, stage: Stage, recording: Path, report: dict[str, Any], *, compare: bool, say: Callable[[str], None]
) -> FlightEvaluation:
    """Judge one recorded flight.

    ``stage`` is what was filmed, the settings in force, and the host time of boot time 0; ``report`` is what the
    autopilot's side received. With ``compare`` the flight is also replayed with vertical accelerometers alone and
    rendered at random instants.
    """
    opened, settings = open_recording(recording), stage.settings
    geometry = TrueGeometry(flight, stage.renderer(), settings, stage.start_host_ns)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as aside:
        at_random = _begun(geometry, stage, aside, say) if compare else None
        records = list(opened.records())
        outputs = collect(records)
        shots = score_shots(geometry, outputs)
        blur = {"at_plan": wing_blur_px(geometry, [outputs.matches[pair_id] for pair_id in shots.ids])}
        others: dict[str, Shots] = {}
        if at_random is not None:
            extra, inputs = at_random.result(), own_inputs(records, opened.airframe, settings)
            # now, not before: a Ctrl-C while scoring need not wait for it
            vertical = aside.submit(_replayed_vertically, recording, flight.airframe, settings)
            others = _compared(geometry, inputs, extra, vertical)
            blur["at_random"] = wing_blur_px(geometry, extra)
    ways = shots.ways | {name: other.ways["corrected"] for name, other in others.items()}
    against = {name: paired(shots, other) for name, other in others.items()}
    plain = _summary(geometry, outputs, shots, ways, against, blur, report)
    return FlightEvaluation(finite(plain), _series(geometry, outputs, shots, ways, blur))


def _summary(
    geometry: TrueGeometry,
    outputs: PipelineOutputs,
    shots: Shots,
    ways: dict[str, Scored],
    against: dict[str, dict[str, Any]],
    blur: dict[str, Floats],
    report: dict[str, Any],
) -> dict[str, Any]:
    """Content of summary.json."""
    flight = geometry.flight
    return {
        "airframe": flight.airframe.name,
        "world": flight.world.name,
        "seed": flight.seed,
        "duration_s": flight.duration_s,
        "truth": _truth(flight),
        "toe_error_mrad": {name: toe_summary(way) for name, way in ways.items()},
        "range_error_m": {name: range_summary(way) for name, way in ways.items()},
        "against_corrected": against,
        "targets": targets(ways),
        "sigma": sigma_calibration(shots, outputs) | {"published_off_axis": published_off_axis(geometry, outputs)},
        "trigger": trigger_summary(geometry, outputs, shots, blur),
        "shots": _counts(outputs, shots) | {"settled": _settled(geometry, outputs)},
        "published": {key: report.get(key) for key in ("received", "ranges_used", "range_timeouts", "problems")},
        "refused": dict(sorted(outputs.rejected.items())),
    }


def _begun(geometry: TrueGeometry, stage: Stage, aside: Executor, say: Callable[[str], None]) -> Future[list[MatchSet]]:
    """Begin with the random instants: their matches are to be replayed beside the other replay."""
    say("replaying with vertical accelerometers alone, and rendering the same flight at random instants ...")
    return aside.submit(_rendered, stage, _random_requests(geometry))


def _compared(
    geometry: TrueGeometry, inputs: Iterable[Record], extra: list[MatchSet], vertical: Future[PipelineOutputs]
) -> dict[str, Shots]:
    """The same flight with vertical accelerometers alone, and at random instants."""
    at_random = replayed(with_matches(inputs, extra), geometry.flight.airframe, geometry.settings)
    random = score_shots(geometry, at_random)
    return {"vertical_only": score_shots(geometry, vertical.result()), "random_instants": random}


def _rendered(stage: Stage, wanted: list[ShotRequest]) -> list[MatchSet]:
    with RendererProcesses(stage) as processes:
        return matches_of(processes.all(wanted))


def _replayed_vertically(recording: Path, airframe: Airframe, settings: Settings) -> PipelineOutputs:
    opened = open_recording(recording)
    return replayed(vertical_only(own_inputs(opened.records(), opened.airframe, settings)), airframe, settings)


def vertical_only(inputs: Iterable[Record]) -> Iterator[Record]:
    """The same inputs with every axis of the wing nodes hidden but the vertical accelerometer (the paper's case)."""
    for record in inputs:
        if isinstance(record, ImuBatch) and record.station is not Station.ROOT:
            values = np.zeros_like(record.values)
            values[:, 2] = record.values[:, 2]
            record = dataclasses.replace(record, values=values, axes=record.axes & Axis.Z)
        yield record


def _random_requests(geometry: TrueGeometry) -> list[ShotRequest]:
    """Requests of shots at instants that know nothing of the wing."""
    flight = geometry.flight
    rng = np.random.default_rng([flight.seed, _RANDOM_SEED])
    count = max(int((flight.duration_s - SETTLED_S - 1.0) * _RANDOM_RATE_HZ), 0)
    edges_s = SETTLED_S + (np.arange(count) + rng.uniform(0, 1, count)) / _RANDOM_RATE_HZ
    return shot_requests(edges_s, geometry.start_host_ns)


def shot_requests(edges_s: Floats, start_host_ns: int) -> list[ShotRequest]:
    """Requests of shots at ``edges_s`` (n,) (boot time), whose matches are ready a tenth of a second later."""
    edges_ns = [start_host_ns + int(edge_s * 1e9) for edge_s in edges_s]
    return [
        ShotRequest(shot, edge_ns, edge_ns + _ARRIVAL_NS, earlier_edge_host_ns=before_ns)
        for shot, (edge_ns, before_ns) in enumerate(zip(edges_ns, [None, *edges_ns], strict=False))
    ]


def matches_of(shots: Iterable[ShotRecords]) -> list[MatchSet]:
    """The matches of many shots."""
    return [record for shot_records in shots for record in shot_records if isinstance(record, MatchSet)]


def with_matches(inputs: Iterable[Record], extra: Iterable[MatchSet]) -> Iterator[Record]:
    """The inputs with other matches put in the place of the recorded ones."""
    waiting = deque(sorted(extra, key=lambda matches: matches.matched_host_ns))
    for record in inputs:
        if isinstance(record, MatchSet):
            continue
        while isinstance(record, Tick) and waiting and waiting[0].matched_host_ns <= record.now_host_ns:
            yield waiting.popleft()
        yield record


def _truth(flight: Flight) -> dict[str, float]:
    wing = flight.real.actual.wing
    return {
        "frequency_hz": wing.symmetric.frequency_hz.value,
        "damping": wing.symmetric.damping.value,
        "antisymmetric_hz": wing.antisymmetric.frequency_hz.value,
        "gust_rms_mm": 1e3 * wing.gust.deflection_rms_m.value,
        "trim_bend_mm": 1e3 * wing.trim_bend_m.value,
    }


def _settled(geometry: TrueGeometry, outputs: PipelineOutputs) -> dict[str, Any]:
    """Pairs from :data:`TRUSTED_FROM_S` on that had time to be corrected, and the share that was published."""
    from_ns = geometry.start_host_ns + round(TRUSTED_FROM_S * 1e9)
    until_ns = geometry.start_host_ns + round((geometry.flight.duration_s - UNANSWERED_S) * 1e9)
    pairs = [i for i, entry in outputs.matches.items() if from_ns <= int(entry.mid_exposure_ns.mean()) <= until_ns]
    trusted = sum(i in outputs.ranges and outputs.ranges[i].trusted for i in pairs)
    return {"from_s": TRUSTED_FROM_S, "pairs": len(pairs), "trusted": trusted}


def _counts(outputs: PipelineOutputs, shots: Shots) -> dict[str, Any]:
    trusted = [entry for entry in outputs.ranges.values() if entry.trusted]
    reasons = Counter(str(entry.reject) for entry in outputs.ranges.values() if not entry.trusted)
    return {
        "planned": dict(sorted(Counter(str(plan.firing) for plan in outputs.plans.values()).items())),
        "fates": outputs.plan_outcomes.counts(),
        "fired": len(outputs.shots),
        "pairs": len(outputs.matches),
        "corrected": len(outputs.ranges),
        "trusted": len(trusted),
        "not_trusted": dict(sorted(reasons.items())),
        "no_range": {
            str(reason): outputs.rejected[str(reason)] for reason in _NO_RANGE if outputs.rejected[str(reason)]
        },
        "judged": len(shots.ids),
    }


def _series(
    geometry: TrueGeometry, outputs: PipelineOutputs, shots: Shots, ways: dict[str, Scored], blur: dict[str, Floats]
) -> dict[str, Floats]:
    """Series that the picture shows."""
    series: dict[str, Floats] = {
        "t_s": shots.t_s,
        "true_toe_rad": np.array([geometry.true_toe_rad(outputs.matches[pair_id]) for pair_id in shots.ids]),
        "toe_rad": np.array([outputs.ranges[pair_id].toe_rad for pair_id in shots.ids]),
        "toe_sigma_rad": np.array([outputs.ranges[pair_id].toe_sigma_rad for pair_id in shots.ids]),
    }
    for name, way in ways.items():
        series |= {f"{name}.t_s": way.t_s, f"{name}.z_true_m": way.z_true_m, f"{name}.range_m": way.range_m,
                   f"{name}.toe_error_rad": way.toe_error_rad}  # fmt: skip
    series["corrected.sigma_m"] = np.array([outputs.ranges[pair_id].sigma_m for pair_id in shots.ids])
    return series | {f"blur.{name}": values for name, values in blur.items()}
