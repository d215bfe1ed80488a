"""A diagnosis of flights as plain data (companion/diagnosis/JSON.md), from which the HTML report draws too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.flights.scale_observability import scale_note
from companion.diagnosis.flights.views import strengths
from companion.diagnosis.json_rows import adequacy, cause_head, deviation, failures, nats, opening, quantity, screening
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.cross_validation import CrossValidation
from companion.diagnosis.selection.recordings import Cause

DISTANCES_M = (20.0, 60.0, 100.0)  # chosen: a landing's end, the paper's far target, and beyond
_SHOWN_CHECKS = 12  # chosen: of the failed checks, the strongest: a table that is read


def as_json(
    diagnosis: FlightDiagnosis, models: Sequence[FlightModel], recordings: Sequence[str], with_views: bool = False
) -> dict[str, Any]:
    """Everything that a program would read; numbers in SI, None where there is nothing to say.

    ``with_views`` also simulates what the views of the page are worth, which takes some seconds.
    """
    gain = _gain(diagnosis.gain, models[0])
    return {
        **opening(recordings, models[0].belief.airframe.name, diagnosis.verdict, diagnosis.reason),
        "causes": [_cause(entry, gain) for entry in diagnosis.causes],
        "nearest": diagnosis.nearest or None,
        "nearest_causes": [_cause(entry, gain) for entry in diagnosis.nearest_causes],
        "gain": gain,
        "adequacy": adequacy(diagnosis.before, diagnosis.after),
        "residual": _residual(diagnosis),
        "views": _views(diagnosis, models[0]) if with_views else [],
        "screening": screening(diagnosis.screening.candidates),
        "airframe_parameters": _nuisances(diagnosis, models[0]),
        "notes": [
            *(note for model in models for note in model.observations.notes),
            *scale_note(models, diagnosis.final.state.expectations),
        ],
    }


def _views(diagnosis: FlightDiagnosis, model: FlightModel) -> list[dict[str, Any]]:
    """Statistics of the views of the first recording: those simulated, and those of its ranges from the adequacy."""
    count = len(model.belief.nuisances)
    before = strengths(model, diagnosis.null.state.expectations[0], diagnosis.null.values[:count], diagnosis.null.terms)
    after: dict[str, float] = {}
    if diagnosis.final is not diagnosis.null:
        after = strengths(
            model, diagnosis.final.state.expectations[0], diagnosis.final.values[:count], diagnosis.final.terms
        )
    range_views = ("all spectra", "range residual")
    before |= {entry.name: entry.z for entry in diagnosis.before if entry.name.startswith(range_views)}
    after |= {
        entry.name: entry.z for entry in diagnosis.after if entry.name.startswith(range_views) and diagnosis.causes
    }
    return [{"view": name, "before": z, "after": after.get(name)} for name, z in before.items()]


def _cause(cause: Cause[EffectTerm], gain: dict[str, Any] | None) -> dict[str, Any]:
    declared = cause.term.effect.parameters()
    return {
        **cause_head(cause, cause.term.channel),
        "parameters": {
            entry.name: quantity(value, sigma, entry.unit, entry.doc)
            for entry, value, sigma in zip(declared, cause.values, cause.sigmas, strict=True)
        },
        "gain": gain["total"] if gain else None,
        "seen_in_samples": cause.evidence or None,
        "advice": cause.term.effect.advice,
    }


def _gain(gain: CrossValidation | None, model: FlightModel) -> dict[str, Any] | None:
    """Held-out gain of all causes together; ``total`` in nats, errors of the toe also in metres of range."""
    if gain is None:
        return None
    scores = gain.log_score
    plain: dict[str, Any] = {
        "held_out": True,
        "total": nats(scores["total"]),
        "channels": {name: nats(score) for name, score in scores.items() if name != "total"},
        "toe_rms_rad": None,
        "range_rms_m": {},
    }
    if not gain.predicts:
        return plain
    before, after = gain.before.rms, gain.after.rms
    interval = gain.after.gone(gain.before)[1:]
    per_rad = {distance: distance**2 / model.baseline_m for distance in DISTANCES_M}
    return {
        **plain,
        "toe_rms_rad": {"before": before, "after": after, "unit": "rad", "share_of_square_gone": list(interval)},
        "range_rms_m": {
            f"{distance:g}": {"before": scale * before, "after": scale * after, "unit": "m"}
            for distance, scale in per_rad.items()
        },
    }


def _residual(diagnosis: FlightDiagnosis) -> dict[str, Any] | None:
    """Description of what is left without a name; None where nothing is."""
    if diagnosis.verdict is not DiagnosisVerdict.UNEXPLAINED:
        return None
    forces = [entry for entry in diagnosis.after if entry.name.startswith("force with")][:3]
    return {
        "description": diagnosis.reason,
        "failed": failures(diagnosis.after)[:_SHOWN_CHECKS],
        "latent_force": [{"follows": entry.name.removeprefix("force with "), "z": entry.z} for entry in forces],
    }


def _nuisances(diagnosis: FlightDiagnosis, model: FlightModel) -> list[dict[str, Any]]:
    """Deviations of the airframe's own parameters in the final fit."""
    spread = [math.sqrt(float(value)) for value in diagnosis.final.covariance.diagonal()]
    each = zip(model.belief.nuisances, diagnosis.final.values.tolist(), spread, strict=False)  # effects come after
    return [deviation(entry.key, value, sigma, entry.sigma, entry.logarithmic) for entry, value, sigma in each]
