"""A drifting frequency: evening it out, and how its rate is found."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.tracking.adaptation.frequency_drift import (
    estimate_drift_rate,
    time_warped,
    to_segment_end,
    to_warped_time,
)
from companion.core.tracking.adaptation.periodogram import make_periodogram, make_periodograms
from companion.core.tracking.adaptation.whittle import LogNormalPrior, fit
from companion.core.tracking.parameters import FREQUENCY, parameter_index, parameter_limits, prior_parameters
from companion.core.tracking.states import make_layout
from companion.records import Floats
from sitl_tests.unit.test_tracking_whittle import LOGS, _prior, _simulate
from sitl_tests.unit.tracking_samples import plain_airframe

STEP_S, LENGTH_S, SEGMENT_S = 0.004, 20.0, 4.0
BAND_HZ = (0.25, 11.0, 120.0)
SENSOR_MPS2 = 0.02
TIME_S = (np.arange(round(LENGTH_S / STEP_S)) + 0.5) * STEP_S


@pytest.mark.parametrize("rate_per_s", [0.01, -0.01, 0.03, -0.003])
@pytest.mark.parametrize("frequency_hz", [3.0, 40.0])
def test_a_growing_frequency_becomes_a_steady_one_and_the_parameters_go_along(
    rate_per_s: float, frequency_hz: float
) -> None:
    phase = 2.0 * np.pi * frequency_hz * np.expm1(rate_per_s * TIME_S) / rate_per_s
    places = parameter_index([1])
    log_params = np.zeros(places.end[-1])
    log_params[FREQUENCY] = np.log(frequency_hz) + rate_per_s * LENGTH_S
    steady_hz = np.exp(to_warped_time(log_params, places, rate_per_s, LENGTH_S)[FREQUENCY])
    warped = time_warped(np.sin(phase), rate_per_s, STEP_S)
    inside = slice(20, -20)  # the ends have no neighbours; the taper takes them away
    np.testing.assert_allclose(warped[inside], np.sin(2.0 * np.pi * steady_hz * TIME_S)[inside], atol=0.004)


@pytest.mark.parametrize("rate_per_s", [0.0, 1e-9, 0.02, -0.02])
def test_there_and_back_is_where_it_began_and_only_frequencies_move(rate_per_s: float) -> None:
    places = parameter_index([3, 1])
    log_params = np.random.default_rng(3).normal(size=18)
    moved = to_segment_end(log_params, places, rate_per_s, LENGTH_S)
    np.testing.assert_allclose(to_warped_time(moved, places, rate_per_s, LENGTH_S), log_params, atol=1e-12)
    frequencies = [0, 5, 9, 13]  # of three modes of one family, and of one of the other
    # a line's end lies half its length beyond its middle
    np.testing.assert_allclose(
        (moved - log_params)[frequencies], 0.5 * rate_per_s * LENGTH_S, atol=(rate_per_s * 20) ** 2
    )
    np.testing.assert_array_equal(np.delete(moved, frequencies), np.delete(log_params, frequencies))


def test_what_does_not_drift_stays_as_it_is() -> None:
    samples = np.random.default_rng(4).normal(size=1000)
    assert time_warped(samples, 0.0, STEP_S) is samples


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("apart_hz", [0.0, 0.01, 0.03])
def test_lines_that_beat_stay_where_they_are(seed: int, apart_hz: float) -> None:
    """Two tips, each with a sine of its own: fit and rate, by turns, must not run away from the steady frequency."""
    rng = np.random.default_rng(seed)
    samples = 2.0 * np.sin(2.0 * np.pi * 5.0 * TIME_S + seed) + 1.8 * np.sin(2.0 * np.pi * (5.0 + apart_hz) * TIME_S)
    samples += rng.normal(0.0, SENSOR_MPS2, len(TIME_S))
    airframe = plain_airframe()
    family = prior_parameters(make_layout(airframe).symmetric, airframe.wing.gust)
    low, high = np.log(parameter_limits(len(family.modes)))
    places = parameter_index([len(family.modes)])
    prior = LogNormalPrior(family.log_params(), family.log_sigma, low, high, np.array([family.reference_hz]), places)
    segments = make_periodograms(samples.reshape(-1, round(SEGMENT_S / STEP_S)), STEP_S, BAND_HZ, noise_density)
    log_params, rate = family.log_params(), 0.0
    for _ in range(8):
        even = make_periodogram(time_warped(samples, rate, STEP_S), STEP_S, BAND_HZ, noise_density)
        log_params = to_segment_end(
            fit(even, prior, to_warped_time(log_params, places, rate, LENGTH_S), 6).log_params, places, rate, LENGTH_S
        )
        assert np.exp(log_params[FREQUENCY]) == pytest.approx(5.0 + 0.5 * apart_hz, abs=2.0 / LENGTH_S), "two bins"
        rate, _ = estimate_drift_rate(
            segments, SEGMENT_S, prior, to_warped_time(log_params, places, rate, LENGTH_S), rate
        )


def noise_density(frequency_hz: Floats) -> Floats:
    """Spectrum of a sensor with white noise."""
    return np.full(len(frequency_hz), 2.0 * STEP_S * SENSOR_MPS2**2)


@pytest.mark.parametrize("seed", range(3))
def test_an_engine_that_passes_for_a_further_mode_is_no_drift_of_the_wing(seed: int) -> None:
    """A line of 6 m/s^2 beside the second mode runs up by 2 %/s; both modes stay where they are."""
    engine_rate_per_s, engine_hz = 0.02, float(np.exp(LOGS[5]))
    since_middle_s = TIME_S - 0.5 * LENGTH_S
    phase = 2.0 * np.pi * engine_hz * np.expm1(engine_rate_per_s * since_middle_s) / engine_rate_per_s
    samples, prior = _simulate(LENGTH_S, seed) + 6.0 * np.sin(phase), _prior()
    log_params = fit(make_periodogram(samples, STEP_S, BAND_HZ, noise_density), prior, LOGS.copy(), 12).log_params
    segments, rate = (
        make_periodograms(samples.reshape(-1, round(SEGMENT_S / STEP_S)), STEP_S, BAND_HZ, noise_density),
        0.0,
    )
    for _ in range(6):
        rate, _ = estimate_drift_rate(segments, SEGMENT_S, prior, log_params, rate)
    assert abs(rate) < 0.05 * engine_rate_per_s
