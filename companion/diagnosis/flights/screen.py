"""Screens every named effect at once: efficient scores with the nuisances projected out, no refit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from companion.core.wing.effect import Effect
from companion.diagnosis.flights.simulated_scores import is_sample_nonlinearity, score_scatter
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, derivatives, expect, joint_scores
from companion.diagnosis.model.scores import Column
from companion.diagnosis.selection.forward_selection import UNPREJUDICED
from companion.diagnosis.selection.score_tests import Candidate, Screening, Tested, efficient, ranked
from companion.records import Floats

_UNIT = 1e-3  # prior sigmas (numerical)
_SLIGHT = 0.01  # prior sigmas: a strength at which an instant or a frequency has an effect (choice)


def screen(
    models: Sequence[FlightModel],
    null: FlightFit,
    terms: Sequence[EffectTerm],
    progress: Callable[[float], None] = lambda _ratio: None,
    shapes: bool = False,
) -> Screening[EffectTerm]:
    """Score every term at a fitted model ``null``, which may hold effects that have been accepted.

    ``terms`` as :func:`.proposals.candidates_of` gives them; ``progress`` takes the share that is done. With
    ``shapes`` parameters without an effect at strength 0 (an instant, a frequency) have the columns of a slight
    strength. These say nothing of whether an effect is there, but which other effects it can imitate.
    """
    columns = [list(entry) for entry in null.state.columns]
    tested: list[Tested[EffectTerm]] = []
    sided = [(term, side) for term in terms for side in ((1.0, -1.0) if term.effect.hinged else (1.0,))]
    for done, (term, side) in enumerate(sided):
        declared = term.effect.parameters()
        sigmas = np.array([entry.sigma for entry in declared])
        values = np.concatenate([null.values, [getattr(term.effect, entry.name) for entry in declared]])
        # a mode's frequency has no effect while its participation is 0: neither it nor later parameters have a column
        count = next((k for k, entry in enumerate(declared) if entry.name in term.effect.scan), len(declared))
        only = range(len(null.values), len(null.values) + count)
        wide = np.concatenate([null.sigmas, side * sigmas])  # its sign is that of the step
        new_columns = derivatives(models, values, (*null.terms, term), null.state.expectations, wide, only)
        rest = [[Column()] * (len(declared) - count) for _ in models]
        if shapes and count < len(declared):
            rest = _of_slight(models, null, term, count, wide)
        new_columns = [[*recording, *further] for recording, further in zip(new_columns, rest, strict=True)]
        columns = [[*before, *new] for before, new in zip(columns, new_columns, strict=True)]
        tested.append(Tested(term, sigmas, side, term.effect.one_way or term.effect.hinged, UNPREJUDICED))
        progress((done + 1) / len(sided))
    score, information = efficient(*joint_scores(models, null.state.expectations, columns), null)
    wider = _score_scatter(models, null, tested)
    information = information * np.outer(wider, wider)
    return ranked(tested, score, information)


def _of_slight(
    models: Sequence[FlightModel], null: FlightFit, term: EffectTerm, count: int, sigmas: Floats
) -> list[list[Column]]:
    """Columns of the parameters of a term from its ``count``-th on, by recording, where it is slightly there."""
    first, begun = term.effect.parameters()[0], len(null.values)
    slight = term.with_values(
        dict(zip((entry.name for entry in term.effect.parameters()), term.values, strict=True))
        | {first.name: getattr(term.effect, first.name) + _SLIGHT * first.sigma}
    )
    values = np.concatenate([null.values, slight.values])
    terms = (*null.terms, slight)
    beside = expect(models, values, terms, null.state.expectations)
    return derivatives(models, values, terms, beside, sigmas, range(begun + count, len(values)))


def _score_scatter(models: Sequence[FlightModel], null: FlightFit, tested: Sequence[Tested[EffectTerm]]) -> Floats:
    """Ratio by which each parameter's score scatters beyond its column, (d,): 1 but for nonlinear sensors."""
    wider, at = np.ones(sum(len(candidate.sigmas) for candidate in tested)), 0
    bent: dict[int, Effect] = {}
    for candidate in tested:
        names = [entry.name for entry in candidate.term.effect.parameters()]
        if is_sample_nonlinearity(candidate.term.effect) and len(names) == 1:
            bent[at] = candidate.term.with_values({names[0]: _UNIT * float(candidate.sigmas[0])}).effect
        at += len(candidate.sigmas)
    if bent:
        wider[list(bent)] = score_scatter(models, null.state.expectations, list(bent.values()))
    return wider


def perturbed_start(candidate: Candidate[EffectTerm], most: float, first: float = 0.5) -> EffectTerm:
    """Start a refit at a small step in the direction of the score, on the side where the effect can be.

    An effect at a frequency or instants that the data gave begins as strong as the score says. From less, the fit would
    move these away before the strength has grown. ``most`` (prior sigmas) equals ``first`` at the first attempt.
    """
    declared = candidate.term.effect.parameters()
    values = {entry.name: float(getattr(candidate.term.effect, entry.name)) for entry in declared}
    information = candidate.information + np.eye(len(declared))
    step = np.linalg.solve(information, candidate.score)
    steps = step / first if candidate.term.log_trials else np.clip(step, -1.0, 1.0)
    for entry, step_sigmas in zip(declared, steps.tolist(), strict=True):
        values[entry.name] += most * entry.sigma * step_sigmas
    return candidate.term.with_values(values)
