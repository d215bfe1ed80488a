"""Search for lines of motors and propellers in the samples of the fast stations.

A line stands high above the median of the periodogram around it, and its envelope is steady: the squared magnitude of
short transforms varies little. A lightly damped bending mode stands as high, but is noise in a narrow band, whose
squared envelope varies as much as its mean (Rayleigh): it is left to the wing's model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Floats, Ints

WINDOW_S = 2.0  # chosen: half a hertz a bin; rpm wanders little in it
_HELD_S = 3.0  # chosen: the window, and what was sent since its end
NEAR_HZ = 3.0  # chosen: nearer peaks are one
_SAME_RATIO = 0.1  # chosen: rpm changes by that much while a peak is smeared
_ONE_HZ = 1.5  # chosen: two loops nearer than this follow one line
_MIN_RATE_HZ = 400.0  # chosen: slower streams fold what they should tell apart
_LOWEST_HZ = 45.0  # chosen: below, a notch would bend the phase of the second bending mode
_HIGHEST_RATIO = 0.45  # chosen: of the sample rate
_MIN_RATIO = 60.0  # derived: peak over median; noise exceeds it once in 2^60 bins
_FLOOR_HZ = 25.0  # chosen: blocks that the median is taken over, wide beside a line
_SHORT_S = 0.25  # chosen: of the envelope's transforms; a mode of 1 Hz width is half resolved
_MAX_VARIATION = 0.2  # chosen: variance over squared mean of the squared envelope; 1 for noise, 0 for a line
_MOST = 4  # chosen: shaft, blade pass, and one harmonic of either
_MEMORY = 5  # chosen, searches: so long a line is followed that is no longer found
_NO_POWER = 1e-30  # numerical: an axis that is not sent has no lines
_CHANNELS = (1, 2, 3)  # lateral and vertical force, roll rate: what the tracker reads


class SampleRing:
    """Newest samples of one station as sent, lines included."""

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self._newest_ns = -(2**62)
        self._runs: list[tuple[Ints, Floats]] = []

    def add(self, t_ns: Ints, values: Floats) -> None:
        """Take the samples that are newer than what is held."""
        first = int(np.searchsorted(t_ns, self._newest_ns, side="right"))
        if first < len(t_ns):
            self._newest_ns = int(t_ns[-1])
            self._runs.append((t_ns[first:].copy(), values[first:].copy()))

    def held(self) -> tuple[Ints, Floats]:
        """Stamps (s,) and values (s, 6) of the last seconds."""
        if not self._runs:
            return np.empty(0, np.int64), np.empty((0, 6))
        t_ns = np.concatenate([run[0] for run in self._runs])
        values = np.concatenate([run[1] for run in self._runs])
        first = int(np.searchsorted(t_ns, self._newest_ns - round(_HELD_S * 1e9)))
        self._runs = [(t_ns[first:], values[first:])]
        return self._runs[0]

    def window(self, until_ns: int) -> Floats | None:
        """Last samples (n, 6) before an instant; None without a full window or from too slow a stream."""
        t_ns, values = self.held()
        count, last = int(0.95 * WINDOW_S * self.rate_hz), int(np.searchsorted(t_ns, until_ns))
        if self.rate_hz < _MIN_RATE_HZ or last < count:
            return None
        lasts_s = (t_ns[last - 1] - t_ns[last - count]) * 1e-9
        return values[last - count : last] if lasts_s < WINDOW_S else None


def find_lines(rings: list[SampleRing], until_ns: int) -> list[float]:
    """Frequencies of the strongest lines before an instant, Hz: the highest over its surroundings first."""
    peaks: list[tuple[float, float]] = []
    for ring in rings:
        samples = ring.window(until_ns)
        if samples is not None:
            for channel in _CHANNELS:
                peaks += _peaks(samples[:, channel], ring.rate_hz)
    frequencies: list[float] = []
    for _, frequency_hz in sorted(peaks, reverse=True):
        if len(frequencies) < _MOST and not _near(frequency_hz, frequencies):
            frequencies.append(frequency_hz)
    return frequencies


@dataclass
class _KnownLine:
    """Line that is followed; ``searches`` count down to its end while it is not found."""

    number: int
    frequency_hz: float
    searches: int = _MEMORY
    misses: int = 0


class KnownLines:
    """Lines that are followed: those found lately, and those found within the last few searches.

    Between two searches the follower knows better than the spectrum where a line is: it smears when rpm changes. So a
    peak within a tenth of a followed line is that line, and moves it only where it is found elsewhere twice in a row.
    """

    def __init__(self) -> None:
        self._lines: list[_KnownLine] = []
        self._next = 0

    @property
    def frequency_hz(self) -> dict[int, float]:
        """Frequency of each line by its number, Hz; a line that was lost and found again has a new number."""
        return {line.number: line.frequency_hz for line in self._lines}

    def search(self, rings: list[SampleRing], until_ns: int, followed_hz: dict[int, float]) -> bool:
        """Search the samples before an instant, with the lines now where they are followed; whether any is new."""
        for line in self._lines:
            line.frequency_hz = followed_hz.get(line.number, line.frequency_hz)
        unmatched, new = list(self._lines), False
        for frequency_hz in find_lines(rings, until_ns):
            same = [line for line in unmatched if abs(line.frequency_hz / frequency_hz - 1.0) < _SAME_RATIO]
            if same:
                line = min(same, key=lambda line: abs(line.frequency_hz - frequency_hz))
                unmatched.remove(line)
                self._found_again(line, frequency_hz)
            elif not _near(frequency_hz, [line.frequency_hz for line in self._lines]):
                self._begin(frequency_hz)
                new = True
        for line in unmatched:
            line.searches -= 1
        self._drop()
        return new

    def _begin(self, frequency_hz: float) -> None:
        self._lines.append(_KnownLine(self._next, frequency_hz))
        self._next += 1

    def _found_again(self, line: _KnownLine, frequency_hz: float) -> None:
        line.searches = _MEMORY
        line.misses = line.misses + 1 if abs(line.frequency_hz - frequency_hz) > NEAR_HZ else 0
        if line.misses > 1:
            self._lines.remove(line)
            self._begin(frequency_hz)

    def _drop(self) -> None:
        """Drop lines that are gone, and the younger of two that follow the same one."""
        distinct: list[_KnownLine] = []
        for line in self._lines:
            if line.searches > 0 and not any(
                abs(line.frequency_hz - other.frequency_hz) < _ONE_HZ for other in distinct
            ):
                distinct.append(line)
        self._lines = distinct[:_MOST]


def _near(frequency_hz: float, others: list[float]) -> bool:
    """Whether one of the others is the same line."""
    return any(abs(frequency_hz - other) <= NEAR_HZ for other in others)


def _peaks(samples: Floats, rate_hz: float) -> list[tuple[float, float]]:
    """Ratio to the surroundings and frequency (Hz) of each line of one channel."""
    n, bin_hz = len(samples), rate_hz / len(samples)
    power = np.abs(np.fft.rfft(np.hanning(n) * (samples - samples.mean()))) ** 2
    first, last, near = int(_LOWEST_HZ / bin_hz), int(_HIGHEST_RATIO * rate_hz / bin_hz), round(NEAR_HZ / bin_hz)
    width = round(_FLOOR_HZ / bin_hz)
    blocks = power[first : first + (last - first) // width * width].reshape(-1, width)
    floor = np.maximum(np.median(blocks, axis=1, keepdims=True), _NO_POWER)
    ratio = (blocks / floor).ravel()
    peaks = []
    for k in (first + np.flatnonzero(ratio > _MIN_RATIO)).tolist():
        if power[k] < power[k - near : k + near + 1].max():
            continue
        left, middle, right = np.log(power[k - 1 : k + 2])
        frequency_hz = (k + 0.5 * (left - right) / (left - 2.0 * middle + right)) * bin_hz
        if _is_steady(samples, rate_hz, frequency_hz):
            peaks.append((float(ratio[k - first]), float(frequency_hz)))
    return peaks


def _is_steady(samples: Floats, rate_hz: float, frequency_hz: float) -> bool:
    """Whether the envelope at a frequency varies little."""
    length = round(_SHORT_S * rate_hz)
    short = np.lib.stride_tricks.sliding_window_view(samples, length)[:: length // 2]
    phasor = np.hanning(length) * np.exp(-2j * np.pi * frequency_hz / rate_hz * np.arange(length))
    square = np.abs((short - short.mean(axis=1, keepdims=True)) @ phasor) ** 2
    return bool(square.var() < _MAX_VARIATION * square.mean() ** 2)
