"""Recordings of any kind as the engine asks them, and the causes that it keeps.

A model is ``parameters``, ``log_likelihood`` and ``scores`` (:class:`.fisher_scoring.LikelihoodModel`). Recordings fit
it with any terms, screen further terms, judge what is left against what the model makes by chance, and ``predict``
blocks that were not fitted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic

import numpy as np

from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.fisher_scoring import State
from companion.diagnosis.selection.fit import Fit
from companion.diagnosis.selection.score_tests import Candidate, Screening, TermT

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Prediction:
    """One block that was not fitted: log likelihood by channel, squared error and signal, and how many numbers."""

    log_scores: dict[str, float]
    squared_error: float = 0.0
    squared_signal: float = 0.0
    count: int = 0


@dataclass(frozen=True, slots=True)
class Cause(Generic[TermT]):
    """One accepted term.

    ``group`` are the names that this recording cannot tell from it; ``log_bayes_factor`` and ``bic`` are against the
    model without it (BIC negative: better). ``evidence`` says what the samples show, for causes that needed no
    model.
    """

    term: TermT
    group: tuple[str, ...]
    log_bayes_factor: float
    bic: float
    z: float
    values: tuple[float, ...] = ()
    sigmas: tuple[float, ...] = ()
    evidence: str = ""


@dataclass(frozen=True, slots=True)
class SelectionPath(Generic[TermT, State]):
    """A model reached by accepting terms one after the other; ``stages`` are the fits on the way, the null first."""

    fitted: Fit[TermT, State]
    causes: tuple[Cause[TermT], ...] = ()
    stages: tuple[Fit[TermT, State], ...] = ()


class Recordings(ABC, Generic[TermT, State]):
    """Recordings of one kind, with the terms that may explain them."""

    measures_nearest: ClassVar[bool] = True
    """Whether terms meet rival laws and held-out blocks even where tests have failed, which no verdict needs."""

    @property
    @abstractmethod
    def log_count(self) -> float:
        """Logarithm of how many numbers were recorded, which BIC charges for each parameter."""

    @abstractmethod
    def null(self) -> Fit[TermT, State]:
        """The believed model, fitted."""

    @abstractmethod
    def fit(
        self, terms: Sequence[TermT], near: Fit[TermT, State], wider: float = 1.0, quick: bool = False
    ) -> Fit[TermT, State]:
        """Fit with some terms from what another fit has in common with it; terms' priors ``wider`` times as wide.

        Raises
        ------
        ValueError, FloatingPointError, LinAlgError
            The values are not physical.
        """

    @abstractmethod
    def screen(self, fitted: Fit[TermT, State], progress: Progress) -> Screening[TermT]:
        """Every further term's strength on top of a fit."""

    @abstractmethod
    def refit(
        self, fitted: Fit[TermT, State], candidate: Candidate[TermT]
    ) -> tuple[Candidate[TermT], Fit[TermT, State]] | None:
        """Fit with one term more in a few steps, with the candidate as it was begun; None where none is physical."""

    @abstractmethod
    def checks(self, fitted: Fit[TermT, State]) -> list[Check]:
        """Tests of what remains against what the model would draw; the worst first."""

    @abstractmethod
    def folds(self) -> Sequence[Callable[[Fit[TermT, State]], Sequence[Prediction]]]:
        """Each fits a model again without some blocks, and predicts these."""

    def plausible(self, fitted: Fit[TermT, State]) -> bool:
        """Whether the last term has values that are possible for it."""
        del fitted
        return True

    def not_identifiable(self, null: Fit[TermT, State]) -> str:
        """Reason for which nothing is identifiable by these recordings, "" if something is."""
        del null
        return ""

    def sample_causes(self) -> Sequence[Cause[TermT]]:
        """Causes that the samples themselves show."""
        return ()

    def objection(self, null: Fit[TermT, State], before: Sequence[Check], path: SelectionPath[TermT, State]) -> str:
        """Reason for which what was accepted is no explanation, "" if there is none."""
        del null, before, path
        return ""

    def foretells(self, term: TermT) -> bool:
        """Whether a term fitted on some blocks predicts others; impulses of one block do not predict another's."""
        del term
        return True


def no_correlation(candidates: Sequence[Candidate[TermT]]) -> Screening[TermT]:
    """A screening by refits; correlations between candidates are not known, and count as 0."""
    apart = np.eye(len(candidates))
    return Screening(tuple(sorted(candidates, key=lambda entry: -entry.z)), apart, apart)
