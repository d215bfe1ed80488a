"""The tapered periodogram of a stretch of samples, in the bins that a model is compared with."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import COMPILED, compiled, compiled_loops
from companion.core.tracking.adaptation.model_spectrum import Grid, make_grid
from companion.records import Floats, Ints

_TAPER = 0.4  # share of the stretch that is tapered (Tukey)
_REACH = 5  # bins that the taper smears over
_FINE_HZ = 0.06  # a lightly damped peak is narrower than a short stretch's bins
_GROUP = 0.008


class Stretch(NamedTuple):
    """The periodogram of a stretch, ready to be compared with a model.

    The lower bins stand for themselves, and the model is smeared as the taper smears it; the upper ones, where no
    peak is narrow, are averaged in groups.

    Attributes
    ----------
    power : (b,) float64
        Periodogram, (m/s^2)^2/Hz, one-sided.
    frequency_hz : (b,) float64
    weight : (b,) float64
        Independent bins in each.
    grid : Grid
        Frequencies (g,) on which the model is evaluated; the last ones are those of the groups.
    floor : (g,) float64
        Sensor noise density on the grid.
    """

    power: Floats
    frequency_hz: Floats
    weight: Floats
    grid: Grid
    floor: Floats
    kernel: Floats
    stride: int
    low_bins: int
    low_grid: int


@compiled_loops
def _smeared_by_loops(stretch: Stretch, density: Floats) -> Floats:
    low, kernel = stretch.low_bins, stretch.kernel
    expected = np.empty(len(stretch.power))
    expected[low:] = density[stretch.low_grid :]
    for k in range(low):
        first, total = k * stretch.stride, 0.0
        for j in range(len(kernel)):
            total += kernel[j] * density[first + j]
        expected[k] = total
    return expected


def _smeared_by_numpy(stretch: Stretch, density: Floats) -> Floats:
    fine = np.lib.stride_tricks.sliding_window_view(density[: stretch.low_grid], len(stretch.kernel))
    return np.concatenate([fine[:: stretch.stride] @ stretch.kernel, density[stretch.low_grid :]])


smeared = _smeared_by_loops if COMPILED else _smeared_by_numpy
"""Expected periodogram (b,) of a signal of this density (g,)."""


def make_stretch(
    samples: Floats, step_s: float, band_hz: tuple[float, float, float], floor: Callable[[Floats], Floats]
) -> Stretch:
    """Taper and transform ``samples`` (n,); use the bins inside the band (lowest, first grouped, highest)."""
    return make_stretches(samples[None], step_s, band_hz, floor)[0]


def make_stretches(
    pieces: Floats, step_s: float, band_hz: tuple[float, float, float], floor: Callable[[Floats], Floats]
) -> list[Stretch]:
    """As :func:`make_stretch` of each row of ``pieces`` (m, n): what their length tells is worked out once."""
    n = pieces.shape[1]
    bins = _bins(n, step_s, band_hz)
    taper, energy, independent, kernel = _window(n, bins.stride)
    low_bins = bins.split - bins.first
    weight, beneath = independent * np.concatenate([np.ones(low_bins), bins.counts]), floor(bins.grid_hz)
    found = []
    for samples in pieces:
        spectrum = np.fft.rfft(taper * (samples - samples.mean()))
        periodogram: Floats = 2.0 * step_s / energy * (spectrum.real**2 + spectrum.imag**2)
        groups = np.add.reduceat(periodogram[: bins.edges[-1]], bins.edges[:-1]) / bins.counts
        found.append(
            Stretch(
                power=np.concatenate([periodogram[bins.first : bins.split], groups]),
                frequency_hz=bins.frequency_hz,
                weight=weight,
                grid=bins.grid,
                floor=beneath,
                kernel=kernel,
                stride=bins.stride,
                low_bins=low_bins,
                low_grid=len(bins.grid_hz) - len(bins.counts),
            )
        )
    return found


class _Bins(NamedTuple):
    """Which bins are used, from ``first`` on by themselves, from ``split`` on in groups; see :class:`Stretch`."""

    first: int
    split: int
    stride: int
    edges: Ints
    counts: Floats
    frequency_hz: Floats
    grid_hz: Floats
    grid: Grid


@functools.lru_cache(maxsize=8)
def _bins(n: int, step_s: float, band_hz: tuple[float, float, float]) -> _Bins:
    bin_hz = 1.0 / (n * step_s)
    stride = max(2, int(np.ceil(bin_hz / _FINE_HZ)))
    first = max(int(np.ceil(band_hz[0] / bin_hz)), _REACH + 1)
    split = max(int(band_hz[1] / bin_hz), first + 8)
    last = min(int(band_hz[2] / bin_hz), n // 2 - 1)
    edges = _group_edges(split, last)
    centres = 0.5 * (edges[1:] + edges[:-1] - 1) * bin_hz
    reach = _REACH * stride
    fine = bin_hz / stride * np.arange(first * stride - reach, (split - 1) * stride + reach + 1)
    grid_hz: Floats = np.concatenate([fine, centres])
    frequency_hz = np.concatenate([bin_hz * np.arange(first, split), centres])
    counts = np.diff(edges).astype(np.float64)
    return _Bins(first, split, stride, edges, counts, frequency_hz, grid_hz, make_grid(grid_hz, step_s))


@functools.lru_cache(maxsize=8)
def _window(n: int, stride: int) -> tuple[Floats, float, float, Floats]:
    """Taper, its energy, independent bins per bin, and how it smears a line over bins split in ``stride``."""
    taper = _tukey(n)
    energy = float(taper @ taper)
    transform = np.fft.rfft(taper, n * stride)[: _REACH * stride + 1]
    half = transform.real**2 + transform.imag**2
    kernel: Floats = np.concatenate([half[:0:-1], half])
    return taper, energy, energy**2 / (n * float(np.sum(taper**4))), kernel / float(kernel.sum())


@compiled
def _group_edges(first: int, last: int) -> Ints:
    """Bin numbers at which groups begin; each group is a small share of its frequency wide."""
    edges = [first]
    while edges[-1] < last:
        edges.append(edges[-1] + max(1, int(_GROUP * edges[-1])))
    return np.array(edges, dtype=np.int64)


def _tukey(n: int) -> Floats:
    edge = max(int(_TAPER * n / 2), 1)
    taper = np.ones(n)
    rise = 0.5 * (1.0 - np.cos(np.pi * (np.arange(edge) + 0.5) / edge))
    taper[:edge], taper[n - edge :] = rise, rise[::-1]
    return taper
