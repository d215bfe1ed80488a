"""A diagnosis as plain data: the documented JSON (config/README.md), which the HTML report also draws from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.cross_validation import CrossValidation
from companion.diagnosis.selection.verdict import Cause, Diagnosis, Verdict
from companion.diagnosis.views import strengths

FORMAT = 1
_SIGMAS_95 = 1.959964
_SHOWN_CHECKS = 12


def as_json(
    found: Diagnosis, models: Sequence[FlightModel], recordings: Sequence[str], with_views: bool = False
) -> dict[str, Any]:
    """Everything that a program would read; numbers in SI, None where there is nothing to say.

    ``with_views`` also simulates what the views of the page are worth, which takes some seconds.
    """
    gain = _gain(found.gain)
    return {
        "format": FORMAT,
        "recordings": list(recordings),
        "airframe": models[0].belief.airframe.name,
        "verdict": str(found.verdict),
        "reason": found.reason,
        "causes": [_cause(entry, gain) for entry in found.causes],
        "nearest": found.nearest or None,
        "nearest_causes": [_cause(entry, gain) for entry in found.nearest_causes],
        "gain": gain,
        "adequacy": {
            "before": [{"test": entry.name, "z": entry.z, "passed": entry.passed} for entry in found.before],
            "after": [{"test": entry.name, "z": entry.z, "passed": entry.passed} for entry in found.after],
        },
        "residual": _residual(found),
        "views": _views(found, models[0]) if with_views else [],
        "screening": [
            {"name": entry.name, "channel": entry.part.channel or None, "z": entry.z, "log_odds": entry.log_odds}
            for entry in found.screening.candidates
        ],
        "airframe_parameters": _nuisances(found, models[0]),
        "notes": [note for model in models for note in model.seen.notes],
    }


def _views(found: Diagnosis, model: FlightModel) -> list[dict[str, Any]]:
    """Statistics of the views of the first recording: those simulated, and those of its ranges from the adequacy."""
    count = len(model.belief.nuisances)
    before = strengths(model, found.null.found[0], found.null.values[:count], found.null.parts)
    after: dict[str, float] = {}
    if found.final is not found.null:
        after = strengths(model, found.final.found[0], found.final.values[:count], found.final.parts)
    told = ("all spectra", "range residual")
    before |= {entry.name: entry.z for entry in found.before if entry.name.startswith(told)}
    after |= {entry.name: entry.z for entry in found.after if entry.name.startswith(told) and found.causes}
    return [{"view": name, "before": z, "after": after.get(name)} for name, z in before.items()]


def sentence(found: Diagnosis) -> str:
    """The verdict in one line."""
    if found.verdict is Verdict.ADEQUATE:
        return "adequate: the believed airframe explains this recording"
    if found.verdict is Verdict.NOT_IDENTIFIABLE:
        return f"not identifiable from this recording: {found.reason}"
    named = ", ".join(_with_group(cause) for cause in found.causes)
    if found.verdict is Verdict.EXPLAINED:
        return f"explained by {named}"
    return f"unexplained (nearest: {found.nearest or 'none'}); {found.reason}"


def _with_group(cause: Cause) -> str:
    name = cause.part.effect.name
    if cause.part.channel:
        name = f"{name} ({cause.part.channel})"
    return f"{name} (or {', '.join(cause.group)})" if cause.group else name


def _cause(cause: Cause, gain: dict[str, Any] | None) -> dict[str, Any]:
    declared = cause.part.effect.parameters()
    return {
        "name": cause.part.effect.name,
        "channel": cause.part.channel or None,
        "group": list(cause.group),
        "log_bayes_factor": cause.log_bayes_factor,
        "bic": cause.bic,
        "z": cause.z,
        "parameters": {
            entry.name: {
                "value": value,
                "sigma": sigma,
                "unit": entry.unit,
                "interval": [value - _SIGMAS_95 * sigma, value + _SIGMAS_95 * sigma],
                "meaning": entry.doc,
            }
            for entry, value, sigma in zip(declared, cause.values, cause.sigmas, strict=True)
        },
        "gain": gain["total"] if gain else None,
        "seen_in_samples": cause.seen or None,
        "advice": cause.part.effect.advice,
    }


def _gain(gain: CrossValidation | None) -> dict[str, Any] | None:
    """Held-out gain of all causes together; ``total`` in nats, ranges in metres."""
    if gain is None:
        return None

    def nats(name: str) -> dict[str, Any]:
        value, low, high = gain.log_score[name]
        return {"before": 0.0, "after": value, "unit": "nat", "interval": [low, high]}

    ranges = {
        f"{distance:g}": {"before": before, "after": after, "unit": "m"}
        for distance, (before, after) in gain.range_rms_m.items()
    }
    return {
        "held_out": True,
        "total": nats("total"),
        "channels": {name: nats(name) for name in gain.log_score if name != "total"},
        "toe_rms_rad": _pair(gain.toe_rms_rad, gain.toe_interval),
        "range_rms_m": ranges,
    }


def _pair(pair: tuple[float, float] | None, interval: tuple[float, float] | None) -> dict[str, Any] | None:
    if pair is None or interval is None:
        return None
    return {"before": pair[0], "after": pair[1], "unit": "rad", "share_of_square_gone": list(interval)}


def _residual(found: Diagnosis) -> dict[str, Any] | None:
    """What is left, described and not named."""
    if found.verdict is not Verdict.UNEXPLAINED:
        return None
    left = [entry for entry in found.after if not entry.passed][:_SHOWN_CHECKS]
    forces = [entry for entry in found.after if entry.name.startswith("force with")][:3]
    return {
        "description": found.reason,
        "failed": [{"test": entry.name, "z": entry.z} for entry in left],
        "latent_force": [{"follows": entry.name.removeprefix("force with "), "z": entry.z} for entry in forces],
    }


def _nuisances(found: Diagnosis, model: FlightModel) -> list[dict[str, Any]]:
    """What the fit made of the airframe's own parameters."""
    rows = []
    for i, entry in enumerate(model.belief.nuisances):
        value, sigma = float(found.final.values[i]), math.sqrt(float(found.final.covariance[i, i]))
        rows.append(
            {
                "name": entry.key,
                "deviation": value,
                "logarithmic": entry.logarithmic,
                "prior_sigma": entry.sigma,
                "sigma": sigma,
                "prior_sigmas_away": value / entry.sigma,
            }
        )
    return rows
