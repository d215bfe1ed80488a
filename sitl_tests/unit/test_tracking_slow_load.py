"""How slow a load is left open, with and without gyros; the tracker's own flights are in ``physics``."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.core.tracking.adaptation.slow_load import LEAST_CORNER_HZ, SlopeRates, slope_rates, slow_corner_hz
from companion.core.tracking.parameters import CORNER_1, ModeParameters, prior_parameters
from companion.core.tracking.states import make_layout
from sitl_tests.unit.test_tracking_whittle import LOGS, STEP_S, _periodogram, _prior
from sitl_tests.unit.tracking_samples import plain_airframe

SLOPE_FACTOR = 1.4


def _with_corner(corner_hz: float) -> np.ndarray:
    """Parameters with another lower corner and the same load at the reference frequency."""
    moved = LOGS.copy()
    moved[CORNER_1] = math.log(corner_hz)
    return moved


def _left_open(seconds: float, true_hz: float, fitted_hz: float, rates: SlopeRates | None = None) -> float:
    logs = [
        math.log(
            slow_corner_hz(
                _periodogram(seconds, seed, _with_corner(true_hz)), _prior(), _with_corner(fitted_hz), 0, rates
            )
        )
        for seed in range(6)
    ]
    return math.exp(np.mean(logs))


def test_a_corner_that_shows_is_taken_as_it_is() -> None:
    assert 1.6 < _left_open(20.0, 2.0, 2.0) <= 2.0


def test_corners_below_what_shows_are_all_left_open() -> None:
    """Between the least corner and the first bin, 0.6 Hz in 10 s, all are alike: the mean of ``c^-2`` is theirs."""
    mean_hz = LEAST_CORNER_HZ * math.sqrt(2.0 * math.log(0.6 / LEAST_CORNER_HZ))
    assert _left_open(10.0, 0.04, 0.6) == pytest.approx(mean_hz, rel=0.3)


def test_gyros_that_show_no_slow_bend_exclude_the_slowest() -> None:
    still = slope_rates(np.zeros(2500), STEP_S, 1e-9, SLOPE_FACTOR)
    assert _left_open(10.0, 0.04, 0.6, still) > 2.0 * _left_open(10.0, 0.04, 0.6)


def test_gyros_that_show_a_slow_bend_leave_it_open() -> None:
    """A bend that follows ``f^-2`` of load has a white rate: ``2 pi s sqrt(S) f_ref / omega^2`` in root density."""
    frequency_hz, omega = np.arange(2, 10) / 10.0, 2.0 * math.pi * math.exp(LOGS[0])
    at_reference = math.exp(LOGS[2]) * (1.0 + (5.0 / 20.0) ** 2)
    density = (2.0 * math.pi * SLOPE_FACTOR * 5.0 / omega**2) ** 2 * at_reference
    moving = SlopeRates(frequency_hz, np.full(len(frequency_hz), density), 1e-9, SLOPE_FACTOR)
    assert _left_open(10.0, 0.04, 0.6, moving) < 0.15


def test_a_family_that_was_never_fitted_is_as_believed() -> None:
    airframe = plain_airframe()
    family: ModeParameters = prior_parameters(make_layout(airframe).symmetric, airframe.wing.gust)
    assert family.cautious() == family


@pytest.mark.parametrize("corners_hz", [(1.0, 30.0), (30.0, 1.0)])
def test_the_lower_corner_is_the_one_that_is_lowered(corners_hz: tuple[float, float]) -> None:
    believed = prior_parameters(make_layout(plain_airframe()).symmetric, plain_airframe().wing.gust)
    log_params = believed.log_params()
    log_params[3:5] = np.log(corners_hz)
    cautious = believed.with_log_params(log_params, believed.log_sigma, 0.1).cautious()
    assert sorted((cautious.corner_1_hz, cautious.corner_2_hz)) == pytest.approx([0.1, 30.0])


def test_the_density_of_white_rates_is_their_variance_over_half_the_rate() -> None:
    rates = slope_rates(np.random.default_rng(3).standard_normal(25_000), STEP_S, 1.0, 1.0)
    assert rates is not None
    # 90 bins of which two thirds are independent: their mean within four of its sigmas
    assert np.mean(rates.power) == pytest.approx(2.0 * STEP_S, rel=4.0 / math.sqrt(60.0))


def test_a_missing_rate_tells_nothing() -> None:
    rates = np.zeros(5000)
    rates[17] = np.nan
    assert slope_rates(rates, STEP_S, 1.0, 1.0) is None
    assert slope_rates(np.zeros(100), STEP_S, 1.0, 1.0) is None
