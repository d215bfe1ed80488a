"""Search for lines of motors and propellers in the samples of the fast stations.

A line stands high above the median of the periodogram around it, and its envelope is steady: the squared magnitude of
short transforms varies little. A lightly damped bending mode stands as high, but is noise in a narrow band, whose
squared envelope varies as much as its mean (Rayleigh): it is left to the wing's model. In one window of some hundred it
varies little by chance: so a new leader is steady in any channel, or fairly steady in two searches in a row.

Lines of one shaft turn together. The strongest is the leader; in samples that are turned back by a rational multiple of
its phase, another line of the shaft stands at zero frequency, however rpm wanders: so weak ones show, and such below
45 Hz, where a steady line could be a mode.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from companion.core.kernels.arrays import row_medians
from companion.core.tracking.line_peaks import (
    HIGHEST_RATIO,
    LOWEST_HZ,
    MAX_VARIATION,
    MIN_RATIO,
    NEAR_HZ,
    NO_POWER,
    SHORT_S,
    SURE_VARIATION,
    ChannelWindow,
    Peak,
    by_station,
    find_lines,
    hann,
)
from companion.core.tracking.line_removal import LOCKED_RATIO, PARTS
from companion.core.tracking.spread_work import Stages
from companion.records import Complexes, Floats, Ints

WINDOW_S = 2.0  # chosen: half a hertz a bin; rpm wanders little in it
_HELD_S = 3.0  # chosen: the window, and what was sent since its end
_SAME_RATIO = 0.1  # chosen: rpm changes by that much while a peak is smeared
_ONE_HZ = 1.5  # chosen: two loops nearer than this follow one line
MIN_RATE_HZ = 400.0  # chosen: slower streams fold what they should tell apart
SILENT_NS = 500_000_000  # chosen: searches come once a second, and streams arrive within a tenth of one
_MEMORY = 5  # chosen, searches: so long a line is followed that is no longer found
_SMEARED = 3  # searches whose windows a peak's smear may come from: the window's two seconds (derived)
MULTIPLES = (3, 4, 6, 8, 9, 16, 18, 20, 24, 30, 36, 48)
"""Other lines that are looked for, in twelfths of the leader's frequency. Chosen."""
_PAUSE_AFTER = (8, 18, 48)  # multiples, chosen: a stage looks for four, in less than 1 ms
_MAX_SHAFTS = 3  # chosen: two engines and a generator
_MAX_LINES = 6  # chosen, of a shaft: each costs as much as the first
_LOWEST_TURNED_HZ = 20.0  # chosen: below, the first bending modes move most
_MIN_TURNED_RATIO = 25.0  # derived: noise exceeds it once in 2^25 looks
# chosen, of power: a shaft's leader is its strongest line, a mode's harmonic 200 times weaker (25 Hz, damped to 0.6 %)
_MAX_OVER_LEADER = 10.0
_TURNED_FLOOR_HZ = 20.0  # chosen: either side of a line, for the median
_PHASE_S = 0.12  # chosen: of the transforms that give the leader's phase; its rate may change by 8 Hz in them
_MIN_IN_ROW = 2  # chosen, searches in a row: a narrow band of noise rarely looks like a line twice
_CHANNELS = (1, 2, 3)  # lateral and vertical force, roll rate: what the tracker reads (convention)


class SampleRing:
    """Newest samples of one station as sent, lines included."""

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self._newest_ns = -(2**62)
        self._runs: list[tuple[Ints, Floats]] = []

    def add(self, t_ns: Ints, values: Floats) -> None:
        """Take the samples (n, 6) at stamps (n,) that are newer than what is held."""
        first = int(t_ns.searchsorted(self._newest_ns, side="right"))
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

    def window(self, until_ns: int) -> tuple[Floats, Floats] | None:
        """Instants (n,), s, and samples (n, 6) before one; None where it is not full or the stream slow or silent."""
        t_ns, values = self.held()
        count, last = int(0.95 * WINDOW_S * self.rate_hz), int(np.searchsorted(t_ns, until_ns))
        if self.rate_hz < MIN_RATE_HZ or last < count:
            return None
        lasts_s = (t_ns[last - 1] - t_ns[last - count]) * 1e-9
        if lasts_s >= WINDOW_S or until_ns - t_ns[last - 1] > SILENT_NS:
            return None
        return (t_ns[last - count : last] - until_ns) * np.float64(1e-9), values[last - count : last]


