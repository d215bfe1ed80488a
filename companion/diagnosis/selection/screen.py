"""Screens every named effect at once: efficient scores with the nuisances projected out, no refit.

At the fitted model the efficient score of an effect is what is left of its gradient once every nuisance has had its
say; its variance is the effect's information less what the nuisances share. From the same numbers comes confusion:
the correlation of the efficient scores of two effects on this very recording.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from companion.core.wing.effect import Effect
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import derivatives, joint_scores
from companion.diagnosis.model.scores import Column
from companion.diagnosis.selection.fit import FlightFit
from companion.diagnosis.selection.proposals import NO_PROPOSALS, Proposals, proposed_terms
from companion.diagnosis.selection.simulated_scores import is_sample_nonlinearity, score_scatter
from companion.records import Floats

_BARELY = 1e-9  # of the largest eigenvalue: rounding
_UNIT = 1e-3  # prior sigmas
_SMALLEST = -500_000.0  # exponent at which a normal quantile can still be computed


@dataclass(frozen=True, slots=True)
class Candidate:
    """One named effect as screened.

    Attributes
    ----------
    term : EffectTerm
        The effect at the values from which a refit should start.
    z : float
        Its strength as the equivalent of a standard normal (two-sided).
    log_odds : float
        Approximate log Bayes factor with the prior of the catalogue.
    sigma : (d,)
        Of each parameter, profiled.
    score, information : (d,), (d, d)
        Efficient, in units of the prior sigmas.
    """

    term: EffectTerm
    z: float
    log_odds: float
    sigma: Floats
    score: Floats
    information: Floats
    direction: Floats

    @property
    def name(self) -> str:
        """The effect's stable name."""
        return self.term.effect.name


@dataclass(frozen=True, slots=True)
class Screening:
    """All candidates, strongest first, and how far each can be told from the others."""

    candidates: tuple[Candidate, ...]
    correlation: Floats


@dataclass(frozen=True, slots=True)
class _Tested:
    """An effect, the prior sigmas of its parameters, and to which side it was moved."""

    term: EffectTerm
    sigmas: Floats
    side: float


def candidates_of(
    kinds: Iterable[type[Effect]], channels: Sequence[str], proposals: Proposals = NO_PROPOSALS
) -> list[EffectTerm]:
    """Every effect at nothing, once for each value at which it is to be begun and each channel it may follow.

    Effects that the data themselves must lead to (a tone's frequency) begin where ``proposals`` say, or not at all;
    effects that show in the samples themselves are not screened.
    """
    terms = []
    for kind in kinds:
        if kind.in_samples:
            continue
        if kind.starts_at is not None:
            terms += proposed_terms(kind, proposals)
            continue
        follows = [channel for channel in channels if kind.may_follow(channel)] if kind.follows_channel else [""]
        names, grids = list(kind.scan), [kind.scan[name] for name in kind.scan]
        for values in itertools.product(*grids):
            effect = kind.from_values(dict(zip(names, values, strict=True)))
            terms += [EffectTerm(effect, channel) for channel in follows]
    return terms


def screen(
    models: Sequence[FlightModel],
    null: FlightFit,
    terms: Sequence[EffectTerm],
    progress: Callable[[float], None] = lambda _ratio: None,
) -> Screening:
    """Score every part at a fitted model ``null``, which may hold effects that have been accepted.

    ``terms`` as :func:`candidates_of` gives them; ``progress`` is told the share that is done.
    """
    columns = [list(entry) for entry in null.columns]
    tested: list[_Tested] = []
    sided = [(term, side) for term in terms for side in ((1.0, -1.0) if term.effect.hinged else (1.0,))]
    for done, (term, side) in enumerate(sided):
        declared = term.effect.parameters()
        sigmas = np.array([entry.sigma for entry in declared])
        values = np.concatenate([null.values, [getattr(term.effect, entry.name) for entry in declared]])
        # a mode's frequency means nothing while its participation is 0: what is scanned for has one column
        count = 1 if term.effect.scan else len(declared)
        only = range(len(null.values), len(null.values) + count)
        wide = np.concatenate([null.sigmas, side * sigmas])  # its sign is that of the step
        new_columns = derivatives(models, values, (*null.terms, term), null.expectations, wide, only)
        new_columns = [[*recording, *[Column()] * (len(declared) - count)] for recording in new_columns]
        columns = [[*before, *new] for before, new in zip(columns, new_columns, strict=True)]
        tested.append(_Tested(term, sigmas, side))
        progress((done + 1) / len(sided))
    score, information = efficient(models, null, columns)
    wider = _score_scatter(models, null, tested)
    information = information * np.outer(wider, wider)
    return _ranked(tested, score, information)


