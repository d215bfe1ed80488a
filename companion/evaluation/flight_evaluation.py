"""After a simulated flight: every shot of the recording judged by the truth, and the same flight flown two other ways.

"Vertical accelerometers alone" replays the recording with every other axis of the wing nodes hidden; "random instants"
renders the same flight at instants that have nothing to do with the wing, and corrects those with the same estimates.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.recording_factory import open_recording
from companion.evaluation.accuracy_targets import honesty, peak_errors_s, targets, trigger_summary, wing_blur_px
from companion.evaluation.metrics import Scored, range_summary, toe_summary
from companion.evaluation.plan_outcomes import Fates
from companion.evaluation.rendered_shots import Pull, Seen, Stage, Studios
from companion.evaluation.replay import drive, own_inputs
from companion.evaluation.true_geometry import Judge, Reading
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import (
    Axis,
    CorrectedRange,
    Deflection,
    Floats,
    ImuBatch,
    MatchSet,
    Record,
    Reject,
    Rejected,
    RelativeRotation,
    Shot,
    Station,
    Tick,
    TriggerPlan,
)
from companion.sim.flight.flight import Flight

SETTLED_S = 10.0
WAYS = ("rigid", "rigid_in_trim", "tilt_only", "corrected", "oracle")
_RANDOM_RATE_HZ = 4.0
_RANDOM_SEED = 0xA11  # convention: keeps random instants apart from the flight's own draws
_ARRIVAL_NS = 100_000_000
_NO_RANGE = (Reject.FRAME_LOST, Reject.UNPAIRED, Reject.OUT_OF_WINDOW, Reject.QUEUE_FULL)
"""What happens to images on their way; nothing else is refused for these reasons."""


@dataclass(slots=True)
class Flown:
    """Outputs of one run of the pipeline over the shots."""

    matches: dict[int, MatchSet] = field(default_factory=dict)
    ranges: dict[int, CorrectedRange] = field(default_factory=dict)
    bends: dict[int, tuple[Deflection, Deflection]] = field(default_factory=dict)
    turned: dict[int, RelativeRotation] = field(default_factory=dict)
    plans: dict[int, TriggerPlan] = field(default_factory=dict)
    shots: dict[int, Shot] = field(default_factory=dict)
    rejected: Counter[str] = field(default_factory=Counter)
    fates: Fates = field(default_factory=Fates)


@dataclass(frozen=True, slots=True)
class Debrief:
    """``plain`` is summary.json; ``series`` are the arrays that the picture shows."""

    plain: dict[str, Any]
    series: dict[str, Floats]


def debrief(
    flight: Flight, stage: Stage, recording: Path, report: dict[str, Any], *, compare: bool, say: Callable[[str], None]
) -> Debrief:
    """Judge one recorded flight.

    Parameters
    ----------
    flight
        The truth.
    stage
        What was filmed, the settings in force, and the host time of boot time 0.
    recording
        What the service recorded.
    report
        What the autopilot's side received.
    compare
        Also replay with vertical accelerometers alone, and render at random instants.
    say
        Progress.
    """
    opened, settings = open_recording(recording), stage.settings
    judge = Judge(flight, stage.renderer(), settings, stage.start_host_ns)
    inputs = list(own_inputs(opened.records(), opened.airframe, settings))
    flown = collect(opened.records())
    shots = judged(judge, flown)
    ways = dict(shots.ways)
    blur = {"at_plan": wing_blur_px(judge, [flown.matches[pair_id] for pair_id in shots.ids])}
    others: dict[str, Shots] = {}
    if compare:
        others, blur["at_random"] = _compared(judge, stage, inputs, say)
        ways |= {name: other.ways["corrected"] for name, other in others.items()}
    plain: dict[str, Any] = {
        "airframe": flight.airframe.name,
        "seed": flight.seed,
        "duration_s": flight.duration_s,
        "truth": _truth(flight),
        "toe_error_mrad": {name: toe_summary(way) for name, way in ways.items()},
        "range_error_m": {name: range_summary(way) for name, way in ways.items()},
        "against_corrected": {name: paired(shots, other) for name, other in others.items()},
        "targets": targets(ways),
        "sigma": honesty(shots, flown),
        "trigger": trigger_summary(judge, flown, shots, blur),
        "shots": _counts(flown, shots),
        "published": {key: report.get(key) for key in ("received", "ranges_used", "range_timeouts", "problems")},
        "refused": dict(sorted(flown.rejected.items())),
    }
    return Debrief(json_plain(plain), _series(judge, flown, shots, ways, blur))


def json_plain(value: Any) -> Any:
    """The same with None for every number that JSON does not have: of no shots there is no rms."""
    if isinstance(value, dict):
        return {key: json_plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _compared(
    judge: Judge, stage: Stage, inputs: list[Record], say: Callable[[str], None]
) -> tuple[dict[str, Shots], Floats]:
    """The same flight with vertical accelerometers alone, and at random instants (whose blur is the second result)."""
    airframe, settings = judge.flight.airframe, judge.settings
    say("replaying with vertical accelerometers alone ...")
    vertical = judged(judge, replayed(vertical_only(inputs), airframe, settings))
    say("rendering the same flight at random instants ...")
    with Studios(stage) as studios:
        extra = matches_of(studios.all(_random_pulls(judge)))
    random = judged(judge, replayed(with_matches(inputs, extra), airframe, settings))
    return {"vertical_only": vertical, "random_instants": random}, wing_blur_px(judge, extra)


# ------------------------------------------------------------------------------------------------ collecting


def collect(records: Iterable[Record]) -> Flown:
    """Sort one run's records by what they are about."""
    flown = Flown()
    bends: dict[int, Deflection] = {}
    for record in records:
        flown.fates.take(record)
        if isinstance(record, MatchSet):
            flown.matches[record.pair_id] = record.features()
        elif isinstance(record, Deflection):
            bends[record.t_host_ns] = record
        elif isinstance(record, RelativeRotation):
            flown.turned[record.pair_id] = record
        elif isinstance(record, CorrectedRange):
            flown.ranges[record.pair_id] = record
            left, right = (bends[int(t_ns)] for t_ns in flown.matches[record.pair_id].mid_exposure_ns)
            flown.bends[record.pair_id] = (left, right)
            bends.clear()
        elif isinstance(record, TriggerPlan):
            flown.plans[record.plan_id] = record
        elif isinstance(record, Shot):
            flown.shots[record.plan_id] = record
        elif isinstance(record, Rejected):
            flown.rejected[str(record.reason)] += record.count
    return flown


