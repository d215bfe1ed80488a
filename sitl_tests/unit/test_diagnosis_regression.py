"""Regressions under the engine: what a held-out row scores, against the closed form of least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student_t

from companion.diagnosis.selection.regression import (
    Coefficient,
    RegressionModel,
    RegressionResponse,
    Regressions,
    RegressionTerm,
)


@pytest.mark.parametrize("held_out", [0, 5])
def test_a_held_out_row_scores_by_student_s_t_with_the_error_of_the_line(held_out: int) -> None:
    """With a normal of the fitted noise an extrapolated row cost hundreds of nat."""
    rng = np.random.default_rng(2)
    x = np.linspace(-1.0, 1.0, 10)
    y = 3.0 + 2.0 * x + 0.1 * rng.standard_normal(10)
    group, block = np.zeros(10, dtype=np.int64), np.arange(10.0)
    response = RegressionResponse("y", y, np.ones(10), group, block, x, 0.0, 1e3, 0.1)
    line = RegressionTerm("line", "", (Coefficient("slope", "y", x, 1e3, "", "its slope"),))
    regressions = Regressions([response], [line])
    fitted = regressions.fit((line,), regressions.null())
    again = regressions.without(fitted, float(held_out))
    rest = np.arange(10) != held_out
    design = np.stack([np.ones(10), x], 1)
    line_of, residue, *_ = np.linalg.lstsq(design[rest], y[rest], rcond=None)
    free = 9 - 2
    leverage = design[held_out] @ np.linalg.inv(design[rest].T @ design[rest]) @ design[held_out]
    scale = np.sqrt(residue[0] / free * (1.0 + leverage))
    expected = student_t.logpdf((y - design @ line_of)[held_out] / scale, free) - np.log(scale)
    # the prior of the noise (a factor of 20) pulls its logarithm by 1 %
    assert again.state.log_predictive(again, 0)[held_out] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("noise", [1e-6, 1e-5, 0.3])
def test_the_gradient_is_the_difference_quotient(noise: float) -> None:
    """Below what no instrument resolves (1e-5 here), beside it and above it."""
    rng = np.random.default_rng(3)
    y = 3.0 + noise * rng.standard_normal(10)
    response = RegressionResponse(
        "y", y, np.linspace(0.5, 2.0, 10), np.zeros(10, dtype=np.int64), y, y, 0.0, 1e3, 0.1, independent_ratio=0.5
    )
    model = RegressionModel([response], ())
    at, step = np.array([3.0 + 0.3 * noise, np.log(2.0 * noise)]), np.diag([1e-4 * noise, 1e-4])
    slopes = [(model.log_likelihood(at + row) - model.log_likelihood(at - row)) / (2.0 * row.sum()) for row in step]
    assert model.scores(at).gradient == pytest.approx(slopes, rel=1e-4)


def test_equal_rows_have_the_noise_that_no_instrument_is_below() -> None:
    """Their fitted noise went to 0 and the information to infinity."""
    y = np.full(20, 3.0)
    response = RegressionResponse("y", y, np.ones(20), np.zeros(20, dtype=np.int64), y, y, 0.0, 1e3, 0.1)
    regressions = Regressions([response], [])
    fitted = regressions.null()
    assert fitted.values[0] == pytest.approx(3.0)
    assert fitted.spread[0] == pytest.approx(1e-5 / np.sqrt(20.0), rel=0.05)  # the prior of the noise adds a little
    assert regressions.checks(fitted) == []
