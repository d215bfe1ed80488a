"""Outcome of a diagnosis, with the causes that it names."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.cross_validation import CrossValidation
from companion.diagnosis.selection.fit import FlightFit
from companion.diagnosis.selection.screen import Screening


class DiagnosisVerdict(enum.StrEnum):
    """Outcomes of a diagnosis."""

    ADEQUATE = "adequate"
    EXPLAINED = "explained"
    UNEXPLAINED = "unexplained"
    NOT_IDENTIFIABLE = "not-identifiable"


@dataclass(frozen=True, slots=True)
class Cause:
    """One accepted effect.

    ``group`` are the names that this recording cannot tell from it; ``log_bayes_factor`` and ``bic`` are against the
    model without it (BIC negative: better). ``evidence`` says what the samples show, for causes that needed no
    model.
    """

    term: EffectTerm
    group: tuple[str, ...]
    log_bayes_factor: float
    bic: float
    z: float
    values: tuple[float, ...]
    sigmas: tuple[float, ...]
    evidence: str = ""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The outcome, with the fits it rests on.

    ``causes`` is empty unless the verdict is explained; ``nearest_causes`` is what an unexplained recording comes
    nearest to, which is no name.
    """

    verdict: DiagnosisVerdict
    causes: tuple[Cause, ...]
    nearest: str
    nearest_causes: tuple[Cause, ...]
    reason: str
    null: FlightFit
    final: FlightFit
    screening: Screening
    before: tuple[Check, ...]
    after: tuple[Check, ...]
    gain: CrossValidation | None
