"""One blind trial judged: its recording diagnosed, then its label opened and compared."""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from companion.core.wing.effects import catalogue
from companion.diagnosis.data.observations import RawRanges, RawRecording, RawStream
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.flights.proposals import candidates_of, find_proposals
from companion.diagnosis.flights.recordings import diagnose
from companion.diagnosis.flights.screen import screen
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.forward_selection import SAME
from companion.evaluation.flight_models import belief_for
from companion.params.airframe import Airframe
from companion.records import Side
from tools.trial_generators import FIRST, Generator
from tools.trial_oracle import oracle_gain
from tools.trial_plan import Trial
from tools.trial_truths.cases import Hidden, Tables
from tools.trial_truths.strengths import IN_SAMPLES

_SIGMAS_OF_95_PERCENT = 1.96  # derived: of a normal distribution, two-sided


def judge_trial(trial: Trial, tables: Tables, leave_out: bool) -> dict[str, Any]:
    """Diagnose one recording, then open its label."""
    begun = time.process_time()
    airframe = trial.hand.airframe(trial.snr_db, trial.corner_hz)
    kinds = [kind for name, kind in catalogue().items() if not (leave_out and name in trial.label.effects)]
    model = model_of(tables, airframe, trial.hand.top_hz)
    diagnosis = diagnose([model], kinds)
    row = judge(trial.label, diagnosis, time.process_time() - begun, trial.snr_db, units_of(tables, trial.hand))
    if trial.oracle and not leave_out and diagnosis.gain is not None:
        row["oracle_gain"] = oracle_gain(model, diagnosis.null, trial.label)
    if leave_out and diagnosis.causes:
        row["own_group"] = own_group(model, diagnosis, trial.label)
    row |= {"generator": trial.generator}
    return {**row, "kind": trial.kind, "snr_db": trial.snr_db, "corner_hz": trial.corner_hz, "left_out": leave_out}


def own_group(model: FlightModel, diagnosis: FlightDiagnosis, label: Hidden) -> bool:
    """Whether this recording cannot tell what was hidden from a name that was given for it (scores that are one)."""
    names = {*(set(label.effects) & set(catalogue())), *(cause.term.effect.name for cause in diagnosis.causes)}
    kinds = [catalogue()[name] for name in sorted(names)]
    offered = candidates_of(kinds, sorted(model.observations.covariates), find_proposals([model], diagnosis.null))
    screening = screen([model], diagnosis.null, offered)
    is_hidden = [candidate.name in label.effects for candidate in screening.candidates]
    across = np.abs(screening.correlation[np.ix_(is_hidden, np.logical_not(is_hidden))])
    return bool(across.size and np.max(across) > SAME)


def model_of(tables: Tables, airframe: Airframe, top_hz: float = 51.2) -> FlightModel:
    """A trial's tables as the diagnosis sees a recording."""
    tips = {side: RawStream(tables.t_s, tables.force_z_mps2[:, side]) for side in Side}
    ranges = RawRanges(tables.range_t_s, tables.range_m, tables.reference_m)
    channels = {"roller_v": (tables.t_s, tables.roller), "airspeed_mps": (tables.t_s, tables.airspeed)}
    rigid = dict(tables.root)
    root = RawStream(*rigid.pop("z")) if rigid else None
    (observations,) = observe(RawRecording(tips, root, ranges, channels, rigid), airframe, top_hz)
    return FlightModel(belief_for(airframe, [[observations]]), observations, top_hz)


def swings(tables: Tables, hand: Generator = FIRST) -> dict[str, float]:
    """How large the rms of a channel is in this very recording, in the units of the effect that follows it.

    A channel counts by its rms over the recording, and slow waves of unit rms have another one in a minute.
    """
    return {
        "covariate-frequency": float(np.std(tables.roller)),
        "airspeed-dependence": float(np.std(tables.airspeed)) / hand.airspeed_rms_mps,
    }


def units_of(tables: Tables, hand: Generator) -> dict[str, float]:
    """Value, in the parameter that the diagnosis gives, of a unit of each magnitude that a hand hides."""
    return {**hand.units, **swings(tables, hand)}


def judge(
    label: Hidden,
    diagnosis: FlightDiagnosis,
    seconds: float,
    snr_db: float = 20.0,
    units: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Any]:
    """Open the label and compare; ``units`` by effect: what one unit of its magnitude is in the diagnosis' own."""
    named = [cause.term.effect.name for cause in diagnosis.causes]
    groups = [{cause.term.effect.name, *cause.group} for cause in diagnosis.causes]
    hidden = sorted(label.effects)
    if not hidden:
        right = exact = diagnosis.verdict == "adequate"
    else:
        right = len(named) == len(hidden) and all(any(name in group for group in groups) for name in hidden)
        exact = sorted(named) == hidden
    error = _error_in_sigmas(label, diagnosis, units) if exact and len(hidden) == 1 else None
    return {
        "hidden": label.effects,
        "sigmas": {
            name: label.strength(name, snr_db)
            for name in label.effects
            if name in catalogue() and name not in IN_SAMPLES
        },
        "seal": label.seal,
        "verdict": str(diagnosis.verdict),
        "reason": diagnosis.reason,
        "named": named,
        "groups": [sorted(group) for group in groups],
        "nearest": diagnosis.nearest,
        "nearest_causes": [cause.term.effect.name for cause in diagnosis.nearest_causes],
        "z": [cause.z for cause in diagnosis.causes],
        "right": bool(right and diagnosis.verdict in ("explained", "adequate")),
        "exact": bool(exact and diagnosis.verdict in ("explained", "adequate")),
        "error_in_sigmas": error,
        "inside_95": None if error is None else abs(error) < _SIGMAS_OF_95_PERCENT,
        "gain": diagnosis.gain.log_score["total"][0] if diagnosis.gain is not None else None,
        "worst_checks": [[entry.name, entry.z] for entry in diagnosis.after[:3]],
        "cpu_s": seconds,
    }


def _error_in_sigmas(label: Hidden, diagnosis: FlightDiagnosis, units: Mapping[str, float]) -> float | None:
    """Error of the parameter that the hidden magnitude is, over its sigma; positive where it came out too strong."""
    ((name, truth),) = label.effects.items()
    cause = diagnosis.causes[0]
    if name in IN_SAMPLES or name in ("tone", "periodic-forcing", "parametric-stiffness", "impulsive-forcing"):
        return None  # identified by amplitude and phase, or without a fit
    which = label.side if name in ("accel-scale", "accel-bias") else 0
    true = truth * units.get(name, 1.0)
    return float(np.sign(true) * (cause.values[which] - true) / cause.sigmas[which])
