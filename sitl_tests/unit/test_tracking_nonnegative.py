"""Least squares without negative unknowns: against scipy's, on problems like the tracker's and on awkward ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from companion.core.tracking.nonnegative import nonnegative_least_squares


@pytest.mark.parametrize("seed", range(200))
def test_it_leaves_no_larger_residual_than_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    shape = (count + int(rng.integers(0, 3)), count)
    equations = rng.random(shape) ** 3 if seed % 2 else rng.standard_normal(shape)
    target = rng.standard_normal(shape[0]) * 10.0 ** rng.uniform(-3.0, 3.0)
    ours = nonnegative_least_squares(equations, target)
    theirs, residual = nnls(equations, target)
    assert np.all(ours >= 0.0)
    assert np.linalg.norm(equations @ ours - target) <= residual + 1e-11 * np.linalg.norm(target)
    if np.linalg.cond(equations) < 1e3:
        np.testing.assert_allclose(ours, theirs, atol=1e-8 * np.linalg.norm(ours))


def test_nothing_to_explain_needs_nothing() -> None:
    np.testing.assert_array_equal(nonnegative_least_squares(np.eye(3), np.zeros(3)), np.zeros(3))
    np.testing.assert_array_equal(nonnegative_least_squares(np.eye(3), -np.ones(3)), np.zeros(3))


def test_equal_columns_share_their_target() -> None:
    solution = nonnegative_least_squares(np.ones((2, 2)), np.array([3.0, 3.0]))
    assert np.all(solution >= 0.0)
    assert solution.sum() == pytest.approx(3.0)
