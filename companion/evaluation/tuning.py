"""Parameters tried on a recording: the same flight estimated again with one value changed, and what that is worth.

A replay uses the images of the flight, so ranges come from the recorded pairs. With other values the planner would have
fired other shots: they are counted in a second replay, in which each plan is fired as planned. No truth is known; a
change is proposed where it improves one figure by a twentieth and worsens none by a fiftieth.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.recording_factory import open_recording
from companion.errors import RecordingError
from companion.evaluation.metrics import rms
from companion.evaluation.replay import drive, own_inputs
from companion.params.settings import Settings, tunables
from companion.records import ClockName, CorrectedRange, Firing, ParameterChange, Record, Shot, Tick, TriggerPlan

_BETTER_RATIO = 0.05  # a gain that is worth a change (choice)
_WORSE_RATIO = 0.02  # a loss that is none (choice)
JUDGED = (
    f"Better is {100 * _BETTER_RATIO:g} % and more, worse {100 * _WORSE_RATIO:g} % and more; "
    "what is nearer to the truth no replay can tell"
)
"""How trials are judged, in a sentence."""
_NEIGHBOURS_S = 1.0  # trusted ranges that are compared with each other (choice)
_FACTORS: dict[str, tuple[float, ...]] = {
    "TRK_LAG": (0.5, 1.6),
    "TRK_CALM": (0.5, 2.0),
    "TRG_SIGMA": (0.5, 2.0),
    "TRG_BLUR": (0.5, 2.0),
    "RNG_TRUST": (0.5, 2.0),
    "RNG_MATCHES": (0.5, 2.0),
}
_SWITCHES = ("TRK_ADAPT", "RNG_EPIPOLAR")


@dataclass(frozen=True, slots=True)
class ParameterTrial:
    """One set of changes to the settings that were flown, by MAVLink name."""

    changes: tuple[tuple[str, float], ...]

    @property
    def text(self) -> str:
        """The changes in words."""
        return ", ".join(f"{name} {value:g}" for name, value in self.changes) or "as flown"

    def over(self, settings: Settings) -> Settings:
        """The settings with the changes put in.

        Raises
        ------
        ConfigError
            A value that is out of range.
        """
        return settings.with_values(dict(self.changes))


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """Figures of the flight, replayed with the trial's values.

    ``shots`` are those that the planner would have fired, ``skipped`` the plans to skip with a reason; ``trusted``
    ranges would have been published. ``sigma_ratio`` is their median of sigma over range, 0 without any;
    ``scatter_ratio`` the rms of differences of neighbours over their own sigmas, about 1 over flat ground; ``delay_s``
    their median age when they go out.
    """

    shots: int
    skipped: int
    ranges: int
    trusted: int
    sigma_ratio: float
    scatter_ratio: float
    delay_s: float


def usual_trials(settings: Settings) -> list[ParameterTrial]:
    """Trials worth making on any flight: halves and doubles within range, and switches turned."""
    rows = {row.name: row for row in tunables()}
    trials = []
    for name, factors in _FACTORS.items():
        row = rows[name]
        now = float(settings.values()[name])
        tried = [min(max(factor * now, row.minimum), row.maximum) for factor in factors]
        tried = [float(round(value)) if row.integer else float(f"{value:.3g}") for value in tried]
        trials += [ParameterTrial(((name, value),)) for value in dict.fromkeys(tried) if value != now]
    return trials + [ParameterTrial(((name, 1.0 - settings.values()[name]),)) for name in _SWITCHES]


def try_out(path: Path, trial: ParameterTrial) -> TrialOutcome:
    """Estimate a recording of ours again with a trial's settings.

    Raises
    ------
    RecordingError
        The recording is not one of ours.
    """
    recording = open_recording(path, None)
    if recording.hub is not ClockName.HOST or not isinstance(recording, McapRecording):
        raise RecordingError(f"{path}: only recordings of Spanwise hold the pairs that ranges are made of")
    now_ns = [0]
    settings = trial.over(recording.settings)
    inputs = _flown(own_inputs(recording.records(), recording.airframe, settings), trial, now_ns)
    ranges: list[CorrectedRange] = []
    delays_s: list[float] = []
    for output in drive(inputs, recording.airframe, settings, None):
        if isinstance(output, CorrectedRange):
            ranges.append(output)
            delays_s += [1e-9 * (now_ns[0] - output.t_host_ns)] if output.trusted else []
    trusted = [entry for entry in ranges if entry.trusted]
    shots, skipped = fired_as_planned(recording, trial)
    return TrialOutcome(
        shots=shots,
        skipped=skipped,
        ranges=len(ranges),
        trusted=len(trusted),
        sigma_ratio=float(np.median([entry.sigma_m / entry.range_m for entry in trusted])) if trusted else 0.0,
        scatter_ratio=scatter(trusted),
        delay_s=float(np.median(delays_s)) if delays_s else 0.0,
    )


def fired_as_planned(recording: Recording, trial: ParameterTrial) -> tuple[int, int]:
    """Shots of the trial's own plans, and plans to skip: the recorded shots belong to the plans that were flown."""
    settings = trial.over(recording.settings)
    open_plans: list[TriggerPlan] = []
    shots = skipped = 0

    def fired() -> Iterator[Record]:
        nonlocal shots
        inputs = own_inputs(recording.records(), recording.airframe, settings)
        for record in _flown(inputs, trial, [0]):
            if isinstance(record, Shot):
                continue
            if isinstance(record, Tick) and open_plans and open_plans[0].command_host_ns <= record.now_host_ns:
                plan = open_plans.pop()
                shots += 1
                yield Shot(plan.plan_id, plan.command_host_ns, plan.command_host_ns)
            yield record

    for output in drive(fired(), recording.airframe, settings, None):
        if isinstance(output, TriggerPlan):  # the newest plan replaces the one before
            skips = output.firing is Firing.SKIP
            open_plans[:] = [] if skips else [output]
            skipped += skips
    return shots, skipped


