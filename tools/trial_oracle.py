"""Gain of an oracle in a trial: the effect that was really hidden, begun at its true values and refitted."""

from __future__ import annotations

import numpy as np

from companion.core.wing.effects import catalogue
from companion.diagnosis.flights.recordings import Flights
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, fit
from companion.diagnosis.selection.cross_validation import cross_validate
from tools.trial_truths.cases import Hidden
from tools.trial_truths.strengths import IN_SAMPLES

_FOLLOWS = {"airspeed-dependence": "airspeed_mps", "covariate-frequency": "roller_v"}


def oracle_gain(model: FlightModel, null: FlightFit, label: Hidden) -> float | None:
    """Held-out gain of the hidden effect, nats; None for several, for none, and for what samples themselves show."""
    if len(label.effects) != 1 or next(iter(label.effects)) in IN_SAMPLES:
        return None
    try:
        refitted = fit([model], [true_part(label)], null.values)
        return cross_validate(Flights([model]), null, refitted).log_score["total"][0]
    except (ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None


def true_part(label: Hidden) -> EffectTerm:
    """The hidden effect as the catalogue has it, at what is known of its values."""
    ((name, size),) = label.effects.items()
    kind = catalogue()[name]
    names = [entry.name for entry in kind.parameters()]
    values = {names[label.side if name in ("accel-scale", "accel-bias") else 0]: size}
    if name == "impulsive-forcing":
        values = {f"at{k + 1}_s": label.extra[f"{name}.at{k}_s"] for k in range(3)}
        values |= {f"symmetric{k + 1}_mps": size for k in range(3)}
    values |= {key: label.extra[f"{name}.{key}"] for key in names if f"{name}.{key}" in label.extra}
    return EffectTerm(kind.from_values(values), _FOLLOWS.get(name, ""))
