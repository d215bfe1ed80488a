"""Noise of the rows, learned from innovations: up to what it is, and nothing from lies and contradictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.core.tracking.row_noise import RowNoise, slopes_as_forces
from companion.core.tracking.states import P_LEFT, ROWS, Y_LEFT, Z_LEFT, SensorNoise
from companion.records import Floats
from companion.units import GRAVITY_MPS2

STEPS, SECONDS = 250, 12
BELIEVED = SensorNoise(
    sensor_variance=np.full(ROWS, 4.0),
    root_z_variance=1.0,
    root_y_variance=1.0,
    bias_prior_covariance=np.zeros((0, 0)),
    bias_projection=np.zeros((2, 2)),
    bias_time_s=100.0,
    sample_s=1e-3,
)
ROOT_Y = np.zeros(ROWS)
ROOT_Y[Y_LEFT:P_LEFT] = 1.0


def predicted(noise: RowNoise, by_state: float) -> Floats:
    """S of rows whose noise is what has been learned, in units of a force for the slopes."""
    return np.asarray(np.diag(noise.variance + by_state) + noise.root_y_variance * np.outer(ROOT_Y, ROOT_Y))


def learned(innovation: Floats, by_state: float = 1.0, noise: RowNoise | None = None) -> RowNoise:
    """Noise that is learned in some seconds of a filter whose S is the noise and ``by_state``."""
    noise = noise or RowNoise(BELIEVED)
    for block in np.split(innovation, SECONDS):
        S = predicted(noise, by_state)
        noise.learn(block, np.broadcast_to(np.tril(S), (len(block), ROWS, ROWS)))
    return noise


def white(sigma: float) -> Floats:
    return sigma * np.random.default_rng(3).standard_normal((SECONDS * STEPS, ROWS))


def shared(sigma: float) -> Floats:
    """Noise of the root's lateral axis in both slope rows."""
    return np.asarray(sigma * np.random.default_rng(4).standard_normal((SECONDS * STEPS, 1)) * ROOT_Y)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 4.0])
def test_a_rows_noise_is_found(ratio: float) -> None:
    noise = learned(white(np.sqrt(4.0 * ratio**2 + 1.0)) + shared(1.0))
    assert np.all(noise.ratio[:-1] == pytest.approx(ratio, rel=0.2)), "250 medians a second, two seconds of memory: 7 %"


def test_a_small_noise_is_found_beside_a_large_shared_one() -> None:
    """The root's noise, 60 times a slope row's own: it cancels in the difference of both rows."""
    ratio = learned(white(np.sqrt(4.0 * 2.0**2 + 1.0)) + shared(120.0)).ratio
    assert ratio[-1] == pytest.approx(100.0, rel=0.2), "sixty times two, and the hundred it is held at"
    assert np.all(ratio[:2] < 15.0)
    assert np.all(ratio[2:-1] == pytest.approx(2.0, rel=0.2))


def test_a_root_that_is_still_again_is_known_as_such_in_gusts() -> None:
    """The tips' vertical forces go up and down by the half, and with them what slopes are of a lateral force."""
    noise, rng = RowNoise(BELIEVED), np.random.default_rng(8)
    noise.root_y_variance = 50.0**2
    signs = np.array([-1.0, 1.0])
    for block in np.split(white(np.sqrt(5.0)) + shared(1.0), SECONDS):
        gain = signs / (GRAVITY_MPS2 * (1.0 + 0.5 * rng.uniform(-1.0, 1.0, (len(block), 2))))
        scale = np.ones((len(block), ROWS))
        scale[:, Y_LEFT:P_LEFT] = gain
        S = np.tril(predicted(noise, 1.0)) * scale[:, :, None] * scale[:, None, :]
        noise.learn(*slopes_as_forces(block * scale, S, gain))
    assert noise.ratio[-1] < 1.5


def test_noise_of_one_sensor_is_not_anothers() -> None:
    """Beside a noisy left slope the right one, correlated with it through the root, keeps its own noise."""
    innovation = white(np.sqrt(5.0)) + shared(1.0)
    innovation[:, Y_LEFT] += 40.0 * np.random.default_rng(5).standard_normal(len(innovation))
    noise = learned(innovation)
    assert noise.ratio[0] == pytest.approx(20.0, rel=0.2)
    assert np.all(noise.ratio[1:] < 1.3)
    assert noise.vibrating == (True, False)


@pytest.mark.parametrize(("lateral_mps2", "vertical_mps2"), [(0.3, 0.1), (0.02, 3.0), (0.08, 0.1)])
def test_a_tip_sways_by_what_its_lateral_or_its_vertical_axis_shows(lateral_mps2: float, vertical_mps2: float) -> None:
    """Misalignment takes up what is coherent with the vertical vibration: the lateral axis alone would not show it."""
    variance = 0.01**2
    noise = RowNoise(replace(BELIEVED, sensor_variance=np.full(ROWS, variance), root_y_variance=variance))
    innovation = white(1.0) * np.sqrt(2.0 * variance)
    innovation[:, Y_LEFT] *= lateral_mps2 / np.sqrt(2.0 * variance)
    noise.take_vertical(vertical_mps2**2 / variance, 1.0)
    learned(innovation, variance, noise)
    assert noise.strongly_vibrating == (lateral_mps2 > 0.1 or vertical_mps2 > 0.2, vertical_mps2 > 0.2)


