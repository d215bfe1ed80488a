"""Extends the model by named effects: a beam of paths, each step by the largest gain in evidence, judged at the end."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.selection.fit import FlightFit, fit
from companion.diagnosis.selection.proposals import best_trial, find_proposals
from companion.diagnosis.selection.screen import Candidate, Screening, candidates_of, screen
from companion.diagnosis.selection.verdict import Cause

ENOUGH = 6.0
"""Log Bayes factor above which the first effect may be accepted."""
ENOUGH_MORE = 12.0
"""And a further one: two things wrong at once are rarer than one that is not in the catalogue."""
CERTAIN_Z = 4.4
"""Its strength must also be beyond what forty candidates reach by chance in hundreds of recordings."""
SAME = 0.95
"""Correlation of efficient scores from which two effects are one group."""
_BEAM = 2  # models that go on side by side
_WITHIN = 25.0  # nats behind the best path: a further effect will not make up for more
_REFITTED = 5  # candidates a round, a bound on its cost
_AT_FIRST, _TO_THE_END = 5, 10  # scoring steps: of every refit, and of those that are not far behind
_WORTH_A_REFIT_Z = 3.5  # sigmas of the score; below, no refit is tried
_TOO_CLOSE = 2.0  # nat: odds of 7 to 1
_CONCEIVABLE = 6.0  # nat: odds of 400 to 1
_FIRST_STEPS = (0.5, 0.05, 0.005)  # prior sigmas
UNPREJUDICED = 5.0
"""How much wider the priors of effects are where values are measured, and names not ranked."""
_OUT_OF_REACH = 0.4  # of the leader's strength: no refit will make up for that
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class SelectionPath:
    """A model reached by accepting effects one after the other."""

    fitted: FlightFit
    causes: tuple[Cause, ...] = ()


@dataclass(frozen=True, slots=True)
class _Refit:
    candidate: Candidate
    fitted: FlightFit
    log_bayes_factor: float
    bic: float
    worth: float


class ForwardSelection:
    """The search on some recordings with some catalogue."""

    def __init__(self, models: Sequence[FlightModel], kinds: Sequence[type[Effect]], progress: Progress) -> None:
        self._models, self._kinds, self._progress = models, kinds, progress
        self._channels = sorted({name for model in models for name in model.observations.covariates})

    def screen(self, fitted: FlightFit) -> Screening:
        """Score the whole catalogue at a fitted model."""
        terms = candidates_of(self._kinds, self._channels, find_proposals(self._models, fitted))
        return screen(self._models, fitted, terms, lambda fraction: self._progress("screen the catalogue", fraction))

    def search(self, null: FlightFit, first: Screening, most: int) -> SelectionPath:
        """The path of at most ``most`` effects with the largest evidence, without effects that it can do without."""
        beam, best = [SelectionPath(null)], SelectionPath(null)
        screenings = [first]
        for step in range(most):
            if step:
                screenings = self._screened(beam)
            grown = [
                child
                for path, screening in zip(beam[: len(screenings)], screenings, strict=True)
                for child in self._grow(path, screening)
            ]
            beam = _foremost(grown)
            if not beam:
                break
            if beam[0].fitted.log_evidence > best.fitted.log_evidence:
                best = beam[0]
        return self._unprejudiced(self._pruned(best, null))

    def _screened(self, beam: Sequence[SelectionPath]) -> list[Screening]:
        """Screenings of the paths; none where the foremost leaves nothing: the others could at best draw level."""
        foremost = self.screen(beam[0].fitted)
        if not any(candidate.z > CERTAIN_Z for candidate in _fresh(beam[0], foremost)):
            return []
        return [foremost, *(self.screen(path.fitted) for path in beam[1:])]

    def _unprejudiced(self, path: SelectionPath) -> SelectionPath:
        """The same causes at the values that the data alone would give them: priors rank, they measure nothing."""
        if not path.causes:
            return path
        self._progress("measure what was found", 0.0)
        try:
            fitted = fit(self._models, path.fitted.terms, path.fitted.values, wider=UNPREJUDICED)
        except (ValueError, FloatingPointError, np.linalg.LinAlgError):
            return path
        return SelectionPath(fitted, restated(path.causes, fitted)) if fitted.converged else path

    def _grow(self, path: SelectionPath, screening: Screening) -> list[SelectionPath]:
        enough = ENOUGH_MORE if path.causes else ENOUGH
        tried = self._refit(path, screening)
        good = [entry for entry in tried if entry.log_bayes_factor > enough and entry.candidate.z > CERTAIN_Z]
        return [self._step(path, entry, tried, screening) for entry in good]

    def _refit(self, path: SelectionPath, screening: Screening) -> list[_Refit]:
        fresh = _fresh(path, screening)
        if not fresh or fresh[0].z <= CERTAIN_Z:
            return []
        enough = max(_WORTH_A_REFIT_Z, _OUT_OF_REACH * fresh[0].z)
        leading = [entry for entry in fresh if entry.z > enough][:_REFITTED]
        started: list[tuple[Candidate, FlightFit]] = []
        for i, candidate in enumerate(leading):
            self._progress(f"refit {candidate.name}", i / len(leading))
            trial = best_trial(self._models, path.fitted, candidate.term)
            offered = candidate if trial is None else dataclasses.replace(candidate, term=trial)
            fitted = self._fitted(path, offered, () if trial is None else (trial,))
            if fitted is not None:
                started.append((offered, fitted))
        tried = []
        most = max((fitted.log_evidence for _, fitted in started), default=0.0)
        for candidate, fitted in started:
            if not fitted.converged and most - fitted.log_evidence < _WITHIN:
                fitted = fit(self._models, fitted.terms, fitted.values, _TO_THE_END)
            if candidate.term.effect.one_way and fitted.values[len(path.fitted.values)] <= 0.0:
                continue
            # how many frequencies or instants were looked at is paid for by the prior of the one that was fitted
            factor = fitted.log_evidence - path.fitted.log_evidence
            worth = penalised_log_likelihood(self._models, fitted, path.fitted)
            tried.append(_Refit(candidate, fitted, factor, self._bic(path.fitted, fitted), worth))
        return sorted(tried, key=lambda entry: -entry.log_bayes_factor)

    def _fitted(
        self, path: SelectionPath, candidate: Candidate, trials: tuple[EffectTerm, ...] = ()
    ) -> FlightFit | None:
        """Refit with one effect more; begun smaller where the first step leads beyond what is physical."""
        for term in (*trials, *(perturbed_start(candidate, step) for step in _FIRST_STEPS)):
            try:
                return fit(self._models, (*path.fitted.terms, term), path.fitted.values, _AT_FIRST)
            except (ValueError, FloatingPointError, np.linalg.LinAlgError):
                continue
        return None

    def _bic(self, before: FlightFit, after: FlightFit) -> float:
        extra = len(after.values) - len(before.values)
        return -2.0 * (after.log_likelihood - before.log_likelihood) + extra * log_count(self._models)

    def _step(self, path: SelectionPath, best: _Refit, tried: Sequence[_Refit], screening: Screening) -> SelectionPath:
        size = len(best.fitted.values) - len(path.fitted.values)
        cause = Cause(
            best.fitted.terms[-1],
            _alike(best, tried, screening),
            best.log_bayes_factor,
            best.bic,
            best.candidate.z,
            (0.0,) * size,
            (0.0,) * size,
        )
        return SelectionPath(best.fitted, restated((*path.causes, cause), best.fitted))

    def _pruned(self, path: SelectionPath, null: FlightFit) -> SelectionPath:
        """Leave out what later effects have made superfluous; restate what each is worth beside the others."""
        pruned = path
        for cause in path.causes if len(path.causes) > 1 else ():
            index = [entry.term.effect.name for entry in pruned.causes].index(cause.term.effect.name)
            terms = tuple(term for i, term in enumerate(pruned.fitted.terms) if i != index)
            self._progress(f"do without {cause.term.effect.name}", 0.0)
            without = fit(self._models, terms, pruned.fitted.values[: len(null.values)])
            factor = pruned.fitted.log_evidence - without.log_evidence
            others = tuple(entry for i, entry in enumerate(pruned.causes) if i != index)
            if factor < ENOUGH_MORE and others:
                pruned = SelectionPath(without, restated(others, without))
            else:
                bic = self._bic(without, pruned.fitted)
                causes = list(pruned.causes)
                cause_old = causes[index]
                causes[index] = Cause(
                    cause_old.term, cause_old.group, factor, bic, cause_old.z, cause_old.values, cause_old.sigmas
                )
                pruned = SelectionPath(pruned.fitted, tuple(causes))
        return pruned


def log_count(models: Sequence[FlightModel]) -> float:
    """Logarithm of how many numbers the accelerations are, which BIC charges for each parameter."""
    return math.log(sum(len(model.band_hz) * 2 * len(model.observations.sides) for model in models))


def penalised_log_likelihood(models: Sequence[FlightModel], fitted: FlightFit, null: FlightFit) -> float:
    """Gain of a fit's terms over ``null`` by half a difference of BIC, with the trials paid for, nat.

    How far effects may physically go is left aside: it would weigh the prior of a law that nobody knows against that of
    a name. Nuisances keep theirs.
    """
    count, extra = len(null.values), len(fitted.values) - len(null.values)
    gained = fitted.log_likelihood - null.log_likelihood - (fitted.neg_log_prior(count) - null.neg_log_prior(count))
    return gained - 0.5 * extra * log_count(models) - sum(term.log_trials for term in fitted.terms)


def restated(causes: Sequence[Cause], final: FlightFit) -> tuple[Cause, ...]:
    """Causes with the values of a fit that has them all, in order."""
    sizes = [len(cause.values) for cause in causes]
    at = len(final.values) - sum(sizes)
    spread = np.sqrt(np.diag(final.covariance))
    causes_restated = []
    for cause, term, size in zip(causes, final.terms, sizes, strict=True):
        block = slice(at, at + size)
        at += size
        values, sigmas = tuple(final.values[block].tolist()), tuple(spread[block].tolist())
        causes_restated.append(Cause(term, cause.group, cause.log_bayes_factor, cause.bic, cause.z, values, sigmas))
    return tuple(causes_restated)


def _fresh(path: SelectionPath, screening: Screening) -> list[Candidate]:
    names = {cause.term.effect.name for cause in path.causes}
    return [entry for entry in screening.candidates if entry.name not in names]


def _foremost(paths: Sequence[SelectionPath]) -> list[SelectionPath]:
    """The best paths, each set of names once."""
    best: list[SelectionPath] = []
    names_listed: set[frozenset[tuple[str, str]]] = set()
    for path in sorted(paths, key=lambda entry: -entry.fitted.log_evidence):
        names = frozenset((term.effect.name, term.channel) for term in path.fitted.terms)
        if names not in names_listed and (not best or _behind(path, best[0]) < _WITHIN):
            names_listed.add(names)
            best.append(path)
    return best[:_BEAM]


def _behind(path: SelectionPath, best: SelectionPath) -> float:
    return best.fitted.log_evidence - path.fitted.log_evidence


def perturbed_start(candidate: Candidate, most: float) -> EffectTerm:
    """Start a refit at a small step in the direction of the score, on the side where the effect can be.

    What the data have led to, a frequency or instants, begins as strong as the score says: from less, the fit would
    move these astray before the strength has grown.
    """
    declared = candidate.term.effect.parameters()
    values = {entry.name: float(getattr(candidate.term.effect, entry.name)) for entry in declared}
    information = candidate.information + np.eye(len(declared))
    step = np.linalg.solve(information, candidate.score)
    steps = step / _FIRST_STEPS[0] if candidate.term.log_trials else np.clip(step, -1.0, 1.0)
    for entry, step_sigmas in zip(declared, steps.tolist(), strict=True):
        values[entry.name] += most * entry.sigma * step_sigmas
    return candidate.term.with_values(values)


def _alike(best: _Refit, tried: Sequence[_Refit], screening: Screening) -> tuple[str, ...]:
    """Names that this recording cannot tell from the best: scores that are one, or evidence too close to call.

    So is what the recording itself says for either, where it is the prior of a strength that ranks the two.
    """
    key = best.candidate.name, best.candidate.term.channel
    row = [(candidate.name, candidate.term.channel) for candidate in screening.candidates].index(key)
    refitted = {entry.candidate.name: entry.log_bayes_factor for entry in tried}
    alike = {name for name, factor in refitted.items() if best.log_bayes_factor - factor < _TOO_CLOSE}
    alike |= {
        entry.candidate.name
        for entry in tried
        if best.worth - entry.worth < _TOO_CLOSE and best.log_bayes_factor - entry.log_bayes_factor < _CONCEIVABLE
    }
    for other, rho in zip(screening.candidates, screening.correlation[row], strict=True):
        factor = refitted.get(other.name, other.log_odds)
        if abs(rho) > SAME and best.log_bayes_factor - factor < _CONCEIVABLE:
            alike.add(other.name)
    return tuple(sorted(alike - {best.candidate.name}))
