"""The search over terms: what it need not fit, on recordings whose evidence is a table."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.fit import Fit
from companion.diagnosis.selection.forward_selection import ForwardSelection
from companion.diagnosis.selection.recordings import Prediction, Progress, Recordings
from companion.diagnosis.selection.score_tests import Candidate, Screening
from sitl_tests.unit.test_diagnosis_score_tests import Named

Fitted = Fit[Named, None]


class Table(Recordings[Named, None]):
    """Evidence by what is fitted, and how strong and how likely each term's score is on top of what has been fitted."""

    def __init__(self, evidence: dict[str, float], scores: dict[str, list[tuple[str, float, float]]]) -> None:
        self._evidence, self._scores = evidence, scores
        self.refitted: list[str] = []
        self.gone_on: list[str] = []

    @property
    def log_count(self) -> float:
        return 0.0

    def _fitted(self, terms: Sequence[Named], converged: bool) -> Fitted:
        n, evidence = len(terms), self._evidence["".join(sorted(term.name for term in terms))]
        names = tuple(term.name for term in terms)
        blocks = tuple((k,) for k in range(n))
        return Fit(
            tuple(terms), names, blocks, np.zeros(n), np.zeros(n), np.ones(n), np.eye(n), evidence, evidence, converged,
            None,
        )  # fmt: skip

    def null(self) -> Fitted:
        return self._fitted((), True)

    def fit(self, terms: Sequence[Named], near: Fitted, wider: float = 1.0, quick: bool = False) -> Fitted:
        if quick:
            self.gone_on.append("".join(term.name for term in terms))
        return self._fitted(terms, True)

    def screen(self, fitted: Fitted, progress: Progress) -> Screening[Named]:
        entries = self._scores.get("".join(term.name for term in fitted.terms), [])
        apart = np.eye(len(entries))
        return Screening(tuple(Candidate(Named(name), z, odds) for name, z, odds in entries), apart, apart)

    def refit(self, fitted: Fitted, candidate: Candidate[Named]) -> tuple[Candidate[Named], Fitted] | None:
        terms = (*fitted.terms, candidate.term)
        self.refitted.append("".join(term.name for term in terms))
        return candidate, self._fitted(terms, False)

    def checks(self, fitted: Fitted) -> list[Check]:
        return []

    def folds(self) -> list[Callable[[Fitted], list[Prediction]]]:
        return []


def search(table: Table) -> list[str]:
    null = table.null()
    first = table.screen(null, lambda _what, _ratio: None)
    path = ForwardSelection(table, lambda _what, _ratio: None).search(null, first, 2)
    return sorted(cause.term.name for cause in path.causes)


def test_names_that_another_path_has_grown_to_are_not_fitted_again() -> None:
    table = Table(
        {"": 0.0, "a": 50.0, "b": 40.0, "ab": 90.0},
        {"": [("a", 10.0, 50.0), ("b", 9.0, 40.0)], "a": [("b", 9.0, 40.0)], "b": [("a", 10.0, 50.0)]},
    )
    assert search(table) == ["a", "b"]
    assert table.refitted == ["a", "b", "ab"]


@pytest.mark.parametrize(("evidence", "goes_on"), [(-1.0, False), (2.0, True)])
def test_a_first_fit_that_is_no_name_and_like_none_does_not_go_on(evidence: float, goes_on: bool) -> None:
    table = Table({"": 0.0, "a": 20.0, "b": evidence}, {"": [("a", 6.0, 20.0), ("b", 5.0, 8.0)]})
    assert search(table) == ["a"]
    assert ("b" in table.gone_on) is goes_on


class SlowTable(Table):
    """A first fit ends 29 nat below what it comes to."""

    def refit(self, fitted: Fitted, candidate: Candidate[Named]) -> tuple[Candidate[Named], Fitted] | None:
        offered, reached = super().refit(fitted, candidate) or (candidate, fitted)
        return offered, dataclasses.replace(reached, log_evidence=reached.log_evidence - 29.0)


@pytest.mark.parametrize(("odds", "named"), [(13.0, ["a"]), (-1.0, [])])
def test_a_lone_first_fit_goes_on_to_what_its_score_promises(odds: float, named: list[str]) -> None:
    """A frequency 25 % off was left unexplained: after five steps the fit with its name was 15 nat below none."""
    table = SlowTable({"": 0.0, "a": 14.0}, {"": [("a", 5.4, odds)]})
    assert search(table) == named


@pytest.mark.parametrize(("odds", "fitted"), [(6.0, False), (8.0, True)])
def test_what_is_too_weak_for_a_name_is_fitted_where_it_may_be_like_one(odds: float, fitted: bool) -> None:
    table = Table({"": 0.0, "a": 20.0, "b": 7.0}, {"": [("a", 6.0, 20.0), ("b", 4.0, odds)]})
    assert search(table) == ["a"]
    assert ("b" in table.refitted) is fitted


class WideTable(Table):
    """Under wide priors ``a`` alone has 15 nat more: its value is far out in its own prior."""

    def fit(self, terms: Sequence[Named], near: Fitted, wider: float = 1.0, quick: bool = False) -> Fitted:
        fitted = super().fit(terms, near, wider, quick)
        gained = 15.0 if wider > 1.0 and [term.name for term in terms] == ["a"] else 0.0
        values = np.array([20.0 if term.name == "a" else 1.2 for term in terms])
        return dataclasses.replace(fitted, values=values, log_evidence=fitted.log_evidence + gained)


@pytest.mark.parametrize(("both", "named"), [(64.0, ["a"]), (66.0, ["a", "b"])])
def test_a_cause_that_only_spares_another_s_prior_is_left_out(both: float, named: list[str]) -> None:
    """A focal length 10 % long was named with a baseline error of 1.2 sigma, and its own value was 4.5 sigma off."""
    table = WideTable({"": 0.0, "a": 50.0, "b": 1.0, "ab": both}, {"": [("a", 10.0, 50.0)], "a": [("b", 9.0, 40.0)]})
    assert search(table) == named


def test_a_term_without_which_all_is_far_behind_is_left_out_for_a_few_steps_only() -> None:
    table = Table({"": 0.0, "a": 100.0, "b": 120.0, "ab": 300.0}, {"": [("b", 20.0, 120.0)], "b": [("a", 15.0, 100.0)]})
    assert search(table) == ["a", "b"]
    assert table.gone_on[-1] == "a"


def test_two_channels_that_are_alike_are_a_group_of_one_effect() -> None:
    table = Table({"": 0.0, "drift": 50.0}, {})
    scores = [Candidate(Named("drift", channel), 10.0, 50.0) for channel in ("temperature_degc", "battery_v")]
    first = Screening(tuple(scores), np.array([[1.0, 0.99], [0.99, 1.0]]), np.ones((2, 2)))
    path = ForwardSelection(table, lambda _what, _ratio: None).search(table.null(), first, 1)
    (cause,) = path.causes
    assert (cause.term.channel, cause.group) == ("temperature_degc", ("drift (battery_v)",))
