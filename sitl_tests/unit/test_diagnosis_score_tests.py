"""Score tests: what a name's parameters can imitate together, and its own direction alone cannot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from companion.diagnosis.selection import score_tests


@dataclass(frozen=True)
class Named:
    """A term that is a name and no more."""

    name: str
    channel: str = ""
    log_trials: float = 0.0

    @property
    def key(self) -> str:
        return self.name


def test_parameters_together_imitate_what_their_strongest_direction_does_not() -> None:
    """Scores of x, y (a name) and of a law that is y alone; the data ask for x."""
    columns = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    information = 100.0 * columns.T @ columns
    tested = [score_tests.Tested(Named("name"), np.ones(2)), score_tests.Tested(Named("law"), np.ones(1))]
    screening = score_tests.ranked(tested, np.array([50.0, 20.0, 20.0]), information)
    assert [candidate.name for candidate in screening.candidates] == ["name", "law"]
    assert screening.correlation[0, 1] == pytest.approx(2.0 / np.hypot(5.0, 2.0))
    assert screening.imitation[0, 1] == pytest.approx(1.0)
    assert screening.imitation[1, 0] == pytest.approx(screening.correlation[1, 0])
    assert np.diag(screening.imitation) == pytest.approx(1.0)


def test_an_imitation_lies_between_the_correlation_and_one() -> None:
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((40, 7))
    tested = [
        score_tests.Tested(Named("a"), np.ones(3)),
        score_tests.Tested(Named("b"), np.ones(2)),
        score_tests.Tested(Named("c"), np.ones(2)),
    ]
    screening = score_tests.ranked(tested, columns.T @ rng.standard_normal(40), columns.T @ columns)
    assert np.all(screening.imitation >= np.abs(screening.correlation) - 1e-9)
    assert np.all(screening.imitation <= 1.0 + 1e-9)


def test_the_best_of_several_places_pays_for_their_number() -> None:
    """Three places with scores of 4, 5 and 1 sigma: a chance three times as large as that of one place with 5."""
    information, score = 1e6 * np.eye(3), 1e3 * np.array([4.0, 5.0, 1.0])
    places = [score_tests.Tested(Named("scanned"), np.ones(1)) for _ in range(3)]
    (best,) = score_tests.ranked(places, score, information).candidates
    (alone,) = score_tests.ranked(places[:1], score[1:2], information[:1, :1]).candidates
    assert [norm.sf(entry.z) for entry in (best, alone)] == pytest.approx([3.0 * norm.sf(5.0), norm.sf(5.0)], rel=0.01)
    assert alone.log_odds - best.log_odds == pytest.approx(np.log(3.0))


def test_an_effect_far_beyond_its_prior_is_as_strong_as_its_score() -> None:
    """Ten prior sigmas of which the data tell each to 1.4: a score of 7 sigma, of which the narrow prior leaves 4."""
    information = np.array([[0.5]])
    narrow, wide = (score_tests.Tested(Named("off"), np.ones(1), wider=factor) for factor in (1.0, 5.0))
    (believed,) = score_tests.ranked([narrow], np.array([5.0]), information).candidates
    (offered,) = score_tests.ranked([wide], np.array([5.0]), information).candidates
    assert believed.z < 4.2
    assert 6.5 < offered.z < 7.1
    assert offered.is_far
    (expected,) = score_tests.ranked([wide], np.array([70.0]), np.array([[100.0]])).candidates
    assert not expected.is_far, "seven tenths of a prior sigma, told to a tenth"


@given(score=st.floats(-30.0, 30.0), information=st.floats(1e-3, 1e6))
def test_no_prior_makes_a_score_stronger_than_it_is(score: float, information: float) -> None:
    """The score in its own sigmas is an upper bound, whatever the priors."""
    tested = score_tests.Tested(Named("any"), np.ones(1), wider=5.0)
    scores = np.array([score * np.sqrt(information)])
    (candidate,) = score_tests.ranked([tested], scores, np.array([[information]])).candidates
    assert candidate.z <= abs(score) + 1e-6


def test_two_sides_of_one_term_are_one_place() -> None:
    information, score = 1e6 * np.eye(2), 1e3 * np.array([5.0, -5.0])
    sides = [score_tests.Tested(Named("hinged"), np.ones(1), side, True) for side in (1.0, -1.0)]
    (best,) = score_tests.ranked(sides, score, information).candidates
    assert best.z == pytest.approx(5.0, abs=0.01)
