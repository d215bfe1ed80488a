"""Tapered periodogram of a segment of samples, in the bins that a model is compared with."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.core.tracking.adaptation.model_spectrum import SpectralGrid, make_grid
from companion.records import Floats, Ints

_TAPER_RATIO = 0.4  # chosen: of the segment is tapered (Tukey); keeps 79 % of the independent bins
_WINDOW_BINS = 5  # chosen: half width of the spectral window that is computed
_FINE_GRID_HZ = 0.06  # chosen: a lightly damped peak is narrower than a short segment's bins
_GROUP_WIDTH = 0.008  # chosen: relative width of a group of upper bins


class Periodogram(NamedTuple):
    """Periodogram of a segment, ready to be compared with a model.

    The lower bins stand for themselves, and the model is convolved with the taper's spectral window; the upper ones,
    where no peak is narrow, are averaged in groups.

    Attributes
    ----------
    power : (b,) float64
        Periodogram, (m/s^2)^2/Hz, one-sided.
    frequency_hz : (b,) float64
    weight : (b,) float64
        Independent bins in each.
    grid : SpectralGrid
        Frequencies (g,) on which the model is evaluated; the last ones are those of the groups.
    noise_density : (g,) float64
        Noise density on the grid.
    kernel : (k,) float64
        Spectral window on the fine grid, sum 1.
    stride : int
        Fine grid points per bin.
    low_bins, low_grid : int
        Number of bins that stand for themselves, and of grid points below the groups.
    """

    power: Floats
    frequency_hz: Floats
    weight: Floats
    grid: SpectralGrid
    noise_density: Floats
    kernel: Floats
    stride: int
    low_bins: int
    low_grid: int

    def with_noise(self, noise_density: Callable[[Floats], Floats]) -> Periodogram:
        """The same power (n,) beside another density of noise, which is given frequencies (m,), Hz."""
        return self._replace(noise_density=noise_density(np.sqrt(self.grid.exact.square)))

    def below(self, frequency_hz: float) -> Periodogram:
        """The same power (n,), whose bins above a frequency count for nothing."""
        return self._replace(weight=np.where(self.frequency_hz < frequency_hz, self.weight, 0.0))


def make_periodogram(
    samples: Floats, step_s: float, band_hz: tuple[float, float, float], noise_density: Callable[[Floats], Floats]
) -> Periodogram:
    """Periodogram of ``samples`` (n,) in the band (lowest, first grouped, highest frequency, Hz)."""
    return make_periodograms(samples[None], step_s, band_hz, noise_density)[0]


def make_periodograms(
    segments: Floats, step_s: float, band_hz: tuple[float, float, float], noise_density: Callable[[Floats], Floats]
) -> list[Periodogram]:
    """Periodograms of each row of ``segments`` (m, n): what depends on their length is computed once."""
    n = segments.shape[1]
    bins = _bins(n, step_s, band_hz)
    taper, energy, independent, kernel = _window(n, bins.stride)
    low_bins = bins.split - bins.first
    weight, noise_on_grid = independent * np.concatenate([np.ones(low_bins), bins.counts]), noise_density(bins.grid_hz)
    periodograms = []
    for samples in segments:
        spectrum = np.fft.rfft(taper * (samples - samples.mean()))
        raw: Floats = 2.0 * step_s / energy * (spectrum.real**2 + spectrum.imag**2)
        groups = np.add.reduceat(raw[: bins.edges[-1]], bins.edges[:-1]) / bins.counts
        periodograms.append(
            Periodogram(
                power=np.concatenate([raw[bins.first : bins.split], groups]),
                frequency_hz=bins.frequency_hz,
                weight=weight,
                grid=bins.grid,
                noise_density=noise_on_grid,
                kernel=kernel,
                stride=bins.stride,
                low_bins=low_bins,
                low_grid=len(bins.grid_hz) - len(bins.counts),
            )
        )
    return periodograms


class _Bins(NamedTuple):
    """Bins in use: single from ``first`` on, in groups from ``split`` on; see :class:`Periodogram`."""

    first: int
    split: int
    stride: int
    edges: Ints
    counts: Floats
    frequency_hz: Floats
    grid_hz: Floats
    grid: SpectralGrid


@functools.lru_cache(maxsize=8)
def _bins(n: int, step_s: float, band_hz: tuple[float, float, float]) -> _Bins:
    """Bins and model grid of a segment length, cached."""
    bin_hz = 1.0 / (n * step_s)
    stride = max(2, int(np.ceil(bin_hz / _FINE_GRID_HZ)))
    first = max(int(np.ceil(band_hz[0] / bin_hz)), _WINDOW_BINS + 1)
    split = max(int(band_hz[1] / bin_hz), first + 8)
    last = min(int(band_hz[2] / bin_hz), n // 2 - 1)
    edges = _group_edges(split, last)
    centres = 0.5 * (edges[1:] + edges[:-1] - 1) * bin_hz
    reach = _WINDOW_BINS * stride
    fine = bin_hz / stride * np.arange(first * stride - reach, (split - 1) * stride + reach + 1)
    grid_hz: Floats = np.concatenate([fine, centres])
    frequency_hz = np.concatenate([bin_hz * np.arange(first, split), centres])
    counts = np.diff(edges).astype(np.float64)
    return _Bins(first, split, stride, edges, counts, frequency_hz, grid_hz, make_grid(grid_hz, step_s))


@functools.lru_cache(maxsize=8)
def _window(n: int, stride: int) -> tuple[Floats, float, float, Floats]:
    """Taper, its energy, independent bins per bin, and its spectral window over bins split in ``stride``."""
    taper = _tukey(n)
    energy = float(taper @ taper)
    transform = np.fft.rfft(taper, n * stride)[: _WINDOW_BINS * stride + 1]
    half = transform.real**2 + transform.imag**2
    kernel: Floats = np.concatenate([half[:0:-1], half])
    return taper, energy, energy**2 / (n * float(np.sum(taper**4))), kernel / float(kernel.sum())


def _group_edges(first: int, last: int) -> Ints:
    """Bin numbers at which groups begin; each group is a small fraction of its frequency wide."""
    edges, at = [first], first
    while at < last:
        at += max(1, int(_GROUP_WIDTH * at))
        edges.append(at)
    return np.array(edges, dtype=np.int64)


def _tukey(n: int) -> Floats:
    """Tukey taper (n,)."""
    edge = max(int(_TAPER_RATIO * n / 2), 1)
    taper = np.ones(n)
    rise = 0.5 * (1.0 - np.cos(np.pi * (np.arange(edge) + 0.5) / edge))
    taper[:edge], taper[n - edge :] = rise, rise[::-1]
    return taper
