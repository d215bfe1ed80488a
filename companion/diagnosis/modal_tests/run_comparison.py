"""Comparison of runs: causes of a frequency that changed from run to run, and whether these runs can tell.

What was set once per run (a sensor's position, a temperature) is told from mere run order only where a value was left
and came back: then runs of equal value must agree if it is the cause, whenever they were made. A channel none of whose
values came back goes hand in hand with run order, whatever its numbers are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from companion.core.wing.effects.stiffness.covariate_frequency import CovariateFrequency
from companion.diagnosis.modal_tests.vibration import ModeOverRuns
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.records import Floats

CHANGED = 5.0
"""Standard deviations of one run's frequency from which a change is no chance."""
_WORTH = 0.002  # smaller relative changes are told, but asked no cause
_SAME = 0.02  # of a channel's range: values that count as equal
ORDER = "run_order"
_LONGEST_UNIT = 5  # characters of a column's unit suffix
_LOG_SMALLEST = -600.0  # exponents below underflow


@dataclass(frozen=True, slots=True)
class Channel:
    """One thing set per run.

    ``came_back`` tells whether a value was left and returned to; ``agree_z`` how far runs of equal value are from
    agreeing (None where no value came back).
    """

    name: str
    came_back: bool
    agree_z: float | None


@dataclass(frozen=True, slots=True)
class ChangedMode:
    """A mode whose frequency changed.

    Attributes
    ----------
    mode : ModeOverRuns
    first, last : int
        The last run of the steady beginning, and the run that differs most from it.
    z : float
        Of all runs against one frequency.
    channels : tuple of Channel
    """

    mode: ModeOverRuns
    first: int
    last: int
    z: float
    channels: tuple[Channel, ...]

    @property
    def change_hz(self) -> float:
        """From the steady beginning to the run that differs most."""
        f_hz = self.mode.frequency_hz
        return float(f_hz[self.last] - f_hz[self.first])

    def causes(self) -> list[Channel]:
        """Channels whose values came back, and the frequency with them."""
        return [
            channel
            for channel in self.channels
            if channel.came_back and channel.agree_z is not None and channel.agree_z < CHANGED
        ]

    def confounded(self) -> list[str]:
        """Channels that go hand in hand with run order."""
        return [channel.name for channel in self.channels if not channel.came_back]


@dataclass(frozen=True, slots=True)
class Comparison:
    """All modes of all runs, those that changed (most first), and the verdict with its reason."""

    modes: tuple[ModeOverRuns, ...]
    changed: tuple[ChangedMode, ...]
    verdict: DiagnosisVerdict
    reason: str
    advice: tuple[str, ...]


def compare(modes: Sequence[ModeOverRuns], constants: Sequence[Mapping[str, float]]) -> Comparison:
    """Judge modes by run, ``constants`` being what was set in each."""
    candidates = [_changed(mode, constants) for mode in modes]
    changed = sorted(
        (mode for mode in candidates if mode is not None), key=lambda mode: -abs(mode.change_hz) / _middle(mode.mode)
    )
    if not changed:
        reason = f"every frequency is the same in all {len(constants)} runs, to {100 * _WORTH:g} %"
        return Comparison(tuple(modes), (), DiagnosisVerdict.ADEQUATE, reason, ())
    leading = changed[0]
    causes = leading.causes()
    if causes:
        return Comparison(tuple(modes), tuple(changed), DiagnosisVerdict.EXPLAINED, _explained(leading, causes), ())
    if leading.confounded():
        return Comparison(
            tuple(modes),
            tuple(changed),
            DiagnosisVerdict.NOT_IDENTIFIABLE,
            _not_identifiable(leading),
            _advice(leading),
        )
    reason = f"{_change_in_words(leading)}; nothing that was recorded of the runs goes with it"
    return Comparison(
        tuple(modes), tuple(changed), DiagnosisVerdict.UNEXPLAINED, reason, ("record what differs between runs",)
    )


