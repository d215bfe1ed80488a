"""Regressions under the engine: what a held-out row scores, against the closed form of least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student_t

from companion.diagnosis.selection.regression import Coefficient, RegressionResponse, Regressions, RegressionTerm


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
