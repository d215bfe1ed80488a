"""Noise of the rows, learned from innovations: up to what it is, and nothing from lies and contradictions."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.tracking.row_noise import RowNoise
from companion.core.tracking.states import P_LEFT, ROWS, Y_LEFT, Z_LEFT
from companion.records import Floats

STEPS, SECONDS = 250, 12
BELIEVED = np.full(ROWS, 4.0)


def learned(innovation: Floats, by_state: float = 1.0) -> Floats:
    """Ratio to the believed noise after some seconds of a filter whose S is the row's noise and ``by_state``."""
    noise = RowNoise(BELIEVED)
    for part in np.split(innovation, SECONDS):
        predicted = np.broadcast_to(noise.variance + by_state, part.shape)
        noise.learn(part, predicted, np.abs(part) > 5.0 * np.sqrt(predicted))
    return noise.ratio


def white(sigma: float) -> Floats:
    return sigma * np.random.default_rng(3).standard_normal((SECONDS * STEPS, ROWS))


@pytest.mark.parametrize("ratio", [1.0, 2.0, 4.0])
def test_a_rate_rows_noise_is_found(ratio: float) -> None:
    found = learned(white(np.sqrt(4.0 * ratio**2 + 1.0)))[P_LEFT:]
    assert np.all(found == pytest.approx(ratio, rel=0.2)), "250 medians a second, two seconds of memory: 7 %"


def test_the_vertical_rows_are_the_gusts() -> None:
    assert np.all(learned(white(20.0))[Z_LEFT:Y_LEFT] == 1.0)


def test_a_slow_contradiction_is_not_noise() -> None:
    t = np.arange(SECONDS * STEPS) * 0.004
    slow = 40.0 * np.sin(2.0 * np.pi * 1.0 * t)[:, None]
    assert np.all(learned(white(np.sqrt(5.0)) + slow)[P_LEFT:] < 1.3)


def test_blows_and_lies_are_not_noise() -> None:
    struck = white(np.sqrt(5.0))
    struck[::60] += 1e3
    struck[500:520] += 50.0
    assert np.all(learned(struck)[P_LEFT:] < 1.3)


def test_it_forgets_within_seconds() -> None:
    quiet = white(np.sqrt(5.0))
    quiet[: 3 * STEPS] *= 4.0
    assert np.all(learned(quiet)[P_LEFT:] < 1.3)


def test_a_load_that_is_fitted_a_little_wrong_is_not_noise() -> None:
    """Where a hundredth of S is the sensor's, a tenth more of S would pass for ten times the noise."""
    assert np.all(learned(white(np.sqrt(1.1 * 404.0)), by_state=400.0)[P_LEFT:] == 1.0)
