"""Vibration is no load and teaches no scale: noise in the spectral fit, rigid motion in the regressors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from companion.core.tracking.adaptation.noise_psd import NoiseSpectrum, StaticBendResponse
from companion.core.tracking.adaptation.noise_search import (
    MOST_DEVIANCE,
    NOISE_LEAPS,
    deviance_per_bin,
    fit_with_noise,
    next_leap,
    noise_beyond,
)
from companion.core.tracking.adaptation.periodogram import Periodogram, make_periodogram
from companion.core.tracking.adaptation.whittle import LogNormalPrior, WhittleFit, fit
from companion.core.tracking.error_jacobians import error_columns
from companion.core.tracking.parameters import CORNER_1, CORNER_2, FREQUENCY, LOAD
from companion.core.tracking.rigid_body import BEFORE, _RootNoise, build_epochs
from companion.core.tracking.states import Y_LEFT, make_layout
from companion.core.tracking.streams import StreamSamples
from companion.records import Floats
from sitl_tests.unit.test_tracking_whittle import LOGS, STEP_S, _prior, _simulate
from sitl_tests.unit.tracking_samples import plain_airframe

BAND_HZ = (0.25, 11.0, 120.0)
BELIEVED = NoiseSpectrum(0.008**2 * 2 * STEP_S, 0.0, StaticBendResponse(5.0, 0.04, 0.0), 0.0, 0.0, 0.0, STEP_S)
SHAKEN_MPS2 = 0.03  # rms above 40 Hz
BAND_WIDTH_HZ = 85.0  # from 40 Hz to half the sampling rate
STRONG = 4000.0  # of the believed density, as a petrol engine shakes a quiet sensor


def _louder(ratio: float) -> NoiseSpectrum:
    return BELIEVED.louder(ratio, ratio)


def _shaken(seed: int, shaken_mps2: float) -> Periodogram:
    """20 s of a wing under a gust, with white vibration above 40 Hz."""
    sections = butter(4, 40.0, "highpass", fs=1.0 / STEP_S, output="sos")
    shaken = sosfilt(sections, np.random.default_rng(100 + seed).standard_normal(round(20.0 / STEP_S)))
    return make_periodogram(_simulate(20.0, seed) + shaken_mps2 * shaken / shaken.std(), STEP_S, BAND_HZ, BELIEVED)


def _learned(seed: int, shaken_mps2: float, start: Floats = LOGS) -> tuple[WhittleFit, WhittleFit, float]:
    """Fits of 20 s by the believed noise and by the learned one, and the learned ratio of density."""
    periodogram, prior, ratio = _shaken(seed, shaken_mps2), _prior(), 1.0
    plain = best = fit(periodogram, prior, start.copy(), 12)
    for second in range(5):
        periodogram, best, ratio = _leapt(ratio, NOISE_LEAPS[second % 3], periodogram, prior, best)
    return plain, best, ratio


def _leapt(
    ratio: float, leap: float | None, periodogram: Periodogram, prior: LogNormalPrior, best: WhittleFit
) -> tuple[Periodogram, WhittleFit, float]:
    """Periodogram, fit and ratio of density after a turn of the noise."""
    stages = fit_with_noise(_louder, ratio, leap, periodogram, prior, best)
    while True:
        try:
            next(stages)
        except StopIteration as end:
            result: tuple[Periodogram, WhittleFit, float] = end.value
            return result


def test_vibration_is_learned_as_noise_and_leaves_the_gust_its_corners() -> None:
    """White above 40 Hz it has the density ``rms^2 / 85 Hz``, twenty times the believed noise."""
    by_belief, by_learned = [], []
    for seed in range(6):
        plain, best, ratio = _learned(seed, SHAKEN_MPS2)
        density = SHAKEN_MPS2**2 / BAND_WIDTH_HZ
        assert density / 3.0 < ratio * BELIEVED.white < 3.0 * density
        by_belief.append(plain.log_params - LOGS)
        by_learned.append(best.log_params - LOGS)
    for corner in (CORNER_1, CORNER_2):
        assert abs(np.mean(by_learned, axis=0)[corner]) < 0.5 * abs(np.mean(by_belief, axis=0)[corner])


def test_strong_vibration_under_a_usual_gust_is_no_white_gust() -> None:
    """Fitted with the believed noise the gust comes out white and the mode low; the misfit says so, a leap mends it."""
    white = LOGS.copy()
    white[[CORNER_1, CORNER_2]] = np.log([500.0, 1000.0])
    shaken_mps2 = math.sqrt(STRONG * BELIEVED.white * BAND_WIDTH_HZ)
    for seed in range(6):
        plain, best, ratio = _learned(seed, shaken_mps2, white)
        assert plain.log_params[FREQUENCY] - LOGS[FREQUENCY] < -0.02
        assert ratio == pytest.approx(STRONG, rel=0.25)
        assert abs(best.log_params[FREQUENCY] - LOGS[FREQUENCY]) < 3.0 * best.log_sigma[FREQUENCY]
        shaken, prior = _shaken(seed, shaken_mps2), _prior()
        assert deviance_per_bin(shaken, prior, plain.log_params) > MOST_DEVIANCE
        assert deviance_per_bin(shaken.with_noise(_louder(ratio)), prior, best.log_params) < 1.2


def test_a_white_gust_that_passed_for_vibration_is_recognised_by_the_leap_back() -> None:
    """Noise as dense as the load explains all but the mode's foot, and no step from there leads to a quiet sensor."""
    white = LOGS.copy()
    white[[CORNER_1, CORNER_2]] = np.log([500.0, 1000.0])
    for seed in range(4):
        mistaken = float(np.exp(white[LOAD])) / BELIEVED.white
        loud = make_periodogram(_simulate(20.0, seed, white), STEP_S, BAND_HZ, _louder(mistaken))
        best, ratio = fit(loud, _prior(), LOGS, 12), mistaken
        for leap in NOISE_LEAPS:
            loud, best, ratio = _leapt(ratio, leap, loud, _prior(), best)
        assert ratio > 0.1 * mistaken
        _, best, ratio = _leapt(ratio, None, loud, _prior(), best)
        assert ratio == 1.0
        assert np.all(np.abs(best.log_params - white)[:2] < 3.0 * best.log_sigma[:2])


