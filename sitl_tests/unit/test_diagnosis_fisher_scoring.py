"""The engine of every fit against closed forms: a straight line with normal priors, and a likelihood with an edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from companion.diagnosis.selection.fisher_scoring import NormalPrior, Parameter, Scores, maximise
from companion.records import Floats


@dataclass
class Line:
    """Samples y = A x + noise of unit variance."""

    design: Floats
    y: Floats
    parameters: Sequence[Parameter]

    def log_likelihood(self, values: Floats, near: None = None) -> float:
        del near
        return -0.5 * float(np.sum((self.y - self.design @ values) ** 2) + len(self.y) * np.log(2.0 * np.pi))

    def scores(self, values: Floats) -> Scores[None]:
        gradient = self.design.T @ (self.y - self.design @ values)
        return Scores(self.log_likelihood(values), gradient, self.design.T @ self.design, None)


@dataclass
class Rate:
    """A mean count of ``total`` events in ``n`` windows (Poisson); there is no negative rate."""

    n: int
    total: int
    parameters: Sequence[Parameter] = (Parameter("rate", 5.0, 100.0),)

    def log_likelihood(self, values: Floats, near: None = None) -> float:
        del near
        if values[0] <= 0.0:
            raise ValueError("no negative rate")
        return float(self.total * np.log(values[0]) - self.n * values[0])

    def scores(self, values: Floats) -> Scores[None]:
        gradient = np.array([self.total / values[0] - self.n])
        return Scores(self.log_likelihood(values), gradient, np.array([[self.n / values[0]]]), None)


def test_a_straight_line_is_fitted_in_one_step_with_its_exact_evidence() -> None:
    rng = np.random.default_rng(3)
    design, sigmas, centres = rng.normal(size=(40, 2)), np.array([0.3, 2.0]), np.array([1.0, -1.0])
    y = design @ np.array([1.2, 0.5]) + rng.normal(size=40)
    priors = zip(centres.tolist(), sigmas.tolist(), strict=True)
    line = Line(design, y, [Parameter("", *prior) for prior in priors])
    best = maximise(line, centres, rounds=5)
    precision = design.T @ design + np.diag(sigmas**-2)
    np.testing.assert_allclose(best.values, np.linalg.solve(precision, design.T @ y + centres / sigmas**2))
    np.testing.assert_allclose(best.covariance, np.linalg.inv(precision))
    assert best.converged
    marginal = multivariate_normal(design @ centres, np.eye(40) + design @ np.diag(sigmas**2) @ design.T)
    assert best.log_evidence == pytest.approx(float(marginal.logpdf(y)))


def test_a_step_beyond_what_is_physical_is_shortened() -> None:
    best = maximise(Rate(50, 5), np.array([4.0]), rounds=30)
    assert best.converged
    assert best.values[0] == pytest.approx(0.1, rel=0.02)


@dataclass
class Coherence(Line):
    """The same line, whose expected information is twice what the data show."""

    asked: list[Floats] = field(default_factory=list)

    def scores(self, values: Floats) -> Scores[None]:
        self.asked.append(values)
        plain = Line.scores(self, values)
        return Scores(plain.log_likelihood, plain.gradient, 2.0 * plain.information, None)

    def neighbour_scores(self, values: Floats, near: None) -> Scores[None]:
        del near
        plain = Line.scores(self, values)
        return Scores(plain.log_likelihood, plain.gradient, 2.0 * plain.information, None)


@pytest.fixture
def coherence() -> Coherence:
    rng = np.random.default_rng(4)
    design = rng.normal(size=(40, 2))
    y = design @ np.array([3.0, -2.0]) + rng.normal(size=40)
    return Coherence(design, y, [Parameter("", 0.0, 1e6)] * 2)


def test_a_step_that_information_makes_too_short_is_lengthened(coherence: Coherence) -> None:
    best = maximise(coherence, np.zeros(2), rounds=30)
    assert best.converged
    np.testing.assert_allclose(best.values, np.linalg.lstsq(coherence.design, coherence.y)[0], atol=1e-6)
    assert len(coherence.asked) == 2


def test_no_step_is_made_that_promises_nothing(coherence: Coherence) -> None:
    top = np.linalg.lstsq(coherence.design, coherence.y)[0]
    best = maximise(coherence, top + 0.001, rounds=30)
    assert best.converged
    assert len(coherence.asked) == 1


def test_the_top_that_a_neighbours_derivatives_lead_to_is_judged_with_its_own(coherence: Coherence) -> None:
    coherence.parameters = [Parameter("", 0.0, 1.0), Parameter("", 0.0, 0.2)]
    best = maximise(coherence, np.zeros(2), 30, coherence.neighbour_scores)
    assert best.converged
    np.testing.assert_array_equal(coherence.asked[-1], best.values)
    asked = len(coherence.asked)
    rough = maximise(coherence, np.zeros(2), 30, coherence.neighbour_scores, values_alone=True)
    np.testing.assert_allclose(rough.values, best.values, atol=0.02)
    assert len(coherence.asked) - asked < asked


def test_an_information_that_rounding_left_indefinite_is_no_wider_than_the_prior() -> None:
    sigmas = np.array([1e-6, 1e3])
    log_determinant, covariance = NormalPrior([Parameter("", 0.0, sigma) for sigma in sigmas]).posterior(
        np.diag([4e12, -1e-4])
    )
    np.testing.assert_allclose(np.diag(covariance), [0.25e-12, 1e6])
    assert log_determinant == pytest.approx(np.log(4.0))
