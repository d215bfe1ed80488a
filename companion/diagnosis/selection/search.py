"""From recordings to a verdict: fit the belief, screen, extend, test what is left, measure the gain."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.core.wing.effect import Effect
from companion.core.wing.effects import catalogue
from companion.core.wing.samples import SampleDefect
from companion.diagnosis.data.sample_defects import worst_defects
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.adequacy import LIMIT, check
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.cross_validation import CrossValidation, cross_validate
from companion.diagnosis.selection.fit import FlightFit, fit
from companion.diagnosis.selection.forward_selection import ForwardSelection, Progress, SelectionPath
from companion.diagnosis.selection.initial_values import initial_values
from companion.diagnosis.selection.rival_models import RivalModel, strongest_rival_model
from companion.diagnosis.selection.screen import Screening
from companion.diagnosis.selection.verdict import Cause, Diagnosis, DiagnosisVerdict

_QUIET_DB = 3.0


def diagnose(
    models: Sequence[FlightModel],
    kinds: Sequence[type[Effect]],
    max_causes: int = 3,
    progress: Progress = lambda _what, _ratio: None,
) -> Diagnosis:
    """Judge recordings that share one belief by a catalogue, or a part of it; name at most ``max_causes`` effects.

    ``progress`` is told what is being done and the share that is done.
    """
    progress("fit the believed model", 0.0)
    null = max(
        (fit(models, (), start) for start in initial_values(models)), key=lambda candidate: candidate.log_evidence
    )
    extension = ForwardSelection(models, kinds, progress)
    first = extension.screen(null)
    if not _excited(models, null):
        reason = "the wing hardly moves above its sensors' noise: record in gusts, or excite it"
        return Diagnosis(DiagnosisVerdict.NOT_IDENTIFIABLE, (), "", (), reason, null, null, first, (), (), None)
    path = extension.search(null, first, max_causes)
    progress("test what is left", 0.0)
    offered = {kind.name for kind in kinds}
    shown = worst_defects([entry for model in models for entry in model.observations.sample_defects])
    faults = [Check(entry.evidence, _strength(entry), LIMIT) for entry in shown if entry.name not in offered]
    after = (*faults, *check(models, path.fitted))
    before = (*faults, *check(models, null)) if path.causes else after
    gain = rival = None
    if path.causes:
        progress("hold the names against laws without one", 0.0)
        rival = strongest_rival_model(models, null, before, path)
        gain = cross_validate(
            models, null, path.fitted, lambda fraction: progress("measure the gain on held-out blocks", fraction)
        )
    named = tuple(_sample_cause(entry) for entry in shown if entry.name in offered)
    return _conclude(null, path, named, first, before, after, gain, rival)


def _excited(models: Sequence[FlightModel], null: FlightFit) -> bool:
    """Whether the accelerations stand above the sensors' noise anywhere in the band."""
    for expectation in null.expectations:
        power = np.einsum("iif->if", expectation.spectrum).real
        if np.any(10.0 * np.log10(power.max(1) / power.min(1)) > _QUIET_DB):
            return True
    return not models


def _sample_cause(defect: SampleDefect) -> Cause:
    """A cause that the samples themselves show."""
    kind = catalogue()[defect.name]
    names = [entry.name for entry in kind.parameters()]
    return Cause(
        EffectTerm(kind.from_values(defect.values)),
        (),
        defect.log_bayes_factor,
        -2.0 * defect.log_bayes_factor,
        _strength(defect),
        tuple(defect.values[name] for name in names),
        tuple(defect.sigmas[name] for name in names),
        defect.evidence,
    )


def _strength(defect: SampleDefect) -> float:
    return math.sqrt(2.0 * defect.log_bayes_factor)


def _conclude(
    null: FlightFit,
    path: SelectionPath,
    sample_causes: tuple[Cause, ...],
    first: Screening,
    before: Sequence[Check],
    after: Sequence[Check],
    gain: CrossValidation | None,
    rival: RivalModel | None,
) -> Diagnosis:
    failed = [entry for entry in after if not entry.passed]
    leading = first.candidates[0].name if first.candidates else ""
    causes = tuple(sorted((*sample_causes, *path.causes), key=lambda cause: -cause.log_bayes_factor))
    nearest = path.causes[0].term.effect.name if path.causes else leading
    outcome = (null, path.fitted, first, tuple(before), tuple(after), gain)
    if failed:
        reason = "left over: " + "; ".join(f"{entry.name} ({entry.z:+.1f} sigma)" for entry in failed[:4])
        return Diagnosis(DiagnosisVerdict.UNEXPLAINED, (), nearest, causes, reason, *outcome)
    if not causes:
        return Diagnosis(
            DiagnosisVerdict.ADEQUATE, (), "", (), "the believed airframe explains this recording", *outcome
        )
    if rival is not None and rival.explains_more:
        reason = f"a law without a name explains it better: {rival.title} (by {rival.ahead:.1f} nat)"
        return Diagnosis(DiagnosisVerdict.UNEXPLAINED, (), nearest, causes, reason, *outcome)
    foretold = any(not term.effect.transient for term in path.fitted.terms)
    if gain is not None and foretold and not gain.improves:
        reason = "no extension predicts held-out blocks better"
        return Diagnosis(DiagnosisVerdict.UNEXPLAINED, (), nearest, causes, reason, *outcome)
    return Diagnosis(DiagnosisVerdict.EXPLAINED, causes, "", (), "", *outcome)
