"""From recordings of any kind to a verdict: fit the belief, screen, extend, test what is left, measure the gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

from companion.diagnosis.selection.check import Check, DiagnosisVerdict
from companion.diagnosis.selection.cross_validation import CrossValidation, cross_validate
from companion.diagnosis.selection.fisher_scoring import State
from companion.diagnosis.selection.fit import Fit
from companion.diagnosis.selection.forward_selection import ForwardSelection
from companion.diagnosis.selection.recordings import Cause, Progress, Recordings, SelectionPath
from companion.diagnosis.selection.score_tests import Screening, TermT


@dataclass(frozen=True, slots=True)
class Diagnosis(Generic[TermT, State]):
    """The outcome, with the fits it rests on.

    ``causes`` is empty unless the verdict is explained. ``nearest_causes`` are the accepted terms of an unexplained
    recording, which are not named as causes. ``stages`` are the fits on the way to ``final``, the null first.
    """

    verdict: DiagnosisVerdict
    causes: tuple[Cause[TermT], ...]
    nearest: str
    nearest_causes: tuple[Cause[TermT], ...]
    reason: str
    null: Fit[TermT, State]
    final: Fit[TermT, State]
    screening: Screening[TermT]
    before: tuple[Check, ...]
    after: tuple[Check, ...]
    gain: CrossValidation | None
    stages: tuple[Fit[TermT, State], ...] = ()


def diagnose(
    recordings: Recordings[TermT, State], max_causes: int = 3, progress: Progress = lambda _what, _ratio: None
) -> Diagnosis[TermT, State]:
    """Judge recordings; name at most ``max_causes`` terms.

    ``progress`` takes the name of the step and the share that is done.
    """
    progress("fit the believed model", 0.0)
    null = recordings.null()
    first = recordings.screen(null, progress)
    reason = recordings.not_identifiable(null)
    if reason:
        return Diagnosis(DiagnosisVerdict.NOT_IDENTIFIABLE, (), "", (), reason, null, null, first, (), (), None)
    path = ForwardSelection(recordings, progress).search(null, first, max_causes)
    progress("test what is left", 0.0)
    after = tuple(recordings.checks(path.fitted))
    before = tuple(recordings.checks(null)) if path.causes else after
    gain, objection = None, ""
    if path.causes and (recordings.measures_nearest or all(entry.passed for entry in after)):
        progress("hold the names against laws without one", 0.0)
        objection = recordings.objection(null, before, path)
        gain = _gain(recordings, path, progress)
        if not objection and any(map(recordings.foretells, path.fitted.terms)) and not gain.improves:
            objection = "no extension predicts held-out blocks better"
    causes = tuple(sorted((*recordings.sample_causes(), *path.causes), key=lambda cause: -cause.log_bayes_factor))
    verdict, reason = _verdict(causes, after, objection)
    explained, unexplained = verdict is DiagnosisVerdict.EXPLAINED, verdict is DiagnosisVerdict.UNEXPLAINED
    return Diagnosis(
        verdict,
        causes if explained else (),
        _nearest(path, first) if unexplained else "",
        causes if unexplained else (),
        reason,
        null,
        path.fitted,
        first,
        before,
        after,
        gain,
        path.stages,
    )


def _nearest(path: SelectionPath[TermT, State], first: Screening[TermT]) -> str:
    """Name of the first cause of a path, else of the strongest candidate."""
    if path.causes:
        return path.causes[0].term.name
    return first.candidates[0].name if first.candidates else ""


def _gain(
    recordings: Recordings[TermT, State], path: SelectionPath[TermT, State], progress: Progress
) -> CrossValidation:
    base, step = _base_of_gain(recordings, path), "measure the gain on held-out blocks"
    return cross_validate(recordings, base, path.fitted, lambda ratio: progress(step, ratio))


def _base_of_gain(recordings: Recordings[TermT, State], path: SelectionPath[TermT, State]) -> Fit[TermT, State]:
    """The fit against which the gain of a path is measured: the null, with impulses if the path has them beside others.

    No block predicts another's impulses. A model without them explains them by a stronger gust, so that those of a
    held-out block cost it less than a model with the true, weaker gust: terms beside the impulses would seem to lose.
    """
    null = path.stages[0]
    transients = tuple(term for term in path.fitted.terms if not recordings.foretells(term))
    if not transients or len(transients) == len(path.fitted.terms):
        return null
    keys = [term.key for term in transients]
    stage = next((stage for stage in path.stages if [term.key for term in stage.terms] == keys), None)
    return stage or recordings.fit(transients, null)


def _verdict(causes: Sequence[Cause[TermT]], after: Sequence[Check], objection: str) -> tuple[DiagnosisVerdict, str]:
    failed = [entry for entry in after if not entry.passed]
    if failed:
        reason = "left over: " + "; ".join(f"{entry.name} ({entry.z:+.1f} sigma)" for entry in failed[:4])
        return DiagnosisVerdict.UNEXPLAINED, reason
    if not causes:
        return DiagnosisVerdict.ADEQUATE, "the believed model explains this recording"
    return (DiagnosisVerdict.UNEXPLAINED, objection) if objection else (DiagnosisVerdict.EXPLAINED, "")