def test_a_leap_back_is_tried_every_second_turn_of_loud_noise_and_never_beside_clipped_samples() -> None:
    assert [next_leap(turn, 1e4, clipped=False) for turn in range(7)] == [1.0, None, 4.0, None, 0.25, None, 1.0]
    quiet = [next_leap(turn, 2.0, clipped=False) for turn in range(7)]
    assert quiet == [next_leap(turn, 1e4, clipped=True) for turn in range(7)] == [*NOISE_LEAPS, *NOISE_LEAPS, 1.0]


def test_what_bins_show_that_do_not_count_is_noise() -> None:
    shaken = _shaken(0, math.sqrt(STRONG * BELIEVED.white * BAND_WIDTH_HZ)).below(50.0)
    assert not shaken.weight[shaken.frequency_hz > 50.0].any()
    assert noise_beyond(_louder, shaken, _prior(), LOGS) == pytest.approx(STRONG, rel=0.1)
    assert noise_beyond(_louder, _shaken(0, 0.0).below(50.0), _prior(), LOGS) == 0.0


def test_a_sensor_as_quiet_as_believed_is_taken_as_such() -> None:
    for seed in range(6):
        plain, best, ratio = _learned(seed, 0.0)
        assert ratio == 1.0
        np.testing.assert_array_equal(best.log_params, plain.log_params)


@pytest.mark.parametrize("shaft_hz", [40.0, 63.0, 80.0, 100.0])
def test_the_roots_vibration_is_averaged_out_of_what_scales_are_learned_from(shaft_hz: float) -> None:
    """The tip is still and the root shakes by 1 m/s^2: the regressor of its lateral scale keeps a sixth of it at most.

    The row's innovation, tip less rigid force, is taken out by the filter; what is left is the rigid force of before.
    """
    layout, step_ns, amplitude_mps2, count = make_layout(plain_airframe()), 4_000_000, 1.0, 100
    samples = []
    for rate_hz, shaken_mps2 in ((333.0, amplitude_mps2), (1000.0, 0.0), (1000.0, 0.0)):
        t_ns = (np.arange(round(0.8 * rate_hz)) * 1e9 / rate_hz).astype(np.int64)
        values = np.zeros((len(t_ns), 6))
        values[:, 1] = shaken_mps2 * np.sin(2.0 * math.pi * shaft_hz * 1e-9 * t_ns)
        values[:, 2] = -9.81
        samples.append(StreamSamples(t_ns, values, rate_hz, np.zeros(6), False))
    columns = error_columns(layout)
    levers_m = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    noise = _RootNoise(0.001, np.full(3, 10.0))
    sends = np.ones((3, 6), dtype=np.bool_)
    epochs = build_epochs(
        *samples, 100_000_000, step_ns, count, sends, levers_m, noise, columns, len(layout.bias_parameters)
    )
    inside = slice(BEFORE, BEFORE + count)
    gain = epochs.lateral_gain[inside, 0]
    regressor = epochs.sensitivity[inside, Y_LEFT, layout.bias_parameters.index("left.ky")] / gain
    innovation = np.tan(epochs.rows[inside, Y_LEFT]) / gain
    assert np.abs(innovation).max() > 0.5 * amplitude_mps2
    assert np.abs(regressor - innovation).max() < amplitude_mps2 / 6.0
