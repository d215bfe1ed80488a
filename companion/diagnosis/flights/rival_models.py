"""Names against laws without a name: a name is given only if no anonymous law explains the recording better.

The residual of a fitted name shows little of a cause that is near to it: two shapes that correlate to nine tenths leave
less than half of either. Fitted in place of each other, they differ by the whole of what distinguishes them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect
from companion.diagnosis.flights.proposals import find_proposals, proposed_terms
from companion.diagnosis.flights.screen import perturbed_start, screen
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, FlightsLikelihood, fit, log_count
from companion.diagnosis.model.generic_effects import (
    GenericClockStep,
    generic_clock_settings,
    generic_effects,
    generic_lines,
)
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.forward_selection import (
    ENOUGH,
    ENOUGH_MORE,
    SAME,
    UNPHYSICAL,
    UNPREJUDICED,
    penalised_log_likelihood,
)
from companion.diagnosis.selection.score_tests import Candidate, Screening

BETTER = 2.0
"""Nats by which a law without a name must surpass the names: one that lies d sigmas from the truth does so by chance
with Phi(-d/2 - 2/d), 2 % at most (choice)."""
_REFITTED = 3  # candidates, a bound on the cost (choice)
_TWINS = 3  # candidates whose score is a name's, which only a refit tells apart, a bound on the cost (choice)
_CLOCKS = 1  # refitted clocks that were set, a bound on the cost (choice)
_OUT_OF_REACH = 0.5  # of the names' gain: a law whose log odds are less is not refitted (choice)
_RANKING_STEPS = 8  # chosen: scoring steps of a fit that ranks: enough to order, cheap enough for many
_FIRST_STEP = 0.5  # chosen: prior sigmas: far enough from none for a gradient


@dataclass(frozen=True, slots=True)
class RivalModel:
    """A law without a name, and by how many nats it surpasses what was named."""

    title: str
    ahead: float

    @property
    def explains_more(self) -> bool:
        """Whether no name may be said."""
        return self.ahead > BETTER


@dataclass(frozen=True, slots=True)
class _Competitor:
    """A law in place of the names: twice the cost of a parameter (``price``), and its lead before any fit, nat."""

    law: Candidate[EffectTerm]
    price: float
    lead: float


def strongest_rival_model(
    models: Sequence[FlightModel], null: FlightFit, before: Sequence[Check], named_fit: FlightFit
) -> RivalModel | None:
    """The law that explains most in place of all the names of a fit; None where none comes near.

    ``before`` are the checks of ``null``, which lead to the laws that are worth a refit. A law whose score the
    parameters of a name can imitate may be that name to first order. Its parameters then cost nothing, nor do those of
    that name; further names are paid for. For each name beyond the first the rival is ahead by the further evidence
    that the search asks of it. A clock that was set once is such a rival of names that shift stamps: one parameter and
    an instant stand against a rate and an instant. A name's own law in another shape is no rival.
    """
    named = [_at_nothing(term) for term in named_fit.terms]
    screening = screen(models, null, [*_offered(models, null, before), *_clocks(models, named), *named], shapes=True)
    names = {term.effect.name for term in named}
    own_laws = {term.effect.own_law for term in named}
    named_rows = [i for i, candidate in enumerate(screening.candidates) if candidate.name in names]
    alike = screening.imitation[named_rows].max(axis=0) if named_rows else np.zeros(len(screening.candidates))
    worth, count = penalised_log_likelihood, log_count(models)
    enough = _OUT_OF_REACH * worth(count, named_fit, null)
    ahead = _out_of_place(named_fit) + (ENOUGH_MORE - ENOUGH) * (len(named) - 1)  # as rare as the search has it
    leading = sorted(
        (
            (candidate, float(rho))
            for candidate, rho in zip(screening.candidates, alike, strict=True)
            if candidate.log_odds > enough and candidate.name not in names | own_laws
        ),
        key=lambda entry: -entry[0].log_odds,
    )
    competing_models = [
        RivalModel(
            entry.law.name,
            worth(entry.price, _held_alike(models, fitted, named_fit), null)
            - worth(entry.price, named_fit, null)
            + entry.lead,
        )
        for entry in _competitors(leading, count, ahead, _cost_of_others(screening, named_rows, count))
        if (fitted := _refitted(models, null, entry.law)) is not None
    ]
    return max(competing_models, key=lambda candidate: candidate.ahead, default=None)


def _held_alike(models: Sequence[FlightModel], rival: FlightFit, named_fit: FlightFit) -> FlightFit:
    """The rival with the likelihood by which it differs from the names where one toe covariance holds for both.

    A fit takes the toe's posterior covariance as constant, and that depends on a sensor's noise, of which the
    accelerations may leave decades open: where each fit happens to end, ranges gain or lose nats that no law explains.
    The mean of the difference by the covariance of either has none of that.
    """
    by_names = _log_likelihood(models, rival, named_fit) - named_fit.log_likelihood
    by_rival = rival.log_likelihood - _log_likelihood(models, named_fit, rival)
    return dataclasses.replace(rival, log_likelihood=named_fit.log_likelihood + 0.5 * (by_names + by_rival))


def _log_likelihood(models: Sequence[FlightModel], fitted: FlightFit, beside: FlightFit) -> float:
    """Log likelihood of a fit with the toe's posterior covariance of another."""
    return FlightsLikelihood(models, fitted.terms).log_likelihood(fitted.values, beside.state)