def _changed(mode: ModeOverRuns, constants: Sequence[Mapping[str, float]]) -> ChangedMode | None:
    f_hz, sigma = mode.frequency_hz, mode.sigma_hz
    z = disagreement(f_hz, sigma)
    if z < CHANGED or float(np.ptp(f_hz)) < _WORTH * _middle(mode):
        return None
    first = _end_of_steady(f_hz, sigma)
    last = int(np.argmax(np.abs(f_hz - f_hz[: first + 1].mean())))
    names = [name for name in constants[0] if name != ORDER and len({run.get(name) for run in constants}) > 1]
    channels = tuple(_channel(name, [float(run[name]) for run in constants], f_hz, sigma) for name in names)
    return ChangedMode(mode, first, last, z, channels)


def disagreement(values: Floats, sigmas: Floats) -> float:
    """Distance of values with these sigmas from one common value, as a standard normal (one-sided)."""
    if len(values) < 2:
        return 0.0
    weight = 1.0 / sigmas**2
    deviation = float(np.sum(weight * (values - np.sum(weight * values) / weight.sum()) ** 2))
    tail = float(chi2.logsf(deviation, len(values) - 1))
    if tail > _LOG_SMALLEST:
        return float(norm.isf(math.exp(tail)))
    return math.sqrt(-2.0 * tail) if math.isfinite(tail) else math.sqrt(deviation)


def _end_of_steady(f_hz: Floats, sigma: Floats) -> int:
    """The last run that agrees with all before it."""
    end = 0
    for k in range(1, len(f_hz)):
        if disagreement(f_hz[: k + 1], sigma[: k + 1]) > CHANGED:
            break
        end = k
    return end


def _channel(name: str, values: Sequence[float], f_hz: Floats, sigma: Floats) -> Channel:
    label = _labels(values)
    if not _came_back(label):
        return Channel(name, False, None)
    groups = [np.flatnonzero(np.array(label) == k) for k in sorted(set(label))]
    worst = max(disagreement(f_hz[group], sigma[group]) for group in groups)
    return Channel(name, True, worst)


def _labels(values: Sequence[float]) -> list[int]:
    """Number the distinct values of a channel."""
    order = np.argsort(values)
    near = _SAME * float(np.ptp(values))
    label, at = [0] * len(values), 0
    for before, k in itertools.pairwise(order):
        at += values[k] - values[before] > near
        label[k] = int(at)
    return label


def _came_back(label: Sequence[int]) -> bool:
    """Whether a value was left and taken again later."""
    stretches = [key for key, _ in itertools.groupby(label)]
    return len(stretches) > len(set(stretches))


def _middle(mode: ModeOverRuns) -> float:
    return float(np.median(mode.frequency_hz))


def _change_in_words(changed: ChangedMode) -> str:
    runs, f_hz = changed.mode.runs, changed.mode.frequency_hz
    return (
        f"the frequency changed between runs {runs[changed.first]} and {runs[changed.last]} "
        f"({f_hz[changed.first]:.2f} -> {f_hz[changed.last]:.2f} Hz)"
    )


def _plainly(name: str) -> str:
    """A channel's name without its unit: ``sensor_position_m`` is the sensor position."""
    stem, _, unit = name.rpartition("_")
    return (stem if stem and len(unit) <= _LONGEST_UNIT else name).replace("_", " ")


def _explained(changed: ChangedMode, causes: Sequence[Channel]) -> str:
    named = " or ".join(_plainly(cause.name) for cause in causes)
    return f"{_change_in_words(changed)}; runs of equal {named} agree, whenever they were made"


def _not_identifiable(changed: ChangedMode) -> str:
    names = [_plainly(name) for name in changed.confounded()]
    return (
        f"{_change_in_words(changed)}, but its cause is not identifiable: {' and '.join(['run order', *names])} "
        f"are confounded, for no {' and no '.join(names)} was measured again later{_ruled_out(changed)}"
    )


def _ruled_out(changed: ChangedMode) -> str:
    """Clause on channels that came back while the frequency did not."""
    names = [
        _plainly(channel.name) for channel in changed.channels if channel.came_back and channel not in changed.causes()
    ]
    return f"; {' and '.join(names)} came back and the frequency did not, so alone that is not it" if names else ""