def replayed(inputs: Iterable[Record], airframe: Airframe, settings: Settings) -> Flown:
    """Outputs of the pipeline for these inputs."""
    kept: list[Record] = []

    def watched() -> Iterator[Record]:
        for record in inputs:
            if isinstance(record, MatchSet):
                kept.append(record)
            yield record

    for output in drive(watched(), airframe, settings, None):
        kept.append(output)
    return collect(kept)


def vertical_only(inputs: Iterable[Record]) -> Iterator[Record]:
    """The same inputs with every axis of the wing nodes hidden but the vertical accelerometer (the paper's case)."""
    for record in inputs:
        if isinstance(record, ImuBatch) and record.station is not Station.ROOT:
            values = np.zeros_like(record.values)
            values[:, 2] = record.values[:, 2]
            record = dataclasses.replace(record, values=values, axes=record.axes & Axis.Z)
        yield record


def _random_pulls(judge: Judge) -> list[Pull]:
    """Pulls of the line at instants that know nothing of the wing."""
    flight = judge.flight
    rng = np.random.default_rng([flight.seed, _RANDOM_SEED])
    count = max(int((flight.duration_s - SETTLED_S - 1.0) * _RANDOM_RATE_HZ), 0)
    edges_s = SETTLED_S + (np.arange(count) + rng.uniform(0, 1, count)) / _RANDOM_RATE_HZ
    return pulls(edges_s, judge.start_host_ns)


def pulls(edges_s: Floats, start_host_ns: int) -> list[Pull]:
    """Pulls of the line at ``edges_s`` (boot time), whose matches are ready a tenth of a second later."""
    edges_ns = [start_host_ns + int(edge_s * 1e9) for edge_s in edges_s]
    return [Pull(shot, edge_ns, edge_ns + _ARRIVAL_NS) for shot, edge_ns in enumerate(edges_ns)]


def matches_of(shots: Iterable[Seen]) -> list[MatchSet]:
    """The matches of many shots."""
    return [record for seen in shots for record in seen if isinstance(record, MatchSet)]


def with_matches(inputs: Iterable[Record], extra: Iterable[MatchSet]) -> Iterator[Record]:
    """The inputs with other matches put in the place of the recorded ones."""
    waiting = deque(sorted(extra, key=lambda matches: matches.matched_host_ns))
    for record in inputs:
        if isinstance(record, MatchSet):
            continue
        while isinstance(record, Tick) and waiting and waiting[0].matched_host_ns <= record.now_host_ns:
            yield waiting.popleft()
        yield record


# ------------------------------------------------------------------------------------------------ judging


@dataclass(frozen=True, slots=True)
class Shots:
    """The settled shots of one run: ids, exposure instants (s of boot time), and each way's readings."""

    ids: list[int]
    t_s: Floats
    ways: dict[str, Scored]


