"""How slow a load is left open, with and without gyros; the tracker's own flights are in ``physics``."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.core.tracking.adaptation.adaptation import epoch_slope_rates
from companion.core.tracking.adaptation.slow_load import LEAST_CORNER_HZ, SlopeRates, slope_rates, slow_corner_hz
from companion.core.tracking.parameters import CORNER_1, ModeParameters, prior_parameters
from companion.core.tracking.states import P_LEFT, P_RIGHT, P_ROOT, make_layout
from sitl_tests.unit.test_tracking_adaptation import _epochs
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


def test_gyros_show_a_corner_that_the_vertical_axes_do_not() -> None:
    """A bend that follows its load at once: rate density ``(2 pi f s / omega^2)^2 L(f)``, its corner at 0.4 Hz."""
    seconds, corner_hz, omega = 100.0, 0.4, 2.0 * math.pi * math.exp(LOGS[0])
    frequency_hz = np.fft.rfftfreq(round(seconds / STEP_S), STEP_S)
    load = math.exp(LOGS[2]) * (1.0 + (5.0 / corner_hz) ** 2) * (1.0 + (5.0 / 20.0) ** 2)
    load = load / (1.0 + (frequency_hz / corner_hz) ** 2) / (1.0 + (frequency_hz / 20.0) ** 2)
    density = (2.0 * math.pi * frequency_hz * SLOPE_FACTOR / omega**2) ** 2 * load
    noise = np.random.default_rng(4).standard_normal((2, len(frequency_hz)))
    drawn = np.fft.irfft(np.sqrt(density / (4.0 * STEP_S) * len(frequency_hz) * 2.0) * (noise[0] + 1j * noise[1]))
    rates = slope_rates(drawn, STEP_S, 1e-9, SLOPE_FACTOR)
    assert rates is not None
    # 90 bins, half of them independent, tell a level to a seventh; a corner moves the level about it less than twice
    assert _left_open(10.0, corner_hz, 0.6, rates) == pytest.approx(corner_hz, rel=0.3)


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
    # 90 bins of which half are independent: their mean within four of its sigmas
    assert np.mean(rates.power) == pytest.approx(2.0 * STEP_S, rel=4.0 / math.sqrt(46.0))


def test_a_few_missing_rates_are_bridged_and_many_tell_nothing() -> None:
    t_s = STEP_S * np.arange(5000)
    rates = np.sin(2.0 * math.pi * 0.5 * t_s)
    whole_record = slope_rates(rates, STEP_S, 1.0, 1.0)
    rates[1000:1010] = np.nan
    bridged = slope_rates(rates, STEP_S, 1.0, 1.0)
    assert whole_record is not None
    assert bridged is not None
    np.testing.assert_allclose(bridged.power, whole_record.power, rtol=0.02, atol=1e-3 * whole_record.power.max())
    rates[2000:2200] = np.nan
    assert slope_rates(rates, STEP_S, 1.0, 1.0) is None
    assert slope_rates(np.zeros(100), STEP_S, 1.0, 1.0) is None


def test_rates_of_slope_are_of_wings_that_bend_up() -> None:
    """Up-bend turns the left tip about +x, the right one about -x; a rigid roll turns all three alike."""
    epochs = _epochs(0.1)
    rows = epochs.rows.copy()
    up_radps, apart_radps, roll_radps = 0.03, 0.01, 0.5  # both tips up; the right up and the left down; rigid
    rows[:, P_LEFT] = roll_radps + up_radps - apart_radps
    rows[:, P_RIGHT] = roll_radps - up_radps - apart_radps
    rows[:, P_ROOT] = roll_radps
    present = epochs.present.copy()
    present[3, P_RIGHT] = False
    rates = epoch_slope_rates(epochs._replace(rows=rows, present=present))
    np.testing.assert_allclose(rates[4:], np.tile([up_radps, apart_radps], (len(rates) - 4, 1)))
    assert np.isnan(rates[3]).all()