def channels_at(rings: list[SampleRing], until_ns: int) -> list[ChannelWindow]:
    """Channels of the last seconds before an instant."""
    windows = [(ring.window(until_ns), ring.rate_hz) for ring in rings]
    return [
        ChannelWindow(window[0], window[1][:, k], rate_hz) for window, rate_hz in windows if window for k in _CHANNELS
    ]


@dataclass
class _KnownShaft:
    """Shaft that is followed; ``searches`` count down to the end of each line while it is not found."""

    number: int
    leader_hz: float
    is_locked: bool = False  # whether the follower holds the leader, whatever the spectrum shows of it
    track_hz: deque[float] = field(default_factory=lambda: deque(maxlen=_SMEARED))  # where it was followed lately
    searches: int = _MEMORY
    misses: int = 0
    lines: dict[int, int] = field(default_factory=dict)  # searches to its end by multiple, once it is sure
    in_row: dict[int, int] = field(default_factory=dict)  # searches in a row in which others were found

    @property
    def multiples(self) -> tuple[int, ...]:
        """Lines in twelfths of the leader's frequency, the leader first; none that idling brings near the modes."""
        return (PARTS, *sorted(m for m in self.lines if m * self.leader_hz / PARTS >= _LOWEST_TURNED_HZ))

    def follow(self, frequency_hz: float, ratio: float) -> None:
        """Take where the leader is followed now, and its power over what its stream has besides."""
        self.leader_hz, self.is_locked = frequency_hz, ratio > LOCKED_RATIO
        self.track_hz.append(frequency_hz)
        if self.is_locked:
            self.searches, self.misses = _MEMORY, 0

    def smears(self, peak: Peak) -> bool:
        """Whether a peak may be the leader, on its way through the window's seconds."""
        passed_hz = [self.leader_hz, *(self.track_hz if self.is_locked else ())]
        low_hz, high_hz = (1.0 - _SAME_RATIO) * min(passed_hz), (1.0 + _SAME_RATIO) * max(passed_hz)
        return bool(low_hz < peak.frequency_hz < high_hz)

    def without_lines(self, peaks: list[Peak], leader_hz: float) -> list[Peak]:
        """Peaks that are none of its lines but the leader's, as far as rpm changes while a peak is smeared."""
        at_hz = [m * leader_hz / PARTS for m in self.lines]
        return [peak for peak in peaks if not any(abs(peak.frequency_hz / hz - 1.0) < _SAME_RATIO for hz in at_hz)]

    def take(self, ratios: dict[int, float]) -> None:
        """Take the ratios of the lines that this search has found, by multiple."""
        self.in_row = {multiple: self.in_row.get(multiple, 0) + 1 for multiple in ratios}
        for multiple, ratio in ratios.items():
            if ratio > MIN_RATIO or self.in_row[multiple] >= _MIN_IN_ROW:
                self.lines[multiple] = _MEMORY
        remaining = {m: searches if m in ratios else searches - 1 for m, searches in self.lines.items()}
        best = sorted(remaining, key=lambda m: -ratios.get(m, 0.0))[: _MAX_LINES - 1]
        self.lines = {m: remaining[m] for m in best if remaining[m] > 0}


