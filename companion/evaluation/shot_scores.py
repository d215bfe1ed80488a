"""Outputs of one run of the pipeline over a flight's shots, and each shot's reading in every way, beside the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.evaluation.metrics import SETTLED_S, Scored, rms
from companion.evaluation.plan_outcomes import PlanOutcomes
from companion.evaluation.replay import drive
from companion.evaluation.true_geometry import TrueGeometry, TrueReading
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import (
    CorrectedRange,
    Deflection,
    Floats,
    MatchSet,
    Record,
    Rejected,
    RelativeRotation,
    Shot,
    TriggerPlan,
)

WAYS = ("rigid", "rigid_in_trim", "tilt_only", "corrected", "oracle")


@dataclass(slots=True)
class PipelineOutputs:
    """Outputs of one run of the pipeline over the shots."""

    matches: dict[int, MatchSet] = field(default_factory=dict)
    ranges: dict[int, CorrectedRange] = field(default_factory=dict)
    bends: dict[int, tuple[Deflection, Deflection]] = field(default_factory=dict)
    turned: dict[int, RelativeRotation] = field(default_factory=dict)
    plans: dict[int, TriggerPlan] = field(default_factory=dict)
    shots: dict[int, Shot] = field(default_factory=dict)
    rejected: Counter[str] = field(default_factory=Counter)
    plan_outcomes: PlanOutcomes = field(default_factory=PlanOutcomes)


def collect(records: Iterable[Record]) -> PipelineOutputs:
    """Sort one run's records by what they are about."""
    outputs = PipelineOutputs()
    bends: dict[int, Deflection] = {}
    for record in records:
        outputs.plan_outcomes.take(record)
        if isinstance(record, MatchSet):
            outputs.matches[record.pair_id] = record.features()
        elif isinstance(record, Deflection):
            bends[record.t_host_ns] = record
        elif isinstance(record, RelativeRotation):
            outputs.turned[record.pair_id] = record
        elif isinstance(record, CorrectedRange):
            outputs.ranges[record.pair_id] = record
            left, right = (bends[int(t_ns)] for t_ns in outputs.matches[record.pair_id].mid_exposure_ns)
            outputs.bends[record.pair_id] = (left, right)
            bends.clear()
        elif isinstance(record, TriggerPlan):
            outputs.plans[record.plan_id] = record
        elif isinstance(record, Shot):
            outputs.shots[record.plan_id] = record
        elif isinstance(record, Rejected):
            outputs.rejected[str(record.reason)] += record.count
    return outputs


def replayed(inputs: Iterable[Record], airframe: Airframe, settings: Settings) -> PipelineOutputs:
    """Outputs of the pipeline for these inputs."""
    made: list[Record] = []

    def watched() -> Iterator[Record]:
        for record in inputs:
            if isinstance(record, MatchSet):
                made.append(record)
            yield record

    made.extend(drive(watched(), airframe, settings, None))
    return collect(made)


@dataclass(frozen=True, slots=True)
class Shots:
    """The settled shots of one run: ids, exposure instants (s of boot time), and each way's readings."""

    ids: list[int]
    t_s: Floats
    ways: dict[str, Scored]


def score_shots(geometry: TrueGeometry, outputs: PipelineOutputs) -> Shots:
    """Read every settled shot in all ways; a shot that one way cannot read is left out of all."""
    rows: list[tuple[int, float, dict[str, TrueReading]]] = []
    for pair_id in sorted(outputs.bends):
        matches = outputs.matches[pair_id]
        shot_s = (float(matches.mid_exposure_ns.mean()) - geometry.start_host_ns) * 1e-9
        if shot_s < SETTLED_S:
            continue
        readings = {
            "rigid": geometry.rigid(matches),
            "rigid_in_trim": geometry.rigid_in_trim(matches),
            "tilt_only": geometry.corrected(matches, *outputs.bends[pair_id]),
            "corrected": geometry.corrected(matches, *outputs.bends[pair_id], outputs.turned.get(pair_id)),
            "oracle": geometry.oracle(matches),
        }
        complete = {name: reading for name, reading in readings.items() if reading is not None}
        if len(complete) == len(readings):
            rows.append((pair_id, shot_s, complete))
    t_s = np.array([shot_s for _, shot_s, _ in rows])
    ways = {}
    for name in WAYS:
        inverse_pm = np.array([readings[name].inverse_pm for _, _, readings in rows])
        true_m = np.array([1.0 / readings[name].true_inverse_pm for _, _, readings in rows])
        ways[name] = Scored(geometry.baseline_m, t_s, true_m, inverse_pm)
    return Shots([pair_id for pair_id, _, _ in rows], t_s, ways)


def paired(shots: Shots, other: Shots) -> dict[str, Any]:
    """Another run's corrected ranges against ours, shot by shot where both judged the same exposures.

    ``same`` says whether all of them are the same; ``nearer`` is the share of the common ones in which the other is
    nearer the truth. Pair ids of different flights mean different shots, so instants count, not ids.
    """
    _, ours, theirs = np.intersect1d(shots.t_s, other.t_s, assume_unique=True, return_indices=True)
    error, other_error = (run.ways["corrected"].toe_error_rad[at] for run, at in ((shots, ours), (other, theirs)))
    comparison: dict[str, Any] = {"n": len(ours), "same": len(ours) == len(shots.ids) == len(other.ids)}
    if len(ours):
        comparison["rms_mrad"] = {"corrected": 1e3 * rms(error), "other": 1e3 * rms(other_error)}
        comparison["nearer"] = float(np.mean(np.abs(other_error) < np.abs(error)))
    return comparison
