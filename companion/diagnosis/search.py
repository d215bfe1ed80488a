"""From one recording to a verdict: fit, screen, refit the leading effects, extend greedily, and know when to stop."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect
from companion.diagnosis.adequacy import Check, check
from companion.diagnosis.fit import Fit, fit
from companion.diagnosis.gain import HeldOut, held_out
from companion.diagnosis.part import Part
from companion.diagnosis.screen import Candidate, Screening, candidates_of, screen
from companion.diagnosis.supermodel import SuperModel

ENOUGH = 6.0
"""Log Bayes factor above which an effect may be accepted."""
CERTAIN_Z = 4.4
"""Its strength must also be beyond what forty candidates reach by chance in hundreds of recordings."""
SAME = 0.95
"""Correlation of efficient scores from which two effects are one group."""
_REFITTED = 5
_WORTH_A_REFIT_Z = 3.5
_TOO_CLOSE = 2.0
_OUT_OF_REACH = 0.4  # of the leader's strength: no refit will make up for that
_QUIET_DB = 3.0
Progress = Callable[[str, float], None]


class Verdict(enum.StrEnum):
    """How a diagnosis ends."""

    ADEQUATE = "adequate"
    EXPLAINED = "explained"
    UNEXPLAINED = "unexplained"
    NOT_IDENTIFIABLE = "not-identifiable"


@dataclass(frozen=True, slots=True)
class Cause:
    """One accepted effect.

    ``group`` are the names that this recording cannot tell from it; ``log_bayes_factor`` and ``bic`` are against the
    model without it (BIC negative: better).
    """

    part: Part
    group: tuple[str, ...]
    log_bayes_factor: float
    bic: float
    z: float
    values: tuple[float, ...]
    sigmas: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The outcome, with the fits it rests on."""

    verdict: Verdict
    causes: tuple[Cause, ...]
    nearest: str
    reason: str
    null: Fit
    final: Fit
    screening: Screening
    before: tuple[Check, ...]
    after: tuple[Check, ...]
    gain: HeldOut | None


@dataclass(frozen=True, slots=True)
class _Tried:
    candidate: Candidate
    fitted: Fit
    log_bayes_factor: float
    bic: float


def diagnose(
    models: Sequence[SuperModel],
    kinds: Sequence[type[Effect]],
    max_causes: int = 3,
    progress: Progress = lambda _what, _share: None,
) -> Diagnosis:
    """Judge recordings that share one belief by a catalogue, or a part of it; name at most ``max_causes`` effects.

    ``progress`` is told what is being done and the share that is done.
    """
    progress("fit the believed model", 0.0)
    null = fit(models, ())
    parts = candidates_of(kinds, sorted({name for model in models for name in model.seen.covariates}))
    first = screen(models, null, parts, lambda share: progress("screen the catalogue", share))
    if not _excited(models, null):
        reason = "the wing hardly moves above its sensors' noise: record in gusts, or excite it"
        return Diagnosis(Verdict.NOT_IDENTIFIABLE, (), "", reason, null, null, first, (), (), None)
    final, causes = _extend(models, null, first, parts, max_causes, progress)
    progress("test what is left", 0.0)
    after = tuple(check(models, final))
    before = tuple(check(models, null)) if causes else after
    gain = None
    if causes:
        gain = held_out(models, null, final, lambda share: progress("measure the gain on held-out blocks", share))
    return _conclude(null, final, causes, first, before, after, gain)


def _extend(
    models: Sequence[SuperModel],
    null: Fit,
    first: Screening,
    parts: Sequence[Part],
    max_causes: int,
    progress: Progress,
) -> tuple[Fit, list[Cause]]:
    current, screening, causes = null, first, list[Cause]()
    while len(causes) < max_causes:
        if max((entry.z for entry in screening.candidates), default=0.0) <= CERTAIN_Z:
            break
        tried = _refit(models, current, screening, [cause.part for cause in causes], progress)
        good = [entry for entry in tried if entry.log_bayes_factor > ENOUGH and entry.candidate.z > CERTAIN_Z]
        if not good:
            break
        best = good[0]
        causes.append(_cause(best, tried, screening, len(current.values)))
        current = best.fitted
        screening = screen(models, current, parts, lambda share: progress("screen what is left", share))
    return current, [_restated(cause, current, i, causes) for i, cause in enumerate(causes)]


