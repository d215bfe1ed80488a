"""Score tests of terms at nothing: efficient scores with everything that was fitted projected out, no refit.

The efficient score of a term is its gradient less what the fitted parameters explain of it. Its variance is the term's
information less what it shares with theirs. The correlation of two terms' efficient scores says whether this very
recording can tell them apart.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.stats import chi2

from companion.diagnosis.selection.fisher_scoring import State
from companion.diagnosis.selection.fit import Fit
from companion.diagnosis.selection.normal_scores import normal_score
from companion.records import Floats

_BARELY = 1e-9  # of the largest eigenvalue: rounding (numerical)


class Term(Protocol):
    """Addition to a model: an effect of the catalogue, or a law that only describes."""

    @property
    def name(self) -> str:
        """Stable name of the effect, or what the law says."""

    @property
    def channel(self) -> str:
        """Recorded channel that it follows, "" for none."""

    @property
    def key(self) -> str:
        """Equal for terms of which a model holds one at most."""

    @property
    def log_trials(self) -> float:
        """Logarithm of how many places were tried before it was begun where it was (look-elsewhere)."""


TermT = TypeVar("TermT", bound=Term)


@dataclass(frozen=True, slots=True)
class Candidate(Generic[TermT]):
    """One term as screened.

    Attributes
    ----------
    term
        At the values from which a refit should start.
    z : float
        Its strength as the equivalent of a standard normal (two-sided).
    log_odds : float
        Approximate log Bayes factor.
    sigma : (d,)
        Predicted standard deviation of each parameter, all others fitted.
    score, information : (d,), (d, d)
        Efficient, in units of the prior sigmas.
    direction : (d,)
        Unit vector of the step to the predicted maximum, in prior sigmas.
    is_far : bool
        Whether a wide prior promises more evidence than the declared one: the effect is of another size than expected.
    """

    term: TermT
    z: float
    log_odds: float
    sigma: Floats = field(default_factory=lambda: np.zeros(0))
    score: Floats = field(default_factory=lambda: np.zeros(0))
    information: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    direction: Floats = field(default_factory=lambda: np.zeros(0))
    is_far: bool = False

    @property
    def name(self) -> str:
        """The term's stable name."""
        return self.term.name


@dataclass(frozen=True, slots=True)
class Screening(Generic[TermT]):
    """All candidates, strongest first, and how distinguishable each is from the others.

    Attributes
    ----------
    candidates
    correlation : (n, n)
        Of their scores, each along its own direction.
    imitation : (n, n)
        Correlation of the score of a column's candidate with that combination of the parameters of a row's candidate
        which comes nearest to it.
    """

    candidates: tuple[Candidate[TermT], ...]
    correlation: Floats
    imitation: Floats


@dataclass(frozen=True, slots=True)
class Tested(Generic[TermT]):
    """A term, the prior sigmas of its parameters, to which side it was moved, and whether nature has one side only.

    It is tested under a second prior, ``wider`` times as wide, too (1: there is none).
    """

    term: TermT
    sigmas: Floats
    side: float = 1.0
    one_way: bool = False
    wider: float = 1.0


def efficient(gradient: Floats, information: Floats, fitted: Fit[TermT, State]) -> tuple[Floats, Floats]:
    """Score (d,) and information (d, d) of what is beyond a fit's own p parameters, with these projected out.

    ``gradient`` (p + d,) and ``information`` have the fit's parameters first.
    """
    p = len(fitted.values)
    nuisance = information[:p, :p] + np.diag(1.0 / fitted.sigmas**2)
    posterior_gradient = gradient[:p] - (fitted.values - fitted.centres) / fitted.sigmas**2
    projection = np.linalg.solve(nuisance, information[:p, p:])
    return gradient[p:] - projection.T @ posterior_gradient, information[p:, p:] - information[p:, :p] @ projection