def _competitors(
    leading: Sequence[tuple[Candidate[EffectTerm], float]], count: float, ahead: float, others: dict[str, float]
) -> list[_Competitor]:
    """Laws that are worth a refit, of all that lead, strongest first, each with how far a name can imitate it."""
    clocks = [law for law, _ in leading if _is_clock(law)][:_CLOCKS]
    rest = [(law, rho) for law, rho in leading if not _is_clock(law)]
    twins = [law for law, rho in rest if rho >= SAME][:_TWINS]
    return [
        *[_Competitor(law, count, ahead) for law, rho in rest if rho < SAME][:_REFITTED],
        # alike to the name, they are alike to each other, and count as one look
        *(_Competitor(law, 0.0, ahead + others[law.name]) for law in twins),
        *(_Competitor(law, 0.0, ahead) for law in clocks),
    ]


def _cost_of_others(screening: Screening[EffectTerm], named: Sequence[int], count: float) -> dict[str, float]:
    """Price that BIC asks for all names but the one that imitates a law best, nat, by law.

    ``named`` are the names' rows, ``count`` is the logarithm of how many numbers were recorded.
    """
    if not named:
        return {}
    sizes = np.array([len(screening.candidates[row].term.values) for row in named])
    nearest = sizes[np.argmax(screening.imitation[named], axis=0)]
    return {
        candidate.name: 0.5 * count * float(sizes.sum() - size)
        for candidate, size in zip(screening.candidates, nearest, strict=True)
    }


def _out_of_place(fitted: FlightFit) -> float:
    """Minus the log prior of ``scan`` parameters: a clock that was right long before a recording is only late in it."""
    return fitted.neg_log_prior(
        [
            place
            for term, block in zip(fitted.terms, fitted.blocks, strict=True)
            for place, entry in zip(block, term.effect.parameters(), strict=True)
            if entry.name in type(term.effect).scan
        ]
    )


def _at_nothing(term: EffectTerm) -> EffectTerm:
    """A name at strength 0; parameters that are scanned or begun at a peak keep their fitted values."""
    kind = type(term.effect)
    places = [*kind.scan, *_of_peaks(kind)]
    return EffectTerm(kind.from_values({name: getattr(term.effect, name) for name in places}), term.channel)


def _of_peaks(kind: type[Effect]) -> list[str]:
    """Parameters of an effect that peaks of the residual tell."""
    if kind.starts_at is None:
        return []
    first, other = kind.at_peaks((1.0, 2.0, 3.0)), kind.at_peaks((4.0, 5.0, 6.0))
    names = [entry.name for entry in kind.parameters()]
    return [name for name in names if getattr(first, name) != getattr(other, name)]


def _clocks(models: Sequence[FlightModel], named: Sequence[EffectTerm]) -> list[EffectTerm]:
    """Clocks that were set at some instant, if a name shifts stamps; none for several recordings, which share none."""
    if len(models) > 1 or all(type(term.effect).sample_time is Effect.sample_time for term in named):
        return []
    kinds = generic_clock_settings()
    # an instant costs nothing where the name has further parameters too
    log_trials = math.log(len(kinds)) if sum(len(term.values) for term in named) == 1 else 0.0
    return [EffectTerm(kind(), log_trials=log_trials) for kind in kinds]


def _is_clock(candidate: Candidate[EffectTerm]) -> bool:
    return isinstance(candidate.term.effect, GenericClockStep)


def _offered(models: Sequence[FlightModel], null: FlightFit, before: Sequence[Check]) -> list[EffectTerm]:
    strength = {entry.name: abs(entry.z) for entry in before}
    # a clock that was set shows in what is left; in place of names it is begun where it was set
    kinds = [kind for kind in generic_effects() if not issubclass(kind, GenericClockStep)]
    tested = sorted((kind for kind in kinds if kind.name in strength), key=lambda kind: -strength[kind.name])
    terms = [
        EffectTerm(kind()) for kind in (*tested[:_REFITTED], *(kind for kind in kinds if kind.name not in strength))
    ]
    proposals = find_proposals(models, null)
    return terms + [term for kind in generic_lines() for term in proposed_terms(kind, proposals)]


def _refitted(models: Sequence[FlightModel], base: FlightFit, candidate: Candidate[EffectTerm]) -> FlightFit | None:
    try:
        begun = (*base.terms, perturbed_start(candidate, _FIRST_STEP))
        return fit(models, begun, base, _RANKING_STEPS, UNPREJUDICED, values_alone=True)
    except UNPHYSICAL:
        return None
