"""The spectrum that a model must have, and the parameters that a spectrum tells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import block_diag

from companion.core.tracking.adaptation.frequency_drift import estimate_drift_rate, time_warped
from companion.core.tracking.adaptation.model_spectrum import make_grid
from companion.core.tracking.adaptation.periodogram import Periodogram, make_periodogram, make_periodograms
from companion.core.tracking.adaptation.whittle import LogNormalPrior, expected_power, find_unmodelled_peak, fit
from companion.core.tracking.discretise import stationary_covariance, van_loan
from companion.core.tracking.parameters import parameter_index
from sitl_tests.native.spectra import acceleration_density, acceleration_gradient

STEP_S = 0.004
COHERENCE = -0.4
LOGS = np.append(np.log([5.0, 0.04, 0.2, 2.0, 20.0, 27.0, 0.02, 3e-3]), np.arctanh(COHERENCE))
MANY = np.concatenate([LOGS, np.log([14.0, 0.03, 0.02]), [np.arctanh(0.6)], np.log([60.0, 0.01, 1e-3]), [-0.3]])


def _system(log_params: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Modes, each with its gust's two poles; what a load shares with the first it shares with others. Written anew."""
    c1, c2 = np.exp(log_params[3:5])
    places = [0, *range(5, len(log_params), 4)]
    shared = np.array([1.0, *(np.tanh(log_params[at + 3]) for at in places[1:])])
    blocks, gains = [], []
    for at in places:
        f, zeta, load = np.exp(log_params[at : at + 3])
        w, k1, k2, stated = 2 * np.pi * f, 2 * np.pi * c1, 2 * np.pi * c2, f if at else 5.0
        blocks.append([[0, 1, 0, 0], [-w * w, -2 * zeta * w, 0, 1], [0, 0, -k1, 0], [0, 0, k2, -k2]])
        gains.append(k1 * np.sqrt(load * (1 + (stated / c1) ** 2) * (1 + (stated / c2) ** 2) / 2))
    common, independent = np.kron(shared * gains, [0, 0, 1, 0]), np.kron(gains * np.sqrt(1 - shared**2), [0, 0, 1, 0])
    return block_diag(*blocks), np.outer(common, common) + np.diag(independent**2)


def _simulate(seconds: float, seed: int, log_params: np.ndarray = LOGS) -> np.ndarray:
    transition, noise = van_loan(*_system(log_params), STEP_S)
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(noise)
    root = vectors * np.sqrt(np.clip(values, 0, None))
    values, vectors = np.linalg.eigh(stationary_covariance(transition, noise))
    x = (vectors * np.sqrt(np.clip(values, 0, None))) @ rng.normal(size=8)
    out = np.empty(round(seconds / STEP_S))
    for k in range(len(out)):
        after = transition @ x + root @ rng.normal(size=8)
        out[k] = -(after[1] + after[5] - x[1] - x[5]) / STEP_S
        x = after
    return out + rng.normal(0, 0.008, len(out))


def _noise_density(frequency_hz: np.ndarray) -> np.ndarray:
    return np.full_like(frequency_hz, 0.008**2 * 2 * STEP_S)


def _periodogram(seconds: float, seed: int, log_params: np.ndarray = LOGS) -> Periodogram:
    return make_periodogram(_simulate(seconds, seed, log_params), STEP_S, (0.25, 11.0, 120.0), _noise_density)


def _prior(sigma: float = 2.0) -> LogNormalPrior:
    spread = np.array([0.1, 0.7, 2.5, sigma, sigma, 0.1, 0.7, 3.0, 1.0])
    mean = LOGS + np.array([0.07, 0.5, 1.0, 1.0, 1.0, -0.08, 0.5, -1.0, 0.4])
    return LogNormalPrior(mean, spread, mean - 4 * spread, mean + 4 * spread, np.array([5.0]), parameter_index([2]))


def test_a_piece_among_others_tells_what_it_tells_alone() -> None:
    segments = np.stack([_simulate(4.0, seed) for seed in range(3)])
    together = make_periodograms(segments, STEP_S, (0.25, 11.0, 120.0), _noise_density)
    assert len(together) == len(segments)
    for segment, result in zip(segments, together, strict=True):
        alone = make_periodogram(segment.copy(), STEP_S, (0.25, 11.0, 120.0), _noise_density)
        for name in ("power", "frequency_hz", "weight", "noise_density", "kernel"):
            np.testing.assert_array_equal(getattr(result, name), getattr(alone, name), err_msg=name)