def _refit(
    models: Sequence[SuperModel], current: Fit, screening: Screening, taken: Sequence[Part], progress: Progress
) -> list[_Tried]:
    names = {part.effect.name for part in taken}
    fresh = [c for c in screening.candidates if c.name not in names]
    enough = max(_WORTH_A_REFIT_Z, _OUT_OF_REACH * fresh[0].z) if fresh else 0.0
    leading = [c for c in fresh if c.z > enough][:_REFITTED]
    tried = []
    for i, candidate in enumerate(leading):
        progress(f"refit {candidate.name}", i / len(leading))
        begun = (*current.parts, _begun(candidate))
        fitted = fit(models, begun, current.values)
        factor = fitted.log_evidence - current.log_evidence
        count = sum(len(model.band_hz) * 2 * len(model.seen.sides) for model in models)
        extra = len(fitted.values) - len(current.values)
        bic = -2.0 * (fitted.log_likelihood - current.log_likelihood) + extra * math.log(count)
        tried.append(_Tried(candidate, fitted, factor, bic))
    return sorted(tried, key=lambda entry: -entry.log_bayes_factor)


def _begun(candidate: Candidate) -> Part:
    """Start a refit at a small step in the direction of the score, on the side where the effect can be."""
    declared = candidate.part.effect.parameters()
    values = {entry.name: float(getattr(candidate.part.effect, entry.name)) for entry in declared}
    information = candidate.information + np.eye(len(declared))
    step = np.linalg.solve(information, candidate.score)
    for entry, share in zip(declared, step.tolist(), strict=True):
        values[entry.name] += 0.5 * entry.sigma * max(min(share, 1.0), -1.0)
    return Part(type(candidate.part.effect).from_values(values), candidate.part.channel)


def _cause(best: _Tried, tried: Sequence[_Tried], screening: Screening, before: int) -> Cause:
    mine = [(c.name, c.part.channel) for c in screening.candidates].index(
        (best.candidate.name, best.candidate.part.channel)
    )
    alike = {
        other.name
        for other, rho in zip(screening.candidates, screening.correlation[mine], strict=True)
        if abs(rho) > SAME and other.name != best.candidate.name
    }
    alike |= {
        entry.candidate.name
        for entry in tried
        if best.log_bayes_factor - entry.log_bayes_factor < _TOO_CLOSE and entry.candidate.name != best.candidate.name
    }
    values = best.fitted.values[before:]
    sigmas = np.sqrt(np.diag(best.fitted.covariance))[before:]
    return Cause(
        best.fitted.parts[-1],
        tuple(sorted(alike)),
        best.log_bayes_factor,
        best.bic,
        best.candidate.z,
        tuple(values.tolist()),
        tuple(sigmas.tolist()),
    )


def _restated(cause: Cause, final: Fit, index: int, causes: Sequence[Cause]) -> Cause:
    """The cause with the values of the final fit."""
    sizes = [len(other.values) for other in causes]
    at = len(final.values) - sum(sizes) + sum(sizes[:index])
    mine = slice(at, at + sizes[index])
    values, sigmas = final.values[mine], np.sqrt(np.diag(final.covariance))[mine]
    return Cause(
        final.parts[index],
        cause.group,
        cause.log_bayes_factor,
        cause.bic,
        cause.z,
        tuple(values.tolist()),
        tuple(sigmas.tolist()),
    )


def _excited(models: Sequence[SuperModel], null: Fit) -> bool:
    """Whether the accelerations stand above the sensors' noise anywhere in the band."""
    for found in null.found:
        power = np.einsum("iif->if", found.spectrum).real
        if np.any(10.0 * np.log10(power.max(1) / power.min(1)) > _QUIET_DB):
            return True
    return not models


def _conclude(
    null: Fit,
    final: Fit,
    causes: Sequence[Cause],
    first: Screening,
    before: Sequence[Check],
    after: Sequence[Check],
    gain: HeldOut | None,
) -> Diagnosis:
    failed = [entry for entry in after if not entry.passed]
    leading = first.candidates[0] if first.candidates else None
    nearest = causes[0].part.effect.name if causes else (leading.name if leading else "")
    outcome = (null, final, first, tuple(before), tuple(after), gain)
    if failed:
        reason = "; ".join(f"{entry.name} ({entry.z:+.1f} sigma)" for entry in failed[:4])
        return Diagnosis(Verdict.UNEXPLAINED, tuple(causes), nearest, f"left over: {reason}", *outcome)
    if not causes:
        return Diagnosis(Verdict.ADEQUATE, (), "", "the believed airframe explains this recording", *outcome)
    if gain is not None and not gain.improves:
        return Diagnosis(Verdict.UNEXPLAINED, (), nearest, "no extension predicts held-out blocks better", *outcome)
    return Diagnosis(Verdict.EXPLAINED, tuple(causes), "", "", *outcome)