def test_the_vertical_rows_are_the_gusts() -> None:
    assert np.all(learned(white(20.0)).variance[Z_LEFT:Y_LEFT] == 4.0)


def test_a_slow_contradiction_is_not_noise() -> None:
    t = np.arange(SECONDS * STEPS) * 0.004
    slow = 40.0 * np.sin(2.0 * np.pi * 1.0 * t)[:, None]
    assert np.all(learned(white(np.sqrt(5.0)) + slow).ratio[2:-1] < 1.3)


def test_blows_and_lies_are_not_noise() -> None:
    struck = white(np.sqrt(5.0)) + shared(1.0)
    struck[::60] += 1e3
    struck[500:520] += 50.0
    assert np.all(learned(struck).ratio < 1.3)


def test_it_forgets_within_seconds() -> None:
    quiet = white(np.sqrt(5.0)) + shared(1.0)
    quiet[: 3 * STEPS] *= 4.0
    assert np.all(learned(quiet).ratio < 1.3)


def test_noise_of_a_line_that_is_taken_out_is_gone_after_three_looks() -> None:
    quiet = white(np.sqrt(5.0)) + shared(1.0)
    quiet[: -3 * STEPS] *= 30.0
    assert np.all(learned(quiet).ratio[:-1] < 1.5)


def _shaken(ratios: list[float]) -> list[bool]:
    """Whether the left tip is taken for shaken after each look at noise of these ratios; none: the tip is not heard."""
    noise, shaken, absent = RowNoise(BELIEVED), [], [Y_LEFT, P_LEFT]
    for k, ratio in enumerate(ratios):
        covariance = np.tile(np.tril(predicted(noise, 1.0)), (STEPS, 1, 1))
        innovation = np.sqrt(4.0 * ratio**2 + 1.0) * np.random.default_rng(k).standard_normal((STEPS, ROWS))
        if not ratio:
            covariance[:, absent], covariance[:, :, absent], innovation[:, absent] = 0.0, 0.0, 0.0
        noise.learn(innovation, covariance)
        shaken.append(noise.vibrating[0])
    return shaken


@pytest.mark.parametrize("loud", [2.2, 5.0, 20.0])
def test_one_loud_look_is_no_vibration_and_one_quiet_look_no_end_of_it(loud: float) -> None:
    assert _shaken([1.0, loud, 1.0, 1.0]) == [False] * 4
    assert _shaken([1.0, loud, 0.0, 0.0]) == [False] * 4
    assert _shaken([loud, loud, 1.0, loud, 0.0, loud]) == [False, True, True, True, True, True]
    assert _shaken([loud, loud, 1.0, 1.0])[-1] is False


def test_a_sensor_between_still_and_shaken_stays_what_it_is_taken_for() -> None:
    assert _shaken([1.35] * 6) == [False] * 6
    assert _shaken([3.0, 3.0, *[1.35] * 6])[1:] == [True] * 7


def test_a_load_that_is_fitted_a_little_wrong_is_not_noise() -> None:
    """Where a hundredth of S is the sensor's, a tenth more of S would pass for ten times the noise."""
    assert np.all(learned(white(np.sqrt(1.1 * 404.0)), by_state=400.0).ratio == 1.0)


def test_vertical_axes_alone_teach_no_noise() -> None:
    noise = RowNoise(BELIEVED)
    covariance = np.zeros((STEPS, ROWS, ROWS))
    covariance[:, Z_LEFT, Z_LEFT] = covariance[:, Z_LEFT + 1, Z_LEFT + 1] = 1.0
    noise.learn(white(1.0)[:STEPS], covariance)
    assert np.all(noise.ratio == 1.0)


def test_noise_that_hides_is_found_where_it_is_large() -> None:
    """Behind a load of 400 a noise of 4 hides; where it is 1600, innovations are five times as large as believed."""
    ratio = learned(white(np.sqrt(1600.0 + 400.0)), by_state=400.0).ratio[:-1]
    assert np.all(ratio > 10.0), "twenty; a look that says less than double is not believed"
    assert np.all(ratio < 24.0)


def test_vibration_above_the_wing_is_not_counted_twice() -> None:
    """Noise of 40 to 125 Hz alternates, so that differences show up to 1.4 times its variance: it is what it is."""
    frequency = np.fft.rfftfreq(SECONDS * STEPS, 1.0 / STEPS)
    spectrum = np.fft.rfft(white(1.0), axis=0) * (frequency > 40.0)[:, None]
    blue = np.fft.irfft(spectrum, SECONDS * STEPS, axis=0)
    noise = learned(np.sqrt(4.0 * 9.0 + 1.0) * blue / blue.std(axis=0) + shared(1.0))
    assert np.all(noise.ratio[2:-1] == pytest.approx(3.0, rel=0.2))