def _flown(inputs: Iterable[Record], trial: ParameterTrial, now_ns: list[int]) -> Iterator[Record]:
    """The inputs, without in-flight changes of the parameters on trial; notes the time of the last tick."""
    names = {name for name, _ in trial.changes}
    for record in inputs:
        if isinstance(record, Tick):
            now_ns[0] = record.now_host_ns
        if not (isinstance(record, ParameterChange) and record.name in names):
            yield record


def scatter(trusted: list[CorrectedRange]) -> float:
    """Rms of neighbours' differences over their sigmas; 0 for fewer than two neighbours."""
    pairs = [
        (after.range_m - before.range_m) / np.hypot(after.sigma_m, before.sigma_m)
        for before, after in itertools.pairwise(trusted)
        if after.t_host_ns - before.t_host_ns <= _NEIGHBOURS_S * 1e9
    ]
    return rms(pairs) if pairs else 0.0


def verdict_of(flown: TrialOutcome, tried: TrialOutcome) -> tuple[bool, str]:
    """Whether a trial is worth a change, and why or why not."""
    if not tried.trusted:
        return False, "no range would be trusted"
    gains = {
        "more trusted ranges": _gain(flown.trusted, tried.trusted),
        "smaller sigma": -_gain(flown.sigma_ratio, tried.sigma_ratio),
        "earlier ranges": -_gain(flown.delay_s, tried.delay_s),
        "more shots": _gain(flown.shots, tried.shots),
    }
    growth = _gain(max(flown.scatter_ratio, 1.0), max(tried.scatter_ratio, 1.0))
    losses = [_opposite(name) for name, gain in gains.items() if gain < -_WORSE_RATIO]
    losses += ["ranges scatter more than their sigmas say"] if growth > _BETTER_RATIO else []
    better = [name for name, gain in gains.items() if gain >= _BETTER_RATIO]
    if better and not losses:
        return True, ", ".join(better)
    if better:
        return False, f"{', '.join(better)}, but {', '.join(losses)}"
    return False, ", ".join(losses) or "no difference that counts"


def _gain(before: float, after: float) -> float:
    return (after - before) / before if before else (1.0 if after else 0.0)


def _opposite(name: str) -> str:
    opposites = {"more": "fewer", "smaller": "larger", "earlier": "later"}
    first, _, rest = name.partition(" ")
    return f"{opposites[first]} {rest}"
