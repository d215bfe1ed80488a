"""The bias that the response's noise gives to least squares is taken off to first order."""

from __future__ import annotations

import numpy as np
import pytest

from companion.diagnosis.forced.noise_bias import NoiseShare


@pytest.mark.parametrize(("added", "moved"), [(0.4, 1.0 / 0.6 - 1.0), (0.6, 0.0)])
def test_the_noise_of_one_column_shifts_its_coefficient_up_to_half(added: float, moved: float) -> None:
    """(A - B) theta = A theta_LS with A = 1 and theta_LS = 1."""
    biased = NoiseShare(("stiffness", "unused"), np.array([[0.6, 0.8], [1.0, 0.0]]), np.diag([added, 0.0]))
    assert biased.ratio(["stiffness"], 0.0) == pytest.approx(added)
    assert biased.shift(["stiffness"], np.array([1.0]), 0.0) == pytest.approx({"stiffness": moved})