def _advice(changed: ChangedMode) -> tuple[str, ...]:
    names = " and ".join(_plainly(name) for name in changed.confounded())
    runs = changed.mode.runs
    return (
        f"measure once more with the {names} of run {runs[0]} after run {runs[-1]}: the frequency of run {runs[0]} "
        f"again means that the {names} is the cause, another one that time or handling is",
        f"take every {names} at least twice, in random order",
        "put dummy masses like the sensors on every position, so that moving a sensor moves no mass",
        "write down temperature, suspension and what was touched between runs",
    )


def as_json(comparison: Comparison, recordings: Sequence[str], airframe: str | None) -> dict[str, Any]:
    """The comparison in the layout of every diagnosis (companion/diagnosis/README.md)."""
    return {
        "format": 1,
        "recordings": list(recordings),
        "airframe": airframe,
        "verdict": str(comparison.verdict),
        "reason": comparison.reason,
        "causes": _causes(comparison),
        "nearest": None,
        "gain": None,
        "adequacy": {"before": [_check(mode) for mode in comparison.modes], "after": []},
        "residual": None
        if comparison.verdict is not DiagnosisVerdict.UNEXPLAINED
        else {"description": comparison.reason, "failed": []},
        "confounded": _confounded(comparison),
        "advice": list(comparison.advice),
        "modes": [_mode(mode) for mode in comparison.modes],
        "airframe_parameters": [],
        "notes": [_note(changed) for changed in comparison.changed[1:]],
    }


def _confounded(comparison: Comparison) -> list[str]:
    if comparison.verdict is not DiagnosisVerdict.NOT_IDENTIFIABLE:
        return []
    return [ORDER, *comparison.changed[0].confounded()]


def _causes(comparison: Comparison) -> list[dict[str, Any]]:
    if comparison.verdict is not DiagnosisVerdict.EXPLAINED:
        return []
    leading = comparison.changed[0]
    causes = leading.causes()
    f_hz = leading.mode.frequency_hz
    same = [cause.name for cause in causes[1:]]
    factor = 0.5 * (leading.z**2 - (causes[0].agree_z or 0.0) ** 2)
    return [
        {
            "name": CovariateFrequency.name,
            "channel": causes[0].name,
            "group": [f"{CovariateFrequency.name} ({name})" for name in same],
            "log_bayes_factor": factor,
            "bic": -2.0 * factor,
            "z": leading.z,
            "parameters": {
                "range": {
                    "value": float(np.ptp(f_hz)),
                    "sigma": float(np.hypot(*leading.mode.sigma_hz[[int(np.argmin(f_hz)), int(np.argmax(f_hz))]])),
                    "unit": "Hz",
                    "interval": [],
                    "meaning": "between the lowest and the highest frequency of all runs",
                }
            },
            "gain": None,
            "advice": CovariateFrequency.advice,
        }
    ]


def _check(mode: ModeOverRuns) -> dict[str, Any]:
    z = disagreement(mode.frequency_hz, mode.sigma_hz)
    return {"test": f"one frequency near {_middle(mode):.2f} Hz in all runs", "z": z, "passed": z < CHANGED}


def _mode(mode: ModeOverRuns) -> dict[str, Any]:
    return {
        "near_hz": _middle(mode),
        "runs": list(mode.runs),
        "frequency_hz": mode.frequency_hz.tolist(),
        "sigma_hz": mode.sigma_hz.tolist(),
        "damping": [run.damping for run in mode.of_runs],
    }


def _note(changed: ChangedMode) -> str:
    runs, f_hz = changed.mode.runs, changed.mode.frequency_hz
    percent = 100.0 * changed.change_hz / f_hz[changed.first]
    return (
        f"also near {_middle(changed.mode):.2f} Hz: {percent:+.1f} % "
        f"from run {runs[changed.first]} to run {runs[changed.last]}"
    )
