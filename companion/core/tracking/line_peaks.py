"""Lines of motors and propellers in the spectrum of single channels: narrow peaks whose envelope is steady."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.kernels.arrays import row_medians
from companion.core.tracking.spread_work import Stages
from companion.native.library import ARRAY, INTEGER, REAL, kernel
from companion.records import Floats

NEAR_HZ = 3.0  # chosen: a line is the highest peak this near
LOWEST_HZ = 45.0  # chosen: a shaft is first found above, for a notch below bends the phase of the second bending mode
HIGHEST_RATIO = 0.45  # chosen: of the sample rate
MIN_RATIO = 60.0  # derived: peak over median; noise exceeds it once in 2^60 bins
_FLOOR_HZ = 25.0  # chosen: blocks that the median is taken over, wide beside a line
SHORT_S = 0.25  # chosen: of the envelope's transforms; a mode of 1 Hz width is half resolved
_BESIDE_HZ = 8.0  # derived: two lines this near are one in a short transform
_APART_HZ = 2.0  # chosen: least distance of two lines that are told apart, four bins; nearer peaks are one
_BESIDE_RATIO = 0.01  # chosen: of a line's power, least of one beside it; a Hann window's side lobes have 0.001
MAX_VARIATION = 0.2  # chosen: variance over squared mean of the squared envelope; 1 for noise, 0 for a line
# measured, of the same: below it are 5 in 10,000 windows of a mode at 54 Hz that is damped to 0.5 %, none of 2,000 of
# one that is damped to 1 %, of which 2 % are below 0.2
SURE_VARIATION = 0.05
NO_POWER = 1e-30  # numerical: an axis that is not sent has no lines


@dataclass(frozen=True, slots=True, eq=False)
class ChannelWindow:
    """Samples of one channel: instants (n,) against the end of the search, s; values (n,); and their rate."""

    t_s: Floats
    values: Floats
    rate_hz: float

    def swing(self) -> Floats:
        """Values (n,) about their mean."""
        return np.asarray(self.values - self.values.mean())


@dataclass(frozen=True, slots=True, eq=False)
class Peak:
    """Line of one channel: ratio to its surroundings, and least variation of the squared envelope in any channel.

    Two that beat have the variation of both together.
    """

    ratio: float
    frequency_hz: float
    channel: ChannelWindow
    variation: float


def find_lines(channels: list[ChannelWindow]) -> Stages[list[Peak]]:
    """The strongest lines, the highest over its surroundings first; the highest of those at one frequency."""
    peaks: list[Peak] = []
    for _, station in by_station(channels):
        for channel in station:
            peaks += _peaks(channel)
        yield
    highest: list[Peak] = []
    for peak in sorted(peaks, key=lambda peak: -peak.ratio):
        same = next((k for k, other in enumerate(highest) if _is_one_line(peak, other)), None)
        if same is None:
            highest.append(peak)
        else:
            steadiest = min(peak.variation, highest[same].variation)
            highest[same] = dataclasses.replace(highest[same], variation=steadiest)
    return highest


def by_station(channels: list[ChannelWindow]) -> Iterator[tuple[int, Iterator[ChannelWindow]]]:
    """Channels in groups that share their instants."""
    return itertools.groupby(channels, key=lambda channel: id(channel.t_s))


def _is_one_line(peak: Peak, other: Peak) -> bool:
    """Whether two peaks are one line: two of one channel are not."""
    return abs(peak.frequency_hz - other.frequency_hz) <= _APART_HZ


def _peaks(channel: ChannelWindow) -> list[Peak]:
    """Lines of one channel."""
    samples, rate_hz = channel.swing(), channel.rate_hz
    n, bin_hz = len(samples), rate_hz / len(samples)
    power = np.abs(np.fft.rfft(hann(n) * samples)) ** 2
    last, near, width = int(HIGHEST_RATIO * rate_hz / bin_hz), round(NEAR_HZ / bin_hz), round(_FLOOR_HZ / bin_hz)
    first = int(LOWEST_HZ / bin_hz) - width
    blocks = power[first : first + (last - first) // width * width].reshape(-1, width)
    floor = np.maximum(row_medians(blocks), NO_POWER)
    ratio = (blocks / floor[:, None]).ravel()
    peaks = []
    for k in (first + np.flatnonzero(ratio > MIN_RATIO)).tolist():
        if power[k] < power[k - near : k + near + 1].max():
            continue
        lines_hz = [_between_bins(power, k) * bin_hz]
        variation = _variation(channel, lines_hz[0], SHORT_S)
        if not variation < MAX_VARIATION:
            lines_hz = _two_lines(channel, power, k)
        peaks += [Peak(float(ratio[round(hz / bin_hz) - first]), hz, channel, variation) for hz in lines_hz]
    return peaks


def _two_lines(channel: ChannelWindow, power: Floats, highest: int) -> list[float]:
    """Frequencies of two lines that beat in short transforms, the highest at one bin; none if that is not what it is.

    A Hann window of two periods of their beat holds one of them and has the other at its first zero.
    """
    bin_hz = channel.rate_hz / len(channel.values)
    reach, least = round(_BESIDE_HZ / bin_hz), round(_APART_HZ / bin_hz)
    beside = [
        k
        for k in range(highest - reach, highest + reach + 1)
        if abs(k - highest) >= least and power[k] == power[k - least // 2 : k + least // 2 + 1].max()
    ]
    if not beside:
        return []
    other = max(beside, key=lambda k: float(power[k]))
    if power[other] < _BESIDE_RATIO * power[highest]:
        return []
    both_hz = [_between_bins(power, k) * bin_hz for k in (highest, other)]
    window_s = 2.0 / abs(both_hz[1] - both_hz[0])
    # few long windows tell, which noise looks steady in more often
    return both_hz if all(_variation(channel, hz, window_s) < SURE_VARIATION for hz in both_hz) else []


def _between_bins(power: Floats, k: int) -> float:
    """Place of a peak, in bins, by the parabola through the logarithms of its highest three."""
    left, middle, right = np.log(power[k - 1 : k + 2])
    return float(k + 0.5 * (left - right) / (left - 2.0 * middle + right))


def _variation(channel: ChannelWindow, frequency_hz: float, window_s: float) -> float:
    """Variance over squared mean of a line's squared envelope from one window to the next; infinite without power."""
    length = round(window_s * channel.rate_hz)
    mean, variance = squared_envelope(channel.swing(), channel.t_s, frequency_hz, length)
    return variance / mean**2 if mean > 0.0 else math.inf


_envelope = kernel("lines_envelope", ARRAY, ARRAY, REAL, ARRAY, INTEGER, ARRAY)


def squared_envelope(samples: Floats, t_s: Floats, frequency_hz: float, length: int) -> tuple[float, float]:
    """Mean and variance of the squared envelope of a line, by windows of ``length`` that overlap by half.

    Parameters
    ----------
    samples : (n,) float64
        Swing of a channel.
    t_s : (n,) float64
        Their instants.
    frequency_hz : float
        Of the line.
    length : int
        Number of samples of a window.
    """
    out = np.empty(2)
    _envelope(samples, t_s, frequency_hz, hann(length), length // 2, out)
    mean, variance = out.tolist()
    return mean, variance


@functools.lru_cache(maxsize=16)
def hann(n: int) -> Floats:
    """Hann window (n,), read-only."""
    window = np.hanning(n)
    window.flags.writeable = False
    return window