def judged(judge: Judge, flown: Flown) -> Shots:
    """Read every settled shot in all ways; a shot that one way cannot read is left out of all."""
    rows: list[tuple[int, float, dict[str, Reading]]] = []
    for pair_id in sorted(flown.bends):
        matches = flown.matches[pair_id]
        t_s = (float(matches.mid_exposure_ns.mean()) - judge.start_host_ns) * 1e-9
        if t_s < SETTLED_S:
            continue
        readings = {
            "rigid": judge.rigid(matches),
            "rigid_in_trim": judge.rigid_in_trim(matches),
            "tilt_only": judge.corrected(matches, *flown.bends[pair_id]),
            "corrected": judge.corrected(matches, *flown.bends[pair_id], flown.turned.get(pair_id)),
            "oracle": judge.oracle(matches),
        }
        complete = {name: reading for name, reading in readings.items() if reading is not None}
        if len(complete) == len(readings):
            rows.append((pair_id, t_s, complete))
    return Shots([row[0] for row in rows], np.array([row[1] for row in rows]), _ways(judge, rows))


def paired(shots: Shots, other: Shots) -> dict[str, Any]:
    """Another run's corrected ranges against ours, shot by shot where both judged the same exposures.

    ``same`` says whether all of them are the same; ``nearer`` is the share of the common ones in which the other is
    nearer the truth. Pair ids of different flights mean different shots, so instants count, not ids.
    """
    _, ours, theirs = np.intersect1d(shots.t_s, other.t_s, assume_unique=True, return_indices=True)
    error, other_error = (run.ways["corrected"].toe_error_rad[at] for run, at in ((shots, ours), (other, theirs)))
    found: dict[str, Any] = {"n": len(ours), "same": len(ours) == len(shots.ids) == len(other.ids)}
    if len(ours):
        found["rms_mrad"] = {name: 1e3 * float(np.sqrt(np.mean(e**2))) for name, e in
                             (("corrected", error), ("other", other_error))}  # fmt: skip
        found["nearer"] = float(np.mean(np.abs(other_error) < np.abs(error)))
    return found


def _ways(judge: Judge, rows: list[tuple[int, float, dict[str, Reading]]]) -> dict[str, Scored]:
    t_s = np.array([row[1] for row in rows])
    ways = {}
    for name in WAYS:
        inverse = np.array([row[2][name].inverse_pm for row in rows])
        true_m = np.array([1.0 / row[2][name].true_inverse_pm for row in rows])
        ways[name] = Scored(name, judge.baseline_m, t_s, true_m, inverse)
    return ways


# ------------------------------------------------------------------------------------------------ telling


def _truth(flight: Flight) -> dict[str, float]:
    wing = flight.real.actual.wing
    return {
        "frequency_hz": wing.symmetric.frequency_hz.value,
        "damping": wing.symmetric.damping.value,
        "antisymmetric_hz": wing.antisymmetric.frequency_hz.value,
        "gust_rms_mm": 1e3 * wing.gust.deflection_rms_m.value,
        "trim_bend_mm": 1e3 * wing.trim_bend_m.value,
    }


def _counts(flown: Flown, shots: Shots) -> dict[str, Any]:
    trusted = [entry for entry in flown.ranges.values() if entry.trusted]
    reasons = Counter(str(entry.reject) for entry in flown.ranges.values() if not entry.trusted)
    return {
        "planned": dict(sorted(Counter(str(plan.firing) for plan in flown.plans.values()).items())),
        "fates": flown.fates.counts(),
        "fired": len(flown.shots),
        "pairs": len(flown.matches),
        "corrected": len(flown.ranges),
        "trusted": len(trusted),
        "not_trusted": dict(sorted(reasons.items())),
        "no_range": {str(reason): flown.rejected[str(reason)] for reason in _NO_RANGE if flown.rejected[str(reason)]},
        "judged": len(shots.ids),
    }


def _series(
    judge: Judge, flown: Flown, shots: Shots, ways: dict[str, Scored], blur: dict[str, Floats]
) -> dict[str, Floats]:
    """Series that the picture shows."""
    series: dict[str, Floats] = {
        "t_s": shots.t_s,
        "true_toe_rad": np.array([judge.true_toe_rad(flown.matches[pair_id]) for pair_id in shots.ids]),
        "toe_rad": np.array([flown.ranges[pair_id].toe_rad for pair_id in shots.ids]),
        "toe_sigma_rad": np.array([flown.ranges[pair_id].toe_sigma_rad for pair_id in shots.ids]),
        "peak_error_s": peak_errors_s(judge, flown, [flown.matches[pair_id] for pair_id in shots.ids]),
    }
    for name, way in ways.items():
        series |= {f"{name}.t_s": way.t_s, f"{name}.z_true_m": way.z_true_m, f"{name}.range_m": way.range_m,
                   f"{name}.toe_error_rad": way.toe_error_rad}  # fmt: skip
    series["corrected.sigma_m"] = np.array([flown.ranges[pair_id].sigma_m for pair_id in shots.ids])
    return series | {f"blur.{name}": values for name, values in blur.items()}
