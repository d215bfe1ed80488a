"""The verdict on a vibration test as plain data (companion/diagnosis/JSON.md)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from companion.core.wing.effects.stiffness.covariate_frequency import CovariateFrequency
from companion.diagnosis.json_rows import cause_head, checks, held_out_gain, opening, quantity, residual
from companion.diagnosis.modal_tests.frequency_changes import NOTABLE_CHANGE, ORDER, ChangedMode
from companion.diagnosis.modal_tests.recordings import ONE_RUN, ModalTestDiagnosis
from companion.diagnosis.modal_tests.vibration import ModeOverRuns
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.recordings import Cause
from companion.diagnosis.selection.regression import RegressionTerm

_LONGEST_UNIT = 5  # characters of a column's unit suffix (choice)


def as_json(diagnosis: ModalTestDiagnosis, recordings: Sequence[str], airframe: str | None) -> dict[str, Any]:
    """The diagnosis in the layout of every other one."""
    outcome, changed = diagnosis.outcome, diagnosis.changed
    reason = _reason(diagnosis)
    not_identifiable = outcome.verdict is DiagnosisVerdict.NOT_IDENTIFIABLE
    return {
        **opening(recordings, airframe, outcome.verdict, reason),
        "causes": [_cause(diagnosis, cause) for cause in outcome.causes],
        "nearest": outcome.nearest or None,
        "gain": _gain(diagnosis),
        "adequacy": {"before": checks(diagnosis.one_frequency), "after": checks(outcome.after)},
        "residual": residual(outcome.verdict, reason, outcome.after),
        "confounded": [ORDER, *changed[0].confounded()] if not_identifiable and changed else [],
        "advice": _advice(diagnosis),
        "modes": [_mode(mode) for mode in diagnosis.modes],
        "airframe_parameters": [],
        "notes": [_note(entry) for entry in changed[1:]],
    }


def _reason(diagnosis: ModalTestDiagnosis) -> str:
    if not diagnosis.changed:
        runs = len(diagnosis.modes[0].runs)
        if runs < 2:
            return ONE_RUN
        widest = max(float(np.ptp(mode.frequency_hz)) / mode.near_hz for mode in diagnosis.modes)
        if widest < NOTABLE_CHANGE:
            return f"every frequency is the same in all {runs} runs, to {100 * NOTABLE_CHANGE:g} %"
        return f"the frequencies differ between {runs} runs by {100 * widest:.2g} % at most, no more than by chance"
    leading = diagnosis.changed[0]
    change = _change_in_words(leading)
    match diagnosis.outcome.verdict:
        case DiagnosisVerdict.EXPLAINED:
            named = " or ".join(_plainly(name) for name in _equivalent_channels(diagnosis))
            return f"{change}; runs of equal {named} agree, whenever they were made"
        case DiagnosisVerdict.NOT_IDENTIFIABLE:
            return f"{change}, but its cause is not identifiable: {_confounded_in_words(leading)}"
        case _ if leading.causes():
            return f"{change}; {_plainly(leading.causes()[0].name)} goes with it, but: {diagnosis.outcome.reason}"
        case _:
            return f"{change}; nothing that was recorded of the runs goes with it"


def _change_in_words(changed: ChangedMode) -> str:
    runs, f_hz = changed.mode.runs, changed.mode.frequency_hz
    return (
        f"the frequency changed between runs {runs[changed.first]} and {runs[changed.last]} "
        f"({f_hz[changed.first]:.2f} -> {f_hz[changed.last]:.2f} Hz)"
    )


def _equivalent_channels(diagnosis: ModalTestDiagnosis) -> list[str]:
    """The channel named, and others whose equal values agree as well."""
    named = diagnosis.outcome.causes[0].term.channel
    return [named, *(entry.name for entry in diagnosis.changed[0].causes() if entry.name != named)]


def _confounded_in_words(changed: ChangedMode) -> str:
    names = [_plainly(name) for name in changed.confounded()]
    orders = " and ".join(["run order", *names])
    returned = [_plainly(channel.name) for channel in changed.channels if channel.came_back]
    alone = f"; {' and '.join(returned)} came back and the frequency did not, so alone that is not it"
    confounded = f"{orders} are confounded, for no {' and no '.join(names)} was measured again after the change"
    return confounded + (alone if returned else "")


def _plainly(name: str) -> str:
    """A channel's name without its unit: ``sensor_position_m`` is the sensor position."""
    stem, _, unit = name.rpartition("_")
    return (stem if stem and len(unit) <= _LONGEST_UNIT else name).replace("_", " ")


def _advice(diagnosis: ModalTestDiagnosis) -> list[str]:
    match diagnosis.outcome.verdict:
        case DiagnosisVerdict.UNEXPLAINED:
            return ["record what differs between runs"]
        case DiagnosisVerdict.NOT_IDENTIFIABLE if not diagnosis.changed:
            return ["measure further runs, and write down what differs between them"]
        case DiagnosisVerdict.NOT_IDENTIFIABLE:
            return _advice_on_order(diagnosis.changed[0])
        case _:
            return []


def _advice_on_order(changed: ChangedMode) -> list[str]:
    names = " and ".join(_plainly(name) for name in changed.confounded())
    first, last = changed.mode.runs[0], changed.mode.runs[-1]
    return [
        f"measure once more with the {names} of run {first} after run {last}: the frequency of run {first} "
        f"again means that the {names} is the cause, another one that time or handling is",
        f"take every {names} at least twice, in random order",
        "put dummy masses like the sensors on every position, so that moving a sensor moves no mass",
        "write down temperature, suspension and what was touched between runs",
    ]


def _cause(diagnosis: ModalTestDiagnosis, cause: Cause[RegressionTerm]) -> dict[str, Any]:
    f_hz, sigma_hz = diagnosis.changed[0].mode.frequency_hz, diagnosis.changed[0].mode.sigma_hz
    ends = [int(f_hz.argmin()), int(f_hz.argmax())]
    range_sigma_hz = float(sum(sigma_hz[ends] ** 2) ** 0.5)
    meaning = "between the lowest and the highest frequency of all runs"
    return {
        **cause_head(cause, cause.term.channel),
        "group": [f"{CovariateFrequency.name} ({name})" for name in _equivalent_channels(diagnosis)[1:]],
        "parameters": {"range": quantity(float(f_hz.max() - f_hz.min()), range_sigma_hz, "Hz", meaning)},
        "gain": (_gain(diagnosis) or {}).get("error"),
        "advice": CovariateFrequency.advice,
    }


def _gain(diagnosis: ModalTestDiagnosis) -> dict[str, Any] | None:
    gain = diagnosis.outcome.gain
    if gain is None or not gain.predicts:
        return None
    return held_out_gain(gain.before, gain.after, "Hz", "frequency in a run that was not fitted")


def _mode(mode: ModeOverRuns) -> dict[str, Any]:
    return {
        "near_hz": mode.near_hz,
        "runs": list(mode.runs),
        "frequency_hz": mode.frequency_hz.tolist(),
        "sigma_hz": mode.sigma_hz.tolist(),
        "damping": [run.damping for run in mode.of_runs],
    }


def _note(changed: ChangedMode) -> str:
    runs, f_hz = changed.mode.runs, changed.mode.frequency_hz
    percent = 100.0 * changed.change_hz / f_hz[changed.first]
    return (
        f"also near {changed.mode.near_hz:.2f} Hz: {percent:+.1f} % from run {runs[changed.first]}, the last that "
        f"agrees with all before it, to run {runs[changed.last]}, which is furthest from these"
    )
