"""The engine of every fit against closed forms: a straight line with normal priors, and a likelihood with an edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from companion.diagnosis.selection.fisher_scoring import Parameter, Scores, maximise
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
