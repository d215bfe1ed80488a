"""The verdict on free decays as plain data, in the layout of every diagnosis (companion/diagnosis/JSON.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from companion.core.wing.effects.damping.coulomb_friction import CoulombFriction
from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.core.wing.effects.modes.close_mode import CloseMode
from companion.core.wing.effects.modes.second_mode import SecondMode
from companion.core.wing.effects.stiffness.covariate_frequency import CovariateFrequency
from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.core.wing.effects.stiffness.frequency_drift import FrequencyDrift
from companion.diagnosis import json_rows
from companion.diagnosis.free_decay.laws import Extension, Law
from companion.diagnosis.free_decay.model import key_of
from companion.diagnosis.free_decay.record import Scale
from companion.diagnosis.free_decay.recordings import FreeDecayDiagnosis
from companion.diagnosis.json_rows import deviation, failures, held_out_gain, quantity
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.cross_validation import HeldOut
from companion.diagnosis.selection.score_tests import Candidate

_CLOSE = 0.12  # two modes within this of each other somewhere in the recordings are close (choice)
_ADVICE = {
    CovariateFrequency.name: "vary the channel independently of time and of the other channels",
    FrequencyDrift.name: "a drift in time has a cause that can be measured: record temperature and settings",
    CloseMode.name: "two close modes beat in free decays: excite each alone, or add a sensor where only one moves",
    SecondMode.name: "a sensor where only one of the two modes moves tells them apart",
    CubicStiffness.name: "record decays from several amplitudes",
    QuadraticDamping.name: "record decays from several amplitudes",
    CoulombFriction.name: "record decays from several amplitudes, and look for what rubs or is loose",
}

_KNOCKS = (
    "nobody measured the knocks: what is left over without a name may be their shape, of a linear structure, too; "
    "see by how much the held-out error falls"
)


def as_json(diagnosis: FreeDecayDiagnosis, scales: Mapping[str, Scale], airframe: str | None) -> dict[str, Any]:
    """Everything that a program would read."""
    named = [i for i, entry in enumerate(diagnosis.accepted) if entry.term.effect and _useful(diagnosis, i)]
    outcome = diagnosis.outcome
    verdict = outcome.verdict
    screened = sorted(outcome.screening.candidates, key=lambda entry: -entry.log_odds)
    unexplained = verdict is DiagnosisVerdict.UNEXPLAINED
    recordings = diagnosis.null.state.recordings
    return {
        **json_rows.opening((record.name for record in recordings), airframe, verdict, _reason(diagnosis, named)),
        "causes": [_cause(diagnosis, i, scales) for i in named],
        "nearest": (name_of(diagnosis.accepted[named[0]].term, diagnosis) if named else None) if unexplained else None,
        "gain": _gain(diagnosis, diagnosis.errors[0], diagnosis.errors[-1]) if diagnosis.accepted else None,
        "adequacy": json_rows.adequacy(outcome.before, outcome.after),
        "residual": _residual(diagnosis) if unexplained else None,
        "screening": [_screened(diagnosis, entry) for entry in screened],
        "modes": _modes(diagnosis, scales),
        "airframe_parameters": _believed(diagnosis),
        "notes": [*(note for record in recordings for note in record.notes), *([_KNOCKS] if unexplained else [])],
    }


def name_of(term: Extension, diagnosis: FreeDecayDiagnosis) -> str:
    """Name of an accepted law; of a second mode by how near it comes to the first."""
    if isinstance(term, Law):
        return term.name
    apart = min(abs(pair["second_hz"] / pair["first_hz"] - 1.0) for pair in _pairs(diagnosis))
    return CloseMode.name if apart < _CLOSE else SecondMode.name


def _useful(diagnosis: FreeDecayDiagnosis, index: int) -> bool:
    """Whether a law predicts blocks that it was not fitted to better, beyond chance."""
    return diagnosis.errors[index + 1].gone(diagnosis.errors[index])[1] > 0.0


def _reason(diagnosis: FreeDecayDiagnosis, named: list[int]) -> str:
    names = ", ".join(_with_channel(diagnosis.accepted[i].term, diagnosis) for i in named)
    remaining = [entry.term.key for entry in diagnosis.accepted if not entry.term.effect]
    failed = [f"{entry.name} {entry.z:+.1f} sigma" for entry in diagnosis.outcome.after if not entry.passed][:2]
    if not (remaining or failed):
        return names or "a mode of constant frequency and damping explains these recordings"
    left_over = "left over: " + "; ".join([*remaining, *failed])
    return f"explained so far: {names}; {left_over}" if names else left_over


def _with_channel(extension: Extension, diagnosis: FreeDecayDiagnosis) -> str:
    name = name_of(extension, diagnosis)
    if isinstance(extension, Law):
        return f"{name} ({extension.channel})" if extension.channel else name
    model, values = diagnosis.final.state, diagnosis.final.values[None, :]
    at_end = [model.modes(values, k).omega_radps[0, -1] for k in range(len(model.recordings))]
    first, second = np.mean(at_end, axis=0) / (2.0 * np.pi)
    return f"{name} ({second:.1f} beside {first:.1f} Hz in the last decay)"


def _descriptions(diagnosis: FreeDecayDiagnosis) -> list[str]:
    """Sentences of the laws that were needed and have no name."""
    sentences = []
    for entry in diagnosis.accepted:
        law = entry.term
        if isinstance(law, Law) and not law.effect:
            value, sigma = diagnosis.final.value(key_of(law))
            sentences.append(f"{law.key} ({law.parameter} {value:+.3g} ± {sigma:.2g}, log Bayes factor "
                        f"{entry.log_bayes_factor:.0f})")  # fmt: skip
    return sentences


def _cause(diagnosis: FreeDecayDiagnosis, index: int, scales: Mapping[str, Scale]) -> dict[str, Any]:
    entry = diagnosis.accepted[index]
    name, law = name_of(entry.term, diagnosis), entry.term
    channel = law.channel if isinstance(law, Law) and law.channel else None
    parameters = _of_law(diagnosis, law, scales) if isinstance(law, Law) else _of_second(diagnosis)
    main = next(iter(parameters.values()))
    return {
        "name": name,
        "channel": channel,
        "group": [],
        "log_bayes_factor": entry.log_bayes_factor,
        "bic": entry.bic,
        "z": abs(main["value"]) / main["sigma"] if isinstance(law, Law) else math.sqrt(2.0 * entry.log_bayes_factor),
        "parameters": parameters,
        "gain": _gain(diagnosis, diagnosis.errors[index], diagnosis.errors[index + 1])["error"],
        "advice": _ADVICE.get(name, ""),
    }


def _of_law(diagnosis: FreeDecayDiagnosis, law: Law, scales: Mapping[str, Scale]) -> dict[str, Any]:
    value, sigma = diagnosis.final.value(key_of(law))
    parameters = {law.parameter: quantity(value, sigma, law.unit, law.meaning)}
    if law.by_amplitude:
        rms_m = diagnosis.final.state.recordings[0].rms_m
        parameters["deflection_rms"] = quantity(rms_m, 0.0, "m", "rms of the deflection where the sensor is")
    if law.channel in scales:
        scale = scales[law.channel]
        unit = law.channel.rpartition("_")[2]
        parameters["channel_mean"] = quantity(scale.mean, 0.0, unit, "mean of the channel, where the ratio is 1")
        parameters["channel_rms"] = quantity(scale.rms, 0.0, unit, "rms of the channel")
    return parameters


def _of_second(diagnosis: FreeDecayDiagnosis) -> dict[str, Any]:
    f_log, f_sigma = diagnosis.final.value("second log frequency")
    z_log, z_sigma = diagnosis.final.value("second log damping")
    p_log, p_sigma = diagnosis.final.value("second log participation")
    follow, follow_sigma = diagnosis.final.value("second follow")
    f_hz, zeta, power = math.exp(f_log), math.exp(z_log), math.exp(p_log)
    return {
        "frequency_hz": quantity(f_hz, f_hz * f_sigma, "Hz", "of the second mode, channels at their mean"),
        "damping": quantity(zeta, zeta * z_sigma, "", "damping ratio of the second mode"),
        "participation": quantity(power, power * p_sigma, "", "power of its load over the first mode's"),
        "follows": quantity(follow, follow_sigma, "", "share of the first mode's change of frequency that it follows"),
    }


def _gain(diagnosis: FreeDecayDiagnosis, before: HeldOut, after: HeldOut) -> dict[str, Any]:
    error_of = f"acceleration {1e3 * diagnosis.ahead_s:.0f} ms ahead, between knocks"
    return held_out_gain(before, after, "m/s^2", error_of)


def _residual(diagnosis: FreeDecayDiagnosis) -> dict[str, Any]:
    remaining = _descriptions(diagnosis)
    return {
        "description": "; ".join(remaining) or "innovations are not white",
        "failed": failures(diagnosis.outcome.after),
        "unnamed": remaining,
    }


def _screened(diagnosis: FreeDecayDiagnosis, entry: Candidate[Extension]) -> dict[str, Any]:
    """One law against the null alone: its evidence, and its gain in prediction, which may disagree."""
    law = entry.term
    row: dict[str, Any] = {
        "name": law.effect or None,
        "says": law.key,
        "channel": law.channel or None,
        "log_odds": entry.log_odds,
        "gain": None,
    }
    if law.key in diagnosis.alone and diagnosis.errors:
        row["gain"] = _gain(diagnosis, diagnosis.errors[0], diagnosis.alone[law.key])["error"]
    return row


def _pairs(diagnosis: FreeDecayDiagnosis) -> list[dict[str, float]]:
    """Frequencies of both modes, Hz, where the first one is lowest and where it is highest."""
    model, rows = diagnosis.final.state, []
    for k in range(len(model.recordings)):
        omega = model.modes(diagnosis.final.values[None, :], k).omega_radps[0] / (2.0 * np.pi)
        if omega.shape[1] < 2:
            return [{"first_hz": 1.0, "second_hz": math.inf}]
        for at in (int(np.argmin(omega[:, 0])), int(np.argmax(omega[:, 0]))):
            rows.append({"first_hz": float(omega[at, 0]), "second_hz": float(omega[at, 1])})
    return rows


def _modes(diagnosis: FreeDecayDiagnosis, scales: Mapping[str, Scale]) -> dict[str, Any]:
    """Modes at the end of each recording, at rest, and the range over which the first one moved."""
    model = diagnosis.final.state
    at_end = []
    for k, record in enumerate(model.recordings):
        modes = model.modes(diagnosis.final.values[None, :], k)
        row: dict[str, Any] = {"recording": record.name, "frequency_hz": (modes.omega_radps[0, -1] / math.tau).tolist()}
        row["damping"] = modes.zeta[0, -1].tolist()
        for name, scale in scales.items():
            row[name] = float(scale.mean + scale.rms * record.channels[name][-1])
        at_end.append(row)
    swept = np.concatenate(
        [model.modes(diagnosis.final.values[None, :], k).omega_radps[0, :, 0] for k in range(len(model.recordings))]
    )
    return {"first_from_hz": float(swept.min() / math.tau), "first_to_hz": float(swept.max() / math.tau),
            "in_the_last_decay": at_end}  # fmt: skip


def _believed(diagnosis: FreeDecayDiagnosis) -> list[dict[str, Any]]:
    final = diagnosis.final
    each = zip(final.state.parameters[:2], final.values.tolist(), final.spread.tolist(), strict=False)
    return [
        deviation(entry.key.removeprefix("log "), value - entry.centre, sigma, entry.sigma, True)
        for entry, value, sigma in each
    ]