class KnownLines:
    """Lines that are followed, by shaft: those found lately, and those found within the last few searches.

    Between two searches the follower knows better than the spectrum where a leader is: it smears when rpm changes. So a
    peak within a tenth of a leader is that leader, and moves it only where it is found elsewhere twice in a row.
    """

    def __init__(self) -> None:
        self._shafts: list[_KnownShaft] = []
        self._unsure: list[Peak] = []  # leaders of the last search that may be noise in a narrow band
        self._next = 0

    @property
    def leader_hz(self) -> dict[int, float]:
        """Leader's frequency by the shaft's number, Hz; a shaft that was lost and found again has a new number."""
        return {shaft.number: shaft.leader_hz for shaft in self._shafts}

    @property
    def multiples(self) -> dict[int, tuple[int, ...]]:
        """Lines of each shaft by its number, in twelfths of its leader's frequency."""
        return {shaft.number: shaft.multiples for shaft in self._shafts}

    def search(self, rings: list[SampleRing], until_ns: int, followed: dict[int, tuple[float, float]]) -> Stages[None]:
        """Stages of a search of the samples before an instant.

        ``followed`` has each leader's frequency by the shaft's number, as it is followed, and its power over what its
        stream has besides.
        """
        return self._search(channels_at(rings, until_ns), followed)

    def follow(self, followed: dict[int, tuple[float, float]]) -> None:
        """Take where the shafts that are in lock are followed now; ``followed`` as for the search."""
        for shaft in self._shafts:
            frequency_hz, ratio = followed.get(shaft.number, (shaft.leader_hz, 0.0))
            if ratio > LOCKED_RATIO:
                shaft.leader_hz = frequency_hz

    def _search(self, channels: list[ChannelWindow], followed: dict[int, tuple[float, float]]) -> Stages[None]:
        """Stages of a search of these channels."""
        peaks = yield from find_lines(channels)
        for shaft in list(self._shafts):
            shaft.follow(*followed.get(shaft.number, (shaft.leader_hz, 0.0)))
            peaks = yield from self._look_again(shaft, peaks, channels)
        peaks = [peak for peak in peaks if peak.frequency_hz >= LOWEST_HZ]
        before, self._unsure = self._unsure, [peak for peak in peaks if peak.variation > SURE_VARIATION]
        while peaks and len(self._shafts) < _MAX_SHAFTS:
            leader, *peaks = peaks
            if leader.variation > SURE_VARIATION and not any(_is_near(leader, other) for other in before):
                continue
            if is_harmonic_of_mode(leader, channels):
                continue
            self._begin(leader)
            peaks = yield from self._with_lines(self._shafts[-1], leader, peaks, channels)
        self._drop()

    def _look_again(self, shaft: _KnownShaft, peaks: list[Peak], channels: list[ChannelWindow]) -> Stages[list[Peak]]:
        """Look for a known shaft among peaks; those that are not its lines."""
        same = [peak for peak in peaks if shaft.smears(peak)]
        nearest = min(same, key=lambda peak: abs(shaft.leader_hz - peak.frequency_hz), default=None)
        away = nearest is None or abs(shaft.leader_hz - nearest.frequency_hz) > NEAR_HZ
        if nearest is None or (away and shaft.is_locked):
            shaft.searches -= not shaft.is_locked
            return shaft.without_lines([peak for peak in peaks if peak not in same], shaft.leader_hz)
        peaks = [peak for peak in peaks if peak is not nearest]
        shaft.searches = _MEMORY
        shaft.misses = shaft.misses + 1 if away else 0
        if shaft.misses > 1:
            self._shafts.remove(shaft)
            self._begin(nearest)
            shaft = self._shafts[-1]
        return (yield from self._with_lines(shaft, nearest, peaks, channels))

    def _with_lines(
        self, shaft: _KnownShaft, leader: Peak, peaks: list[Peak], channels: list[ChannelWindow]
    ) -> Stages[list[Peak]]:
        """Find the other lines of a shaft by its leader; the peaks that are none of them."""
        shaft.take((yield from turned_lines(leader, channels)))
        return shaft.without_lines(peaks, leader.frequency_hz)

    def _begin(self, leader: Peak) -> None:
        self._shafts.append(_KnownShaft(self._next, leader.frequency_hz))
        self._next += 1

    def _drop(self) -> None:
        """Drop shafts that are gone, and the younger of two that follow the same one."""
        distinct: list[_KnownShaft] = []
        for shaft in self._shafts:
            if shaft.searches > 0 and not any(abs(shaft.leader_hz - other.leader_hz) < _ONE_HZ for other in distinct):
                distinct.append(shaft)
        self._shafts = distinct


def _is_near(peak: Peak, other: Peak) -> bool:
    """Whether one peak may be the other, at another rpm."""
    return abs(peak.frequency_hz / other.frequency_hz - 1.0) < _SAME_RATIO


def turned_lines(leader: Peak, channels: list[ChannelWindow]) -> Stages[dict[int, float]]:
    """Lines that turn with the leader: ratio to their surroundings by multiple.

    Each channel's samples are turned back by a multiple of the leader's phase; a line then has zero frequency. Channels
    of a station share their instants, and the turning.
    """
    t_s, phase_rad = _phase(leader)
    ratios: dict[int, float] = {}
    for _, station in by_station(channels):
        together = list(station)
        rate_hz, (swings, turned_rad) = together[0].rate_hz, _station_turn(together, t_s, phase_rad)
        by_leader = swings * np.exp(-1j * turned_rad)
        for multiple in MULTIPLES:
            frequency_hz = multiple * leader.frequency_hz / PARTS
            if _LOWEST_TURNED_HZ <= frequency_hz <= HIGHEST_RATIO * rate_hz:
                turned = swings * np.exp(-1j * multiple / PARTS * turned_rad)
                ratio = _turned_ratio(turned, rate_hz)
                is_line = ratio > max(_MIN_TURNED_RATIO, ratios.get(multiple, 0.0))
                if is_line and not (frequency_hz < LOWEST_HZ and _outweighs(turned, by_leader)):
                    ratios[multiple] = ratio
            if multiple in _PAUSE_AFTER:
                yield
    return ratios