@pytest.mark.parametrize("modes", [1, 2, 3, 4])
def test_the_density_integrates_to_the_variance_of_the_averaged_acceleration(modes: int) -> None:
    log_params = MANY[: 5 + 4 * (modes - 1)]
    transition, noise = van_loan(*_system(log_params), STEP_S)
    p = stationary_covariance(transition, noise)
    row = np.tile([0.0, 1.0, 0.0, 0.0], modes)
    variance = 2 * row @ (p - transition @ p) @ row / STEP_S**2
    f = (np.arange(50000) + 0.5) * 125.0 / 50000
    density = acceleration_density(log_params, make_grid(f, STEP_S), 5.0)
    assert density.sum() * 125.0 / 50000 == pytest.approx(variance, rel=2e-3)


@pytest.mark.parametrize("modes", [1, 2, 3, 4])
@given(st.data())
def test_the_slopes_of_the_density_are_its_differences(modes: int, data: st.DataObject) -> None:
    """Differences of fourth order: at a damping of 0.5 % those of second order err by more than 1e-5 of themselves."""
    size = 5 + 4 * (modes - 1)
    off = data.draw(st.lists(st.floats(-0.7, 0.7), min_size=size, max_size=size))
    log_params, grid, small = MANY[:size] + np.array(off), make_grid(np.linspace(0.5, 115.0, 300), STEP_S), 1e-5
    density, *gradients = acceleration_gradient(log_params, grid, 5.0)
    np.testing.assert_allclose(density, acceleration_density(log_params, grid, 5.0), rtol=1e-9)
    for k, gradient in enumerate(gradients):
        near, far = (
            acceleration_density(log_params + step * np.eye(size)[k], grid, 5.0)
            - acceleration_density(log_params - step * np.eye(size)[k], grid, 5.0)
            for step in (small, 2 * small)
        )
        np.testing.assert_allclose(gradient, (8 * near - far) / (12 * small), rtol=1e-5, atol=1e-6 * density.max())


@pytest.mark.slow
def test_the_periodogram_is_expected_without_bias() -> None:
    periodograms = [_periodogram(8.0, seed) for seed in range(40)]
    ratio = np.mean([s.power / expected_power(s, _prior(), LOGS) for s in periodograms], axis=0)
    weight, f = periodograms[0].weight, periodograms[0].frequency_hz
    for low, high in ((0.8, 3.0), (3.0, 4.5), (4.5, 5.5), (5.5, 8.0), (8.0, 20.0), (20.0, 35.0), (35.0, 110.0)):
        band = (f > low) & (f < high)
        mean = np.average(ratio[band], weights=weight[band])
        assert mean == pytest.approx(1.0, abs=4.5 / np.sqrt(40 * weight[band].sum()))


def test_a_fit_finds_the_parameters_within_its_sigma() -> None:
    pulls = []
    for seed in range(6):
        prior = _prior()
        result = fit(_periodogram(20.0, 100 + seed), prior, prior.mean, 25)
        identifiable = [0, 1, 2, 5, 8]
        pulls.append((result.log_params - LOGS)[identifiable] / result.log_sigma[identifiable])
        assert abs(result.log_params[0] - LOGS[0]) < 3 * np.sqrt(0.04 / (2 * np.pi * 5 * 20))
    assert np.sqrt(np.mean(np.square(pulls))) < 1.8


def test_a_peak_that_the_model_has_not_is_found() -> None:
    prior, periodogram = _prior(), _periodogram(10.0, 3)
    without = LOGS.copy()
    without[7] -= 12.0
    without[5] -= 0.2
    moved, gain = find_unmodelled_peak(periodogram, prior, without, 5)
    assert gain > 20
    assert moved[5] == pytest.approx(LOGS[5], abs=0.05)
    _, no_gain = find_unmodelled_peak(periodogram, prior, LOGS, 5)
    assert no_gain < 8


@pytest.mark.parametrize("rate_per_s", [0.01, -0.01, 0.0])
def test_the_rate_of_a_drift_is_found_and_none_where_there_is_none(rate_per_s: float) -> None:
    """Steady samples on a time that runs ever faster (which all but the load notices), from a believed rate of none."""
    for seed in range(3):
        samples = time_warped(_simulate(24.0, seed), -rate_per_s, STEP_S)
        segments = make_periodograms(samples.reshape(6, -1), STEP_S, (0.25, 11.0, 120.0), _noise_density)
        rate = 0.0
        for _ in range(6):
            rate, sigma = estimate_drift_rate(segments, 4.0, _prior(), LOGS, rate)
        assert rate == pytest.approx(rate_per_s, abs=max(4.0 * sigma, 1e-3))
        assert 1e-5 < sigma < 4e-3
