"""Cell averages and moments, and the low-pass undone: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from sitl_tests.native.averaging import (
    edge_aliasing,
    epoch_averages,
    epoch_averages_deconvolved,
    gap_aliasing,
    interpolate_lost,
)

H = 0.004


def _averages_of_sine(frequency_hz: float, edges: np.ndarray) -> np.ndarray:
    w = 2 * np.pi * frequency_hz
    return -np.diff(np.cos(w * edges)) / (w * np.diff(edges))


def test_aligned_samples_are_averaged_exactly_whatever_they_are() -> None:
    t = np.arange(200) * 1e-3 + 0.5e-3
    y = np.random.default_rng(1).normal(size=(200, 6))
    edges = 0.008 + H * np.arange(40)
    mean, moment = epoch_averages(t, y, edges)
    first = 8
    grouped = y[first : first + 156].reshape(39, 4, 6)
    np.testing.assert_allclose(mean, grouped.mean(axis=1), atol=1e-12)
    # an integrating sensor knows its integral only at the edges of the samples: the moment is that of a smooth path
    coarse = grouped[:, :, 2] @ (np.arange(4) - 1.5) / 16
    assert np.corrcoef(moment, coarse)[0, 1] > 0.98


def test_lost_samples_are_bridged_by_what_is_beside_them() -> None:
    """Exact for a parabola; of a second mode at 30 Hz a twentieth is left of what losing costs; outages stay."""
    t = np.arange(200) * 1e-3 + 0.5e-3
    received = np.ones(200, dtype=bool)
    received[[40, 71, 72, 110]] = False
    parabola = np.repeat((3.0 - 20.0 * t + 500.0 * t**2)[:, None], 6, axis=1)
    filled_t, filled_y = interpolate_lost(t[received], parabola[received], 1e-3, 0.012)
    np.testing.assert_allclose(filled_t, t, atol=1e-12)
    np.testing.assert_allclose(filled_y, parabola, atol=1e-12)

    y, edges = np.repeat(np.sin(2 * np.pi * 30.0 * t)[:, None], 6, axis=1), 0.0085 + H * np.arange(40)
    true, _ = epoch_averages(t, y, edges)
    torn, _ = epoch_averages(t[received], y[received], edges)
    mended, _ = epoch_averages(*interpolate_lost(t[received], y[received], 1e-3, 0.012), edges)
    assert np.abs(mended - true).max() < 0.05 * np.abs(torn - true).max()

    received[120:140] = False
    out_t, out_y = interpolate_lost(t[received], y[received], 1e-3, 0.012)
    assert len(out_t) == len(out_y) == 180
    assert not ((out_t > t[119] + 1e-4) & (out_t < t[140] - 1e-4)).any()


@pytest.mark.parametrize("shift", [0.0, 0.13e-3, 0.5e-3, 0.77e-3])
@pytest.mark.parametrize("frequency", [2.0, 5.0, 20.0])
def test_mean_and_moment_of_a_sine_for_any_phase_of_the_grid(shift: float, frequency: float) -> None:
    knots = np.arange(301) * 1e-3
    y = np.repeat(_averages_of_sine(frequency, knots)[:, None], 6, axis=1)
    edges = 0.02 + shift + H * np.arange(60)
    mean, moment = epoch_averages(0.5 * (knots[1:] + knots[:-1]), y, edges)
    w, middle = 2 * np.pi * frequency, 0.5 * (edges[1:] + edges[:-1])
    a = w * H / 2
    bound = 0.01 * (w * 1e-3) ** 2  # second order in the sample time, and only at the cell's two ends
    np.testing.assert_allclose(mean[:, 0], np.sin(w * middle) * np.sin(a) / a, atol=bound)
    true_moment = np.cos(w * middle) * 2 * (np.sin(a) - a * np.cos(a)) / (w * H) ** 2
    np.testing.assert_allclose(moment, true_moment, atol=bound)


@pytest.mark.parametrize("frequency", [0.5, 5.0, 12.0])
def test_a_butterworth_low_pass_is_undone_in_gain_and_phase(frequency: float) -> None:
    cutoff = 20.0
    t = np.arange(400) / 333.0
    w = 2 * np.pi * frequency
    s = 1j * frequency / cutoff
    response = 1 / (1 + np.sqrt(2) * s + s * s)
    y = np.repeat(np.imag(response * np.exp(1j * w * t))[:, None], 6, axis=1)
    edges = 0.1 + H * np.arange(200)
    mean = epoch_averages_deconvolved(t, y, edges, np.array([cutoff] * 3 + [0.0] * 3))
    true = _averages_of_sine(frequency, edges)
    assert np.abs(mean[:, 0] - true).max() < 0.015
    fit = np.linalg.lstsq(np.stack([np.cos(w * edges[:-1]), np.sin(w * edges[:-1])], axis=1), mean[:, 3], rcond=None)[0]
    assert np.hypot(*fit) == pytest.approx(np.abs(response) * np.sinc(frequency * H), rel=2e-3)  # left as it is


def test_the_inverse_follows_uneven_stamps() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.0015, 0.0045, 500))
    w, s = 2 * np.pi * 4.0, 1j * 4.0 / 20.0
    y = np.repeat(np.imag(np.exp(1j * w * t) / (1 + np.sqrt(2) * s + s * s))[:, None], 6, axis=1)
    edges = 0.1 + H * np.arange(200)
    mean = epoch_averages_deconvolved(t, y, edges, np.full(6, 20.0))
    error = mean[:, 0] - _averages_of_sine(4.0, edges)
    assert np.sqrt(np.mean(error**2)) < 0.01


@pytest.mark.parametrize("off", [0.0, 0.31])
def test_what_cut_and_lost_samples_cost_a_cell_of_white_load(off: float) -> None:
    """A share is the variance ``density T / (3 h^2)``: of the mean of a path that is known at samples' edges only."""
    fine, period, seconds = 20, 1e-3, 600
    rng = np.random.default_rng(5)
    path = rng.normal(scale=np.sqrt(fine / period), size=(seconds, 40 * fine))  # density one, two-sided
    y = path.reshape(seconds, 40, fine).mean(axis=2)
    t = (np.arange(40) + 0.5) * period
    edges = (16 + off + np.arange(3) * 4) * period
    begin = round((16 + off) * fine)
    truth = path[:, begin : begin + 8 * fine].reshape(seconds, 2, -1).mean(axis=2)
    received = np.arange(40) != 18
    full_t, full_y = interpolate_lost(t[received], y.T[received], period, 0.012)
    error = np.array(
        [epoch_averages(full_t, np.repeat(column[:, None], 6, axis=1), edges)[0][:, 0] for column in full_y.T]
    )
    predicted = (edge_aliasing(full_t, edges) + gap_aliasing(t[received], edges, period)) * period / (3 * H**2)
    assert predicted[0] > 3 * predicted[1]
    np.testing.assert_allclose(np.mean((error - truth) ** 2, axis=0), predicted, rtol=0.25, atol=1e-9)