def is_harmonic_of_mode(leader: Peak, channels: list[ChannelWindow]) -> bool:
    """Whether a line is the second harmonic of a bending mode, by the force that a swinging tip feels along the span.

    Such a mode is damped so lightly that its envelope changes slowly. It moves the samples far more than its harmonic.
    """
    t_s, phase_rad = _phase(leader)
    for _, station in by_station(channels):
        together = list(station)
        if any(channel is leader.channel for channel in together):
            swings, turned_rad = _station_turn(together, t_s, phase_rad)
            return _outweighs(swings * np.exp(-0.5j * turned_rad), swings * np.exp(-1j * turned_rad))
    return False


def _station_turn(together: list[ChannelWindow], t_s: Floats, phase_rad: Floats) -> tuple[Floats, Floats]:
    """Swings (k, n) of a station's channels, and the leader's phase (n,), rad, at their instants."""
    return np.stack([channel.swing() for channel in together]), np.interp(together[0].t_s, t_s, phase_rad)


def _outweighs(turned: Complexes, by_leader: Complexes) -> bool:
    """Whether channels (k, n) have far more power at zero frequency than turned back by the leader; by their median."""
    window = hann(turned.shape[1])
    power, of_leader = np.abs(turned @ window) ** 2, np.abs(by_leader @ window) ** 2
    sent = of_leader > NO_POWER
    return bool(sent.any() and np.median(power[sent] / of_leader[sent]) > _MAX_OVER_LEADER)


def _phase(leader: Peak) -> tuple[Floats, Floats]:
    """Instants (k,), s, and phase (k,) of the leader in its channel, rad, over a little more than the window."""
    channel, turning = leader.channel, 2.0 * np.pi * leader.frequency_hz
    length = round(_PHASE_S * channel.rate_hz)
    samples = channel.swing() * np.exp(-1j * turning * channel.t_s)
    slow = np.convolve(samples, hann(length), mode="valid")
    middle = channel.t_s[length // 2 : length // 2 + len(slow)]
    phase_rad = np.unwrap(np.angle(slow)) + turning * middle
    ends = middle[[0, -1]] + np.array([-1.0, 1.0]) * _PHASE_S
    steps = round(0.5 * _PHASE_S * channel.rate_hz)
    rates = (phase_rad[[steps, -1]] - phase_rad[[0, -1 - steps]]) / (middle[[steps, -1]] - middle[[0, -1 - steps]])
    beyond = phase_rad[[0, -1]] + rates * (ends - middle[[0, -1]])
    return np.concatenate([ends[:1], middle, ends[1:]]), np.concatenate([beyond[:1], phase_rad, beyond[1:]])


def _turned_ratio(turned: Complexes, rate_hz: float) -> float:
    """Power at zero frequency over the median around it, of the channel (k, n) where it is highest.

    0 where no envelope there is steady.
    """
    n = turned.shape[1]
    power = np.abs(np.fft.fft(hann(n) * turned)) ** 2
    near, far = round(NEAR_HZ * n / rate_hz), round(_TURNED_FLOOR_HZ * n / rate_hz)
    floor = row_medians(np.concatenate([power[:, near:far], power[:, -far:-near]], axis=1))
    high = np.flatnonzero(power[:, 0] > _MIN_TURNED_RATIO * np.maximum(floor, NO_POWER))
    return max((float(power[k, 0] / floor[k]) for k in high if _steady(turned[k], rate_hz)), default=0.0)


def _steady(turned: Complexes, rate_hz: float) -> bool:
    """Whether the envelope of samples at zero frequency varies little."""
    length = round(SHORT_S * rate_hz)
    short = np.lib.stride_tricks.sliding_window_view(turned, length)[:: length // 2]
    square = np.abs(short @ hann(length)) ** 2
    return bool(square.var() < MAX_VARIATION * square.mean() ** 2)
