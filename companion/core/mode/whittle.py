"""Debiased Whittle fit: modal and gust parameters from a few seconds of vertical acceleration.

The tapered periodogram ``I_j`` of a stretch has expectation ``E_j = (S * |W|^2)(f_j)`` and is nearly exponential; the
fit minimises ``sum ln E_j + I_j / E_j`` plus the prior's quadratic (Sykulski et al., Biometrika 106, 2019) by Fisher
scoring. A family that moves both tips alike is read from their mean, the other from half their difference; with one
tip, both are fitted to it at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.mode.spectrum import acceleration_density
from companion.records import Floats

_TAPER = 0.4  # share of the stretch that is tapered (Tukey)
_REACH = 5  # bins that the taper smears over
_FINE_HZ = 0.06  # a lightly damped peak is narrower than a short stretch's bins
_DELTA = 1e-4
_LARGEST_STEP = 0.5
_LEAST_EXPECTED = 1e-12


@dataclass(frozen=True, slots=True)
class Stretch:
    """The periodogram of a stretch, ready to be compared with a model.

    Attributes
    ----------
    power : (b,) float64
        Periodogram, (m/s^2)^2/Hz, one-sided.
    grid_hz : (g,) float64
        Finer frequencies on which the model is evaluated.
    kernel : (k,) float64
        The taper's spectral window on that grid.
    stride : int
        Grid points per bin.
    floor : (g,) float64
        Sensor noise density on the grid.
    weight : float
        Independent bins per bin.
    """

    step_s: float
    power: Floats
    grid_hz: Floats
    kernel: Floats
    stride: int
    floor: Floats
    weight: float

    def smear(self, density: Floats) -> Floats:
        """Expected periodogram of a signal of this density: (..., g) to (..., b)."""
        k, bins = len(self.kernel), len(self.power)
        windows = np.lib.stride_tricks.sliding_window_view(density, k, axis=-1)[..., :: self.stride, :]
        expected: Floats = windows[..., :bins, :] @ self.kernel
        return expected


def make_stretch(
    samples: Floats, step_s: float, band_hz: tuple[float, float], floor: Callable[[Floats], Floats]
) -> Stretch:
    """Taper and transform ``samples`` (n,); use the bins inside the band."""
    n = len(samples)
    taper = _tukey(n)
    power = taper @ taper
    stride = max(2, int(np.ceil(1.0 / (n * step_s * _FINE_HZ))))
    spectrum = np.fft.rfft(taper * (samples - samples.mean()))
    bin_hz = 1.0 / (n * step_s)
    first = max(int(np.ceil(band_hz[0] / bin_hz)), _REACH + 1)
    last = min(int(band_hz[1] / bin_hz), n // 2 - _REACH - 1)
    reach = _REACH * stride
    window: Floats = np.abs(np.fft.rfft(taper, n * stride)[: reach + 1]) ** 2
    kernel: Floats = np.concatenate([window[:0:-1], window])
    grid: Floats = bin_hz / stride * np.arange(first * stride - reach, last * stride + reach + 1)
    periodogram: Floats = 2.0 * step_s / power * np.abs(spectrum[first : last + 1]) ** 2
    weight = power**2 / (n * np.sum(taper**4))
    kernel /= kernel.sum()
    return Stretch(step_s, periodogram, grid, kernel, stride, floor(grid), float(weight))


def _tukey(n: int) -> Floats:
    edge = max(int(_TAPER * n / 2), 1)
    taper = np.ones(n)
    rise = 0.5 * (1.0 - np.cos(np.pi * (np.arange(edge) + 0.5) / edge))
    taper[:edge], taper[n - edge :] = rise, rise[::-1]
    return taper


@dataclass(frozen=True, slots=True)
class Prior:
    """Normal prior of the logarithms of one or two families' parameters.

    Attributes
    ----------
    mean, sigma : (p,) float64
    sizes : tuple of int
        How many parameters belong to each family.
    reference_hz : tuple of float
        Where each family's load is told.
    """

    mean: Floats
    sigma: Floats
    sizes: tuple[int, ...]
    reference_hz: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Fit:
    """Where the fit ended.

    Attributes
    ----------
    logs, log_sigma : (p,) float64
    cost : float
        Negative log posterior, up to a constant.
    """

    logs: Floats
    log_sigma: Floats
    cost: float


def expected_power(stretch: Stretch, prior: Prior, logs: Floats) -> Floats:
    """Expected periodogram at the parameters ``logs``."""
    return np.asarray(stretch.smear(_density(stretch, prior, logs)))


def _density(stretch: Stretch, prior: Prior, logs: Floats) -> Floats:
    density, at = stretch.floor, 0
    for size, reference in zip(prior.sizes, prior.reference_hz, strict=True):
        density = density + acceleration_density(logs[at : at + size], stretch.grid_hz, reference, stretch.step_s)
        at += size
    return density


def misfit(stretch: Stretch, prior: Prior, logs: Floats) -> float:
    """Negative log likelihood of the stretch."""
    expected = np.maximum(expected_power(stretch, prior, logs), _LEAST_EXPECTED)
    return float(stretch.weight * np.sum(np.log(expected) + stretch.power / expected))


def cost(stretch: Stretch, prior: Prior, logs: Floats) -> float:
    """Negative log posterior."""
    return misfit(stretch, prior, logs) + 0.5 * float(np.sum(((logs - prior.mean) / prior.sigma) ** 2))


def fit(stretch: Stretch, prior: Prior, start: Floats, rounds: int) -> Fit:
    """Improve ``start`` by at most ``rounds`` of damped Fisher scoring."""
    logs, best = start.copy(), cost(stretch, prior, start)
    information = np.diag(1.0 / prior.sigma**2)
    for _ in range(rounds):
        gradient, information = _slope(stretch, prior, logs)
        step: Floats = -np.linalg.solve(information, gradient)
        step *= min(1.0, _LARGEST_STEP / max(float(np.abs(step).max()), 1e-12))
        gain, moved = _descend(stretch, prior, logs, step, best)
        if moved is None:
            break
        logs, best = moved, best - gain
        if gain < 1e-3:
            break
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    return Fit(logs, spread, best)


def _descend(stretch: Stretch, prior: Prior, logs: Floats, step: Floats, best: float) -> tuple[float, Floats | None]:
    for _ in range(5):
        tried = logs + step
        value = cost(stretch, prior, tried)
        if value < best:
            return best - value, tried
        step = 0.4 * step
    return 0.0, None


def _slope(stretch: Stretch, prior: Prior, logs: Floats) -> tuple[Floats, Floats]:
    """Gradient and Fisher information of the cost."""
    base = _density(stretch, prior, logs)
    rows, at = np.empty((len(logs), len(base))), 0
    for size, reference in zip(prior.sizes, prior.reference_hz, strict=True):
        own = logs[at : at + size]
        centre = acceleration_density(own, stretch.grid_hz, reference, stretch.step_s)
        for k in range(size):
            moved = own.copy()
            moved[k] += _DELTA
            rows[at + k] = acceleration_density(moved, stretch.grid_hz, reference, stretch.step_s) - centre
        at += size
    expected = np.maximum(stretch.smear(base), _LEAST_EXPECTED)
    jacobian = stretch.smear(rows) / (_DELTA * expected)
    pull = (logs - prior.mean) / prior.sigma**2
    gradient = stretch.weight * (jacobian @ (1.0 - stretch.power / expected)) + pull
    information = stretch.weight * (jacobian @ jacobian.T) + np.diag(1.0 / prior.sigma**2)
    return gradient, information


def scan(stretch: Stretch, prior: Prior, start: Floats, which: int, offsets: Floats) -> tuple[Floats, Floats]:
    """Cost with one parameter at ``prior.mean + offsets`` and its family's load rescaled to fit: costs and starts."""
    load = which + 2
    starts = np.tile(start, (len(offsets), 1))
    starts[:, which] = prior.mean[which] + offsets
    costs = np.empty(len(offsets))
    for k, logs in enumerate(starts):
        for _ in range(2):
            expected = np.maximum(expected_power(stretch, prior, logs), _LEAST_EXPECTED)
            logs[load] += np.log(max(float(np.mean(stretch.power / expected)), 1e-9))
        costs[k] = cost(stretch, prior, logs)
    return costs, starts
