"""The verdict on self-excited vibration as plain data (companion/diagnosis/JSON.md)."""

from __future__ import annotations

import math
from typing import Any

from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.core.wing.effects.stiffness.airspeed_dependence import AirspeedDependence
from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.diagnosis.json_rows import adequacy, cause_head, nats, opening, quantity, residual, screening
from companion.diagnosis.limit_cycles.decays import force_curve
from companion.diagnosis.limit_cycles.labels import LabelDoubt
from companion.diagnosis.limit_cycles.recordings import CYCLE, FlutterDiagnosis
from companion.diagnosis.limit_cycles.rows import LIMIT_CYCLE
from companion.diagnosis.limit_cycles.self_excited import what_to_record
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.recordings import Cause
from companion.diagnosis.selection.regression import RegressionTerm

_FAR = 4.5  # sigmas of a window that is noted by itself (choice)
_SURELY = 3.0  # chosen: sigmas of the onset, below which a limit cycle makes it subcritical
_FAST = 0.1  # of ln amplitude a period: a fifth in a window of two (choice)
_TOO_FAST = ", too fast for the model, whose averages follow slow changes only"
_IN_WORDS = {
    LIMIT_CYCLE: "frequency and damping follow the airspeed: so does the amplitude at which the damping is 0",
    AirspeedDependence.name: "follows the airspeed at equal amplitude",
    QuadraticDamping.name: "damping follows the amplitude",
}
_ADVICE = {
    LIMIT_CYCLE: "come to each airspeed from below and from above: where the two differ there is an unstable cycle",
    AirspeedDependence.name: "blow with a hammer at more airspeeds below the onset",
    QuadraticDamping.name: "let it grow and decay from several amplitudes at one airspeed",
    CubicStiffness.name: "measure the spring's force over deflection, with the wind off",
}


def as_json(diagnosis: FlutterDiagnosis) -> dict[str, Any]:
    """Everything that a program would read; None where there is nothing to say."""
    outcome = diagnosis.outcome
    unexplained = outcome.verdict is DiagnosisVerdict.UNEXPLAINED
    causes = outcome.causes or outcome.nearest_causes
    gain = outcome.gain
    return {
        **opening((entry.name for entry in diagnosis.tracks), None, outcome.verdict, _reason(diagnosis)),
        "causes": [_cause(cause) for cause in causes],
        "nearest": outcome.nearest or None if unexplained else None,
        "gain": {"held_out": True, "total": nats(gain.log_score["total"])} if gain is not None else None,
        "adequacy": adequacy(outcome.before, outcome.after),
        "residual": residual(outcome.verdict, outcome.reason, outcome.after),
        "screening": screening(outcome.screening.candidates),
        "linear_wing": _linear(diagnosis),
        "limit_cycles": [_cycle(diagnosis, i) for i, entry in enumerate(diagnosis.tracks) if entry.steady.any()],
        "held_out_speeds": _held_out(diagnosis),
        "onset": _onset(diagnosis),
        "labels": [_doubt(entry) for entry in diagnosis.doubts],
        "decays": [_decay(diagnosis, i) for i, entry in enumerate(diagnosis.tracks) if not entry.steady.any()],
        "airframe_parameters": [],
        "advice": what_to_record(outcome, diagnosis.rows, diagnosis.tracks),
        "notes": [*(label["says"] for label in map(_doubt, diagnosis.doubts)), *_outlying(diagnosis)],
    }


def _reason(diagnosis: FlutterDiagnosis) -> str:
    outcome = diagnosis.outcome
    named = [_named(cause.term) for cause in outcome.causes or outcome.nearest_causes]
    if outcome.verdict is DiagnosisVerdict.UNEXPLAINED:
        return f"explained so far: {', '.join(named) or 'nothing'}; {outcome.reason}"
    return ", ".join(named) or "one frequency and damping ratio explain these recordings"


def _named(term: RegressionTerm) -> str:
    if term.name == CubicStiffness.name:
        return f"{term.name} (stiffness follows the amplitude of {term.channel})"
    if term.name == AirspeedDependence.name:
        return f"{term.name} ({term.coefficients[0].response} {_IN_WORDS[term.name]})"
    moved = {entry.response for entry in term.coefficients}
    if term.name == LIMIT_CYCLE and CYCLE not in moved:
        return f"{term.name} (damping follows amplitude and airspeed: the amplitude at which it is 0 moves)"
    if moved == {CYCLE}:
        return f"{term.name} (its frequency follows the airspeed at equal amplitude)"
    return f"{term.name} ({_IN_WORDS[term.name]})"


def _cause(cause: Cause[RegressionTerm]) -> dict[str, Any]:
    each = zip(cause.term.coefficients, cause.values, cause.sigmas, strict=True)
    return {
        **cause_head(cause, cause.term.channel),
        "parameters": {entry.key: quantity(value, sigma, entry.unit, entry.meaning) for entry, value, sigma in each},
        "gain": None,
        "advice": _ADVICE[cause.term.name],
    }