def ranked(tested: Sequence[Tested[TermT]], score: Floats, information: Floats) -> Screening[TermT]:
    """Candidates by strength; a term that was tried at several places or sides counts with the strongest of them.

    ``score`` (d,) and ``information`` (d, d) have the tested terms' parameters one after the other.

    A tail that one place has by chance is N times as likely at the best of N places, which is paid for.
    """
    unit = np.concatenate([entry.sigmas for entry in tested]) if tested else np.zeros(0)
    score, information = score * unit, information * np.outer(unit, unit)
    scored, at = [], 0
    places = Counter((move.term.name, move.term.channel) for move in tested if move.side > 0.0)
    for move in tested:
        block = slice(at, at + len(move.sigmas))
        log_trials = move.term.log_trials + math.log(places[move.term.name, move.term.channel])
        scored.append((_candidate(move, score[block], information[block, block], log_trials), block))
        at += len(move.sigmas)
    best: dict[tuple[str, str], tuple[Candidate[TermT], slice]] = {}
    for entry in scored:
        key = (entry[0].name, entry[0].term.channel)
        if key not in best or entry[0].z > best[key][0].z:
            best[key] = entry
    by_strength = sorted(best.values(), key=lambda entry: -entry[0].z)
    directions = np.zeros((len(by_strength), len(score)))
    for i, (candidate, block) in enumerate(by_strength):
        directions[i, block] = candidate.direction
    shared = directions @ information @ directions.T
    scale = np.sqrt(np.maximum(np.diag(shared), 1e-30))
    imitation = (
        np.stack([_imitated(directions, information, block) for _, block in by_strength]) if by_strength else shared
    )
    candidates = tuple(candidate for candidate, _ in by_strength)
    return Screening(candidates, shared / np.outer(scale, scale), imitation / scale)


def _imitated(directions: Floats, information: Floats, block: slice) -> Floats:
    """Standard deviation of each direction's score that the parameters of a block share, (n,)."""
    common = directions @ information[:, block]
    inverse = np.linalg.pinv(information[block, block], rcond=_BARELY, hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", common, inverse, common), 0.0)))


def _candidate(tested: Tested[TermT], score: Floats, information: Floats, log_trials: float) -> Candidate[TermT]:
    """Test the parameters that this recording informs about; an effect of one sign only is tested for that sign."""
    term, sigmas = tested.term, tested.sigmas
    values, vectors = np.linalg.eigh(information)
    telling = values > max(_BARELY * float(values[-1]), _BARELY)
    if not telling.any() or (tested.one_way and tested.side * score[0] < 0.0):
        return Candidate(term, 0.0, 0.0, np.full(len(sigmas), np.inf), score, information, np.zeros(len(sigmas)))
    along = vectors[:, telling].T @ score
    z, odds = _strength(along, values[telling], log_trials)
    far = False
    if tested.wider > 1.0:  # a wide prior is one of two that a strength may have
        by = tested.wider
        wide_z, wide_odds = _strength(by * along, by**2 * values[telling], log_trials + math.log(2.0))
        far, z, odds = wide_odds > odds, max(z, wide_z), max(odds, wide_odds)
    odds += math.log(2.0) if tested.one_way else 0.0  # half a normal prior is twice as dense
    step = vectors[:, telling] @ (along / (values[telling] + 1.0))
    length = float(np.linalg.norm(step))
    spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(information + np.eye(len(sigmas)))), 0.0)) * sigmas
    return Candidate(term, z, odds, spread, score, information, step / length if length else step, far)


def _strength(along: Floats, informations: Floats, log_trials: float) -> tuple[float, float]:
    """Standard normal equivalent and log odds of independent scores (d,), of informations (d,) in prior sigmas."""
    # with the prior, so that a strength far beyond what is physical counts less
    power = float(np.sum(along**2 / (informations + 1.0)))
    # a direction with less than a tenth of the prior's information is no degree of freedom
    freedom = max(int(np.sum(informations > 0.1)), 1)
    z = normal_score(min(float(chi2.logsf(power, freedom)) + log_trials, 0.0))
    return z, 0.5 * power - log_trials - 0.5 * float(np.sum(np.log1p(informations)))
