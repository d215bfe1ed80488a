"""Error by constants that a manoeuvre brings: none where the sensitivity is steady, ``d' P d`` where it has changed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from companion.core.tracking.manoeuvre_error import ManoeuvreError
from companion.records import Floats

COVARIANCE = np.array([[4e-6, 1e-6], [1e-6, 1e-6]])
LEVEL, ROLLING = np.array([0.3, -0.1]), np.array([0.3, 0.4])
_S = 1_000_000_000


def _sigmas(sensitivities: list[Floats], step_s: float = 0.1) -> list[float]:
    error = ManoeuvreError()
    return [error.sigma_rad(round(i * step_s * _S), each, COVARIANCE) for i, each in enumerate(sensitivities)]


def test_a_steady_sensitivity_brings_nothing() -> None:
    assert max(_sigmas([LEVEL] * 300)) == pytest.approx(0.0, abs=1e-12)


def test_a_manoeuvre_after_long_level_flight_brings_the_error_of_the_whole_change_and_takes_it_away() -> None:
    sigmas = _sigmas([LEVEL] * 300 + [ROLLING] * 5 + [LEVEL] * 5)
    change = ROLLING - LEVEL
    full_sigma = float(np.sqrt(change @ COVARIANCE @ change))
    assert all(0.95 * full_sigma < sigma <= full_sigma for sigma in sigmas[300:305])
    assert max(sigmas[305:]) < 0.05 * full_sigma


def test_a_change_that_stays_comes_to_last() -> None:
    sigmas = _sigmas([LEVEL] * 300 + [ROLLING] * 900)
    assert sigmas[-1] < 0.02 * sigmas[300]
    assert all(after <= before for before, after in pairwise(sigmas[300:]))


def test_the_other_camera_of_a_pair_exposed_at_the_same_instant_changes_nothing() -> None:
    error, twice = ManoeuvreError(), ManoeuvreError()
    for i, each in enumerate([LEVEL] * 20 + [ROLLING] * 20):
        one_sigma = error.sigma_rad(i * _S, each, COVARIANCE)
        assert twice.sigma_rad(i * _S, each, COVARIANCE) == one_sigma
        assert twice.sigma_rad(i * _S, each, COVARIANCE) == one_sigma


def test_a_pause_teaches_nothing() -> None:
    error = ManoeuvreError()
    for i in range(300):
        error.sigma_rad(i * _S // 10, LEVEL, COVARIANCE)
    change = ROLLING - LEVEL
    sigma = error.sigma_rad(3600 * _S, ROLLING, COVARIANCE)
    assert sigma > 0.9 * float(np.sqrt(change @ COVARIANCE @ change))


def test_the_second_sensitivity_is_not_taken_for_the_mean() -> None:
    first, second = _sigmas([LEVEL, ROLLING])
    change = ROLLING - LEVEL
    assert first == 0.0
    assert second > 0.8 * float(np.sqrt(change @ COVARIANCE @ change))