def _linear(diagnosis: FlutterDiagnosis) -> dict[str, Any]:
    """Errors of one frequency and one damping ratio, which know no amplitude."""
    f_hz = [row.frequency_hz for row in diagnosis.rows]
    cycles = [row for row in diagnosis.rows if row.cycle]
    sentences = [f"one frequency for all, where {min(f_hz):.2f} to {max(f_hz):.2f} Hz were measured"]
    if cycles:
        growth = max(abs(row.damping) for row in cycles)
        sentences.append(
            f"no amplitude to settle on: {len(cycles)} recordings keep theirs (damping ratio within {growth:.4f})"
        )
    return {"frequency_hz": math.sqrt(max(diagnosis.outcome.null.values[0], 0.0)), "wrong": sentences}


def _cycle(diagnosis: FlutterDiagnosis, number: int) -> dict[str, Any]:
    entry = diagnosis.tracks[number]
    row = next((row for row in diagnosis.rows if row.recording == number and row.cycle), None)
    if row is None:
        return {"recording": entry.name, "airspeed_mps": entry.airspeed_mps, "frequency_hz": None, "amplitude": None}
    levels = dict(zip(diagnosis.names, row.amplitude, strict=True))
    return {
        "recording": entry.name,
        "airspeed_mps": row.airspeed_mps,
        "frequency_hz": row.frequency_hz,
        "amplitude": levels,
    }


def _held_out(diagnosis: FlutterDiagnosis) -> list[dict[str, Any]]:
    return [
        {
            "airspeed_mps": entry.airspeed_mps,
            "frequency_hz": _pair(entry.frequency_hz),
            "amplitude": {name: _pair(pair) for name, pair in entry.amplitude.items()},
        }
        for entry in diagnosis.held_out
    ]


def _outlying(diagnosis: FlutterDiagnosis) -> list[str]:
    """Windows whose frequency lies far from the fit."""
    final = diagnosis.outcome.final
    sentences = []
    for row, z in zip(diagnosis.rows, final.state.residual(final.values, 0).tolist(), strict=True):
        if abs(z) > _FAR:
            name, change = diagnosis.tracks[row.recording].name, -2.0 * math.pi * row.damping
            sentences.append(
                f"{name}, {row.t_s:.1f} s: {row.frequency_hz:.2f} Hz is {z:+.1f} sigma off the fitted law; there ln "
                f"amplitude changes by {change:+.2f} a period" + (_TOO_FAST if abs(change) > _FAST else "")
            )
    return sentences


def _pair(pair: tuple[float, float]) -> dict[str, float]:
    return {"measured": pair[0], "predicted": pair[1], "relative_error": pair[1] / pair[0] - 1.0}


def _onset(diagnosis: FlutterDiagnosis) -> dict[str, Any] | None:
    onset = diagnosis.onset
    if onset is None:
        return None
    low, high = onset.bracket_mps
    if math.isnan(onset.airspeed_mps):
        text = f"the {onset.windows} windows at small amplitude, {low:g} to {high:g} m/s, do not determine it"
        return {"airspeed_mps": None, "windows": onset.windows, "cycles_from_mps": None, "says": text}
    value = quantity(onset.airspeed_mps, onset.sigma_mps, "m/s", "airspeed at which small vibrations stop decaying")
    text = f"{onset.airspeed_mps:.1f} ± {onset.sigma_mps:.1f} m/s, by {onset.windows} windows at small amplitude alone"
    lowest = min((row.airspeed_mps for row in diagnosis.rows if row.cycle), default=math.inf)
    below = lowest < onset.airspeed_mps - _SURELY * onset.sigma_mps
    if below:
        text += f"; limit cycles stand from {lowest:g} m/s on, where small vibrations still decay: it is subcritical"
    return {"airspeed_mps": value, "windows": onset.windows, "cycles_from_mps": lowest if below else None, "says": text}


def _doubt(entry: LabelDoubt) -> dict[str, Any]:
    text = (
        f"{entry.name} says {entry.stated_mps:g} m/s, but its {entry.by} is that of {entry.implied_mps:.1f} m/s "
        f"(by the others, to {entry.sigma_mps:.2f} m/s): left out"
    )
    return {"recording": entry.name, "says_mps": entry.stated_mps, "tells_mps": entry.implied_mps, "says": text}


def _decay(diagnosis: FlutterDiagnosis, number: int) -> dict[str, Any]:
    """Frequency and damping of a recording without a limit cycle against its amplitude, and the spring's curve."""
    entry = diagnosis.tracks[number]
    plain: dict[str, Any] = {
        "recording": entry.name,
        "airspeed_mps": entry.airspeed_mps,
        "frequency_hz": entry.frequency_hz.tolist(),
        "damping": (-entry.growth_radps / (2.0 * math.pi * entry.frequency_hz)).tolist(),
        "amplitude": {name: values.tolist() for name, values in entry.amplitude.items()},
        "stiffness": {},
    }
    for name in entry.amplitude:
        curve = force_curve(entry, name) if not entry.airspeed_mps else None  # in the wind it is no spring alone
        if curve is not None:
            plain["stiffness"][name] = {
                "frequency_at_rest_hz": curve.omega_radps / (2.0 * math.pi),
                "cubic": quantity(curve.cubic, curve.sigmas[1], f"1/s^2 per {name}^2", "of the force per mass"),
                "quintic": quantity(curve.quintic, curve.sigmas[2], f"1/s^2 per {name}^4", "of the force per mass"),
                "deflection": curve.deflection.tolist(),
                "force": curve.force.tolist(),
            }
    return plain
