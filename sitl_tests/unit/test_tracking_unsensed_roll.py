"""A roll rate that no station sends: it stays as unknown as any aircraft's is, and teaches nothing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from companion.core.tracking.kernel_arrays import _linearisation_rows
from companion.core.tracking.model import build_model, propagation
from companion.params.files import load_airframe
from sitl_tests.unit.tracking_samples import prior_of

STEP_S = 0.004
ROLL_ROW = 4  # behind both tips' slopes and slope rates


@pytest.mark.parametrize("name", ["paper-flying-wing", "sitl-plane"])
def test_the_variance_of_a_rate_that_nobody_measures_is_bounded(name: str) -> None:
    layout, noise, believed = prior_of(load_airframe(name), STEP_S)
    assert not layout.senses_roll
    transition, process = propagation(layout, noise, believed, STEP_S)
    rigid = slice(layout.roll_rate, layout.roll_accel + 1)
    stationary = solve_discrete_lyapunov(transition[rigid, rigid], process[rigid, rigid])
    assert np.abs(np.linalg.eigvals(transition[rigid, rigid])).max() < 1.0
    assert 3.0 < np.sqrt(stationary[0, 0]) < 100.0, "wider than any aircraft rolls, and yet a number"


@pytest.mark.parametrize(("name", "senses"), [("paper-flying-wing", False), ("nadir-2m", True)])
def test_products_with_an_unsensed_rate_teach_no_rate(name: str, senses: bool) -> None:
    layout, noise, believed = prior_of(load_airframe(name), STEP_S)
    rows = _linearisation_rows(layout, build_model(layout, noise, believed, (-1.0, 1.0), STEP_S))
    assert bool(rows[ROLL_ROW].any()) is senses
    assert rows[ROLL_ROW + 1].any()
