"""Outcome of a diagnosis of flights, and the same in one line."""

from __future__ import annotations

from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flights import FlightState
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.diagnosis import Diagnosis
from companion.diagnosis.selection.recordings import Cause

FlightDiagnosis = Diagnosis[EffectTerm, FlightState]


def sentence(diagnosis: FlightDiagnosis) -> str:
    """The verdict in one line."""
    if diagnosis.verdict is DiagnosisVerdict.ADEQUATE:
        return "adequate: the believed airframe explains this recording"
    if diagnosis.verdict is DiagnosisVerdict.NOT_IDENTIFIABLE:
        return f"not identifiable from this recording: {diagnosis.reason}"
    named = ", ".join(_with_group(cause) for cause in diagnosis.causes)
    if diagnosis.verdict is DiagnosisVerdict.EXPLAINED:
        return f"explained by {named}"
    return f"unexplained (nearest: {diagnosis.nearest or 'none'}); {diagnosis.reason}"


def _with_group(cause: Cause[EffectTerm]) -> str:
    name = cause.term.effect.name
    if cause.term.channel:
        name = f"{name} ({cause.term.channel})"
    return f"{name} (or {', '.join(cause.group)})" if cause.group else name
