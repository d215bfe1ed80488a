"""Extends a model by terms: a beam of paths, each step by the largest gain in evidence, pruned at the end."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from companion.diagnosis.selection.fisher_scoring import State
from companion.diagnosis.selection.fit import Fit
from companion.diagnosis.selection.recordings import Cause, Progress, Recordings, SelectionPath
from companion.diagnosis.selection.score_tests import Candidate, Screening, TermT

ENOUGH = 6.0
"""Log Bayes factor above which the first term may be accepted (choice)."""
ENOUGH_MORE = 12.0
"""And a further one: two things wrong at once are rarer than one that is not in the catalogue (choice)."""
CERTAIN_Z = 4.4
"""Its strength must also be beyond what forty candidates reach by chance in hundreds of recordings (choice)."""
SAME = 0.95
"""Correlation of efficient scores from which two terms are one group (choice)."""
_BEAM = 2  # chosen: models that go on side by side, a bound on the cost: the best two are often near
_WITHIN = 25.0  # nats behind the best path: a further term will not make up for more (choice)
_REFITTED = 5  # candidates a round, a bound on its cost
_WORTH_A_REFIT_Z = 3.5  # sigmas of the score; below, no refit is tried (choice)
_TOO_CLOSE = 2.0  # nat between two names, below which they are one group: odds of 7 to 1 (choice)
_CONCEIVABLE = 6.0  # nat behind the best, up to which a name is possible: odds of 400 to 1 (choice)
UNPREJUDICED = 5.0
"""Factor on the prior sigmas of terms where values are measured and names are not ranked (choice)."""
_MORE_THAN_PROMISED = 2.0  # log odds of a refit over those of the score, at most: a frequency moves far (choice)
_OUT_OF_REACH = 0.4  # of the leader's z: no refit makes up for less (choice)
UNPHYSICAL = (ValueError, FloatingPointError, np.linalg.LinAlgError)
"""Errors of a model at values that are not physical."""

_Names = frozenset[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class _Refit(Generic[TermT, State]):
    candidate: Candidate[TermT]
    fitted: Fit[TermT, State]
    log_bayes_factor: float
    bic: float
    worth: float


class ForwardSelection(Generic[TermT, State]):
    """The search on some recordings."""

    def __init__(self, recordings: Recordings[TermT, State], progress: Progress) -> None:
        self._recordings, self._progress = recordings, progress

    def search(self, null: Fit[TermT, State], first: Screening[TermT], most: int) -> SelectionPath[TermT, State]:
        """The path of at most ``most`` terms with the largest evidence, superfluous terms left out."""
        best: SelectionPath[TermT, State] = SelectionPath(null, (), (null,))
        beam, screenings = [best], [first]
        for step in range(most):
            if step:
                screenings = self._screened(beam)
            grown: list[SelectionPath[TermT, State]] = []
            for path, screening in zip(beam[: len(screenings)], screenings, strict=True):
                grown += self._grow(path, screening, grown)
            beam = _foremost(grown)
            if not beam:
                break
            if beam[0].fitted.log_evidence > best.fitted.log_evidence:
                best = beam[0]
        return self._unprejudiced(self._pruned(best))

    def _screened(self, beam: Sequence[SelectionPath[TermT, State]]) -> list[Screening[TermT]]:
        """Screenings of the paths; none if the best has no certain candidate, as the other could at best equal it."""
        foremost = self._recordings.screen(beam[0].fitted, self._progress)
        if not any(candidate.z > CERTAIN_Z for candidate in _fresh(beam[0], foremost)):
            return []
        return [foremost, *(self._recordings.screen(path.fitted, self._progress) for path in beam[1:])]

    def _unprejudiced(self, path: SelectionPath[TermT, State]) -> SelectionPath[TermT, State]:
        """The same causes with values fitted under wide priors: priors rank causes, they measure nothing.

        A cause beside others that the wide priors leave without evidence is left out: it only spared the other's prior.
        """
        if not path.causes:
            return path
        self._progress("measure what was found", 0.0)
        fitted = self._measured(path.fitted.terms, path.fitted)
        if fitted is None:
            return path
        weakest = min(range(len(fitted.terms)), key=lambda place: _strength_z(fitted, place))
        if len(fitted.terms) > 1 and _strength_z(fitted, weakest) < CERTAIN_Z:
            terms = fitted.terms[:weakest] + fitted.terms[weakest + 1 :]
            without = self._measured(terms, fitted)
            if without is not None and without.log_evidence > fitted.log_evidence:
                causes = path.causes[:weakest] + path.causes[weakest + 1 :]
                return self._unprejudiced(
                    _restated(SelectionPath(without, causes, self._stages(path.stages[0], terms)), without)
                )
        return _restated(path, fitted)

    def _measured(self, terms: Sequence[TermT], near: Fit[TermT, State]) -> Fit[TermT, State] | None:
        """Fit under wide priors; None where it does not converge."""
        try:
            fitted = self._recordings.fit(terms, near, UNPREJUDICED)
        except UNPHYSICAL:
            return None
        return fitted if fitted.converged else None

    def _grow(
        self,
        path: SelectionPath[TermT, State],
        screening: Screening[TermT],
        grown: Sequence[SelectionPath[TermT, State]],
    ) -> list[SelectionPath[TermT, State]]:
        """Paths with one term more; names that the paths in ``grown`` have reached already are not fitted again."""
        enough = ENOUGH_MORE if path.causes else ENOUGH
        reached = {_names(child.fitted): child.fitted for child in grown}
        tried = self._refit(path, screening, reached, enough - _CONCEIVABLE)
        good = [entry for entry in tried if entry.log_bayes_factor > enough and entry.candidate.z > CERTAIN_Z]
        fresh = [entry for entry in good if _names(entry.fitted) not in reached]
        return [_extended(path, entry, _alike(entry, tried, screening)) for entry in fresh]

    def _refit(
        self,
        path: SelectionPath[TermT, State],
        screening: Screening[TermT],
        reached: Mapping[_Names, Fit[TermT, State]],
        hopeless: float,
    ) -> list[_Refit[TermT, State]]:
        tried = []
        started = self._started(path, screening, reached)
        most = max((fitted.log_evidence for _, fitted in started), default=0.0)
        for candidate, fitted in started:
            behind, factor = most - fitted.log_evidence, fitted.log_evidence - path.fitted.log_evidence
            # a fit that can be neither accepted nor alike to an accepted one need not converge; where none can yet, the
            # score's promise counts: parameters that stood for the effect may still be on their way back
            none_yet = most - path.fitted.log_evidence < hopeless
            expected = max(factor, candidate.log_odds) if none_yet else factor
            if not fitted.converged and behind < _WITHIN and expected > hopeless and _names(fitted) not in reached:
                fitted = self._recordings.fit(fitted.terms, fitted, quick=True)
            if not self._recordings.plausible(fitted):
                continue
            # how many frequencies or instants were looked at is paid for by the prior of the one that was fitted
            factor = fitted.log_evidence - path.fitted.log_evidence
            worth = penalised_log_likelihood(self._recordings.log_count, fitted, path.fitted)
            tried.append(_Refit(candidate, fitted, factor, self._bic(path.fitted, fitted), worth))
        return sorted(tried, key=lambda entry: -entry.log_bayes_factor)

    def _started(
        self,
        path: SelectionPath[TermT, State],
        screening: Screening[TermT],
        reached: Mapping[_Names, Fit[TermT, State]],
    ) -> list[tuple[Candidate[TermT], Fit[TermT, State]]]:
        """Leading candidates with their first fits, if they can be accepted or alike to one that is."""
        fresh = _fresh(path, screening)
        if not fresh or fresh[0].z <= CERTAIN_Z:
            return []
        enough = max(_WORTH_A_REFIT_Z, _OUT_OF_REACH * fresh[0].z)
        leading = [entry for entry in fresh if entry.z > enough][:_REFITTED]
        started: list[tuple[Candidate[TermT], Fit[TermT, State]]] = []
        for i, candidate in enumerate(leading):
            most = max((fitted.log_evidence for _, fitted in started), default=-math.inf) - path.fitted.log_evidence
            if candidate.z <= CERTAIN_Z and _MORE_THAN_PROMISED * candidate.log_odds < most - _CONCEIVABLE:
                continue
            self._progress(f"refit {candidate.name}", i / len(leading))
            with_it = _names(path.fitted) | {_name_of(candidate)}
            twin = reached.get(with_it)
            refitted = self._recordings.refit(path.fitted, candidate) if twin is None else (candidate, twin)
            if refitted is not None:
                started.append(refitted)
        return started

    def _bic(self, before: Fit[TermT, State], after: Fit[TermT, State]) -> float:
        extra = len(after.values) - len(before.values)
        return -2.0 * (after.log_likelihood - before.log_likelihood) + extra * self._recordings.log_count

    def _pruned(self, path: SelectionPath[TermT, State]) -> SelectionPath[TermT, State]:
        """Leave out what later terms have made superfluous; restate what each is worth beside the others."""
        pruned = path
        for cause in path.causes if len(path.causes) > 1 else ():
            index = [entry.term.key for entry in pruned.causes].index(cause.term.key)
            terms = tuple(term for i, term in enumerate(pruned.fitted.terms) if i != index)
            self._progress(f"do without {cause.term.name}", 0.0)
            previous = path.stages[-2] if pruned.fitted is path.fitted and index == len(terms) else None
            without = previous if previous and previous.converged else self._fewer(terms, pruned.fitted)
            factor = pruned.fitted.log_evidence - without.log_evidence
            others = tuple(entry for i, entry in enumerate(pruned.causes) if i != index)
            if factor < ENOUGH_MORE and others:
                pruned = _restated(SelectionPath(without, others, self._stages(pruned.stages[0], terms)), without)
            else:
                causes = list(pruned.causes)
                bic = self._bic(without, pruned.fitted)
                causes[index] = dataclasses.replace(causes[index], log_bayes_factor=factor, bic=bic)
                pruned = dataclasses.replace(pruned, causes=tuple(causes))
        return pruned

    def _fewer(self, terms: Sequence[TermT], near: Fit[TermT, State]) -> Fit[TermT, State]:
        """Fit of fewer terms: one that stays far behind need not reach its top."""
        fitted = self._recordings.fit(terms, near, quick=True)
        if fitted.converged or near.log_evidence - fitted.log_evidence > ENOUGH_MORE + _WITHIN:
            return fitted
        return self._recordings.fit(fitted.terms, fitted)

    def _stages(self, null: Fit[TermT, State], terms: Sequence[TermT]) -> tuple[Fit[TermT, State], ...]:
        stages = [null]
        for count in range(1, len(terms) + 1):
            stages.append(self._recordings.fit(terms[:count], stages[-1]))
        return tuple(stages)


def penalised_log_likelihood(log_count: float, fitted: Fit[TermT, State], null: Fit[TermT, State]) -> float:
    """Gain of a fit's terms over ``null`` by half a difference of BIC, with the trials paid for, nat.

    Priors of the terms are left out, because a law without a name has no physical one. Parameters that both models have
    keep theirs.
    """
    extra = len(fitted.values) - len(null.values)
    new = {place for block in fitted.blocks[len(null.blocks) :] for place in block}
    both = [place for place in range(len(fitted.values)) if place not in new]
    gained = fitted.log_likelihood - null.log_likelihood
    gained -= fitted.neg_log_prior(both) - null.neg_log_prior(range(len(null.values)))
    return gained - 0.5 * extra * log_count - sum(term.log_trials for term in fitted.terms)


def _extended(
    path: SelectionPath[TermT, State], best: _Refit[TermT, State], group: tuple[str, ...]
) -> SelectionPath[TermT, State]:
    cause = Cause(best.fitted.terms[-1], group, best.log_bayes_factor, best.bic, best.candidate.z)
    return _restated(SelectionPath(path.fitted, (*path.causes, cause), (*path.stages, best.fitted)), best.fitted)


def _restated(path: SelectionPath[TermT, State], fitted: Fit[TermT, State]) -> SelectionPath[TermT, State]:
    """Causes with the values of a fit that has them all, in order."""
    causes = [
        dataclasses.replace(
            cause,
            term=term,
            values=tuple(fitted.values[list(block)].tolist()),
            sigmas=tuple(fitted.spread[list(block)].tolist()),
        )
        for cause, term, block in zip(path.causes, fitted.terms, fitted.blocks, strict=True)
    ]
    return SelectionPath(fitted, tuple(causes), path.stages)


def _fresh(path: SelectionPath[TermT, State], screening: Screening[TermT]) -> list[Candidate[TermT]]:
    named = {cause.term.key for cause in path.causes}
    return [entry for entry in screening.candidates if entry.term.key not in named]


def _names(fitted: Fit[TermT, State]) -> _Names:
    return frozenset((term.name, term.channel) for term in fitted.terms)


def _strength_z(fitted: Fit[TermT, State], place: int) -> float:
    """Strength of a fitted term over its sigma."""
    first = fitted.blocks[place][0]
    return abs(float(fitted.values[first])) / float(fitted.spread[first])


def _foremost(paths: Sequence[SelectionPath[TermT, State]]) -> list[SelectionPath[TermT, State]]:
    """The best paths, each set of names once."""
    best: list[SelectionPath[TermT, State]] = []
    names_listed: set[_Names] = set()
    for path in sorted(paths, key=lambda entry: -entry.fitted.log_evidence):
        names = _names(path.fitted)
        behind = best[0].fitted.log_evidence - path.fitted.log_evidence if best else 0.0
        if names not in names_listed and behind < _WITHIN:
            names_listed.add(names)
            best.append(path)
    return best[:_BEAM]


def _alike(
    best: _Refit[TermT, State], tried: Sequence[_Refit[TermT, State]], screening: Screening[TermT]
) -> tuple[str, ...]:
    """Names that this recording cannot tell from the best: their scores are one, or their evidence is too close.

    Alike are also names whose penalised likelihoods are close, where only the priors of their strengths rank them.
    """
    key = _name_of(best.candidate)
    row = [_name_of(candidate) for candidate in screening.candidates].index(key)
    refitted = {_name_of(entry.candidate): entry.log_bayes_factor for entry in tried}
    alike = {name for name, factor in refitted.items() if best.log_bayes_factor - factor < _TOO_CLOSE}
    alike |= {
        _name_of(entry.candidate)
        for entry in tried
        if best.worth - entry.worth < _TOO_CLOSE and best.log_bayes_factor - entry.log_bayes_factor < _CONCEIVABLE
    }
    for other, rho in zip(screening.candidates, screening.correlation[row], strict=True):
        factor = refitted.get(_name_of(other), other.log_odds)
        if abs(rho) > SAME and best.log_bayes_factor - factor < _CONCEIVABLE:
            alike.add(_name_of(other))
    return tuple(f"{name} ({channel})" if channel else name for name, channel in sorted(alike - {key}))


def _name_of(candidate: Candidate[TermT]) -> tuple[str, str]:
    """Name and channel: one effect may follow one of several channels that are alike."""
    return candidate.name, candidate.term.channel