def efficient(
    models: Sequence[FlightModel], null: FlightFit, columns: Sequence[Sequence[Column]]
) -> tuple[Floats, Floats]:
    """Score and information of what is beyond the fit's own parameters, with these projected out.

    ``columns`` by recording: those of the fit, then d others; gives (d,) and (d, d).
    """
    gradient, information = joint_scores(models, null.expectations, columns)
    p = len(null.values)
    nuisance = information[:p, :p] + np.diag(1.0 / null.sigmas**2)
    pull = gradient[:p] - (null.values - null.centres) / null.sigmas**2
    projection = np.linalg.solve(nuisance, information[:p, p:])
    return gradient[p:] - projection.T @ pull, information[p:, p:] - information[p:, :p] @ projection


def _score_scatter(models: Sequence[FlightModel], null: FlightFit, tested: Sequence[_Tested]) -> Floats:
    """Ratio by which each parameter's score scatters beyond its column, (d,): 1 but for nonlinear sensors."""
    wider, at = np.ones(sum(len(candidate.sigmas) for candidate in tested)), 0
    bent: dict[int, Effect] = {}
    for candidate in tested:
        names = [entry.name for entry in candidate.term.effect.parameters()]
        if is_sample_nonlinearity(candidate.term.effect) and len(names) == 1:
            bent[at] = candidate.term.with_values({names[0]: _UNIT * float(candidate.sigmas[0])}).effect
        at += len(candidate.sigmas)
    if bent:
        wider[list(bent)] = score_scatter(models, null.expectations, list(bent.values()))
    return wider


def _ranked(tested: Sequence[_Tested], score: Floats, information: Floats) -> Screening:
    unit = np.concatenate([entry.sigmas for entry in tested]) if tested else np.zeros(0)
    score, information = score * unit, information * np.outer(unit, unit)
    scored, at = [], 0
    for move in tested:
        block = slice(at, at + len(move.sigmas))
        scored.append((_candidate(move, score[block], information[block, block]), block))
        at += len(move.sigmas)
    best: dict[tuple[str, str], tuple[Candidate, slice]] = {}
    for entry in scored:
        key = (entry[0].name, entry[0].term.channel)
        if key not in best or entry[0].z > best[key][0].z:
            best[key] = entry
    ranked = sorted(best.values(), key=lambda entry: -entry[0].z)
    directions = np.zeros((len(ranked), len(score)))
    for i, (candidate, block) in enumerate(ranked):
        directions[i, block] = candidate.direction
    shared = directions @ information @ directions.T
    scale = np.sqrt(np.maximum(np.diag(shared), 1e-30))
    return Screening(tuple(entry[0] for entry in ranked), shared / np.outer(scale, scale))


def _candidate(tested: _Tested, score: Floats, information: Floats) -> Candidate:
    """Test the parameters that this recording says anything about; what nature has one way only, that way only."""
    term, sigmas = tested.term, tested.sigmas
    values, vectors = np.linalg.eigh(information)
    telling = values > max(_BARELY * float(values[-1]), _BARELY)
    one_way = term.effect.one_way or term.effect.hinged
    if not telling.any() or (one_way and tested.side * score[0] < 0.0):
        return Candidate(term, 0.0, 0.0, np.full(len(sigmas), np.inf), score, information, np.zeros(len(sigmas)))
    along = vectors[:, telling].T @ score
    # with the prior: a change far beyond what is physical is not what explains
    power = float(np.sum(along**2 / (values[telling] + 1.0)))
    # directions that the prior already knows better count for nothing
    freedom = max(int(np.sum(values > 0.1)), 1)
    tail = min(float(chi2.logsf(power, freedom)) + term.log_trials, 0.0)
    z = normal_score(tail)
    odds = 0.5 * power - term.log_trials - 0.5 * float(np.sum(np.log1p(values[telling])))
    step = vectors[:, telling] @ (along / (values[telling] + 1.0))
    length = float(np.linalg.norm(step))
    spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(information + np.eye(len(sigmas)))), 0.0)) * sigmas
    return Candidate(term, z, odds, spread, score, information, step / length if length else step)


def normal_score(log_tail: float) -> float:
    """|z| whose two-sided tail has this log probability."""
    half = max(log_tail, _SMALLEST) - math.log(2.0)
    if half > -600.0:
        return max(float(norm.isf(math.exp(half))), 0.0)
    return math.sqrt(-2.0 * half)
