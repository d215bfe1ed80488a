"""Score tests: what a name's parameters can imitate together, and its own direction alone cannot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from companion.diagnosis.selection import score_tests


@dataclass(frozen=True)
class _Named:
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
    tested = [score_tests.Tested(_Named("name"), np.ones(2)), score_tests.Tested(_Named("law"), np.ones(1))]
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
        score_tests.Tested(_Named("a"), np.ones(3)),
        score_tests.Tested(_Named("b"), np.ones(2)),
        score_tests.Tested(_Named("c"), np.ones(2)),
    ]
    screening = score_tests.ranked(tested, columns.T @ rng.standard_normal(40), columns.T @ columns)
    assert np.all(screening.imitation >= np.abs(screening.correlation) - 1e-9)
    assert np.all(screening.imitation <= 1.0 + 1e-9)
