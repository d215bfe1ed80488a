"""One inertial stream: samples in order, refusals counted, averages over any cells."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import compiled, plain
from companion.core.tracking.resampling import bridged, bridged_shares, cell_means, cell_means_unfiltered, cut_shares
from companion.core.tracking.sample_outliers import BESIDE, lapses
from companion.params.airframe import Sensor
from companion.records import Axis, Bools, Floats, ImuBatch, Ints, Reject, Rejected

CHANNELS = 6
_CLIPPED = 0.002  # so near to the range a value was clipped
_BEYOND = 1.05  # of the range: no sensor says so
_MISSED = 1.4  # sigmas of a sample's noise by which it misses a cubic through its neighbours
_GAP_PERIODS = 3.5
_GAP_FLOOR_S = 0.012
_LOST_PERIODS = 1.6
_CLOSE, _FAR = 0.4, 1.3  # periods
_RESOLVED = 2.9  # samples per cell that make a moment


def within_range(batch: ImuBatch, sensor: Sensor) -> tuple[ImuBatch, list[Rejected]]:
    """The batch without samples beyond what its sensor can say, of which no filter should hear; those are counted."""
    if _inside(batch.values[:, :3], sensor.accel_range_mps2) and _inside(batch.values[:, 3:], sensor.gyro_range_radps):
        return batch, []  # by far the most batches
    share = (np.abs(batch.values) / _ranges(sensor)).max(axis=1, initial=0.0)
    beyond = np.isfinite(share) & (share > _BEYOND)
    if not beyond.any():
        return batch, []
    refused = Rejected(Reject.BEYOND_RANGE, _name(batch), batch.received_host_ns, int(beyond.sum()))
    return dataclasses.replace(batch, t_ns=batch.t_ns[~beyond], values=batch.values[~beyond]), [refused]


def _inside(values: Floats, limit: float) -> bool:
    """Whether no value reaches beyond +-``limit``; False where one is not a number."""
    return bool(values.max(initial=0.0) <= limit and values.min(initial=0.0) >= -limit)


def _ranges(sensor: Sensor) -> Floats:
    return np.repeat([sensor.accel_range_mps2, sensor.gyro_range_radps], 3)


@compiled
def respaced(t_ns: Ints, period_ns: int) -> Ints:
    """Put back what was stamped late: a sample close ahead of the next, and far behind the one before it.

    A sender that stamps at the instant of sending and was held up sends two samples in one go. The first belongs in
    the middle of the gap.
    """
    close = t_ns[2:] - t_ns[1:-1] < _CLOSE * period_ns
    late = 1 + np.flatnonzero(close & (t_ns[1:-1] - t_ns[:-2] > _FAR * period_ns))
    if not len(late):
        return t_ns
    moved = t_ns.copy()
    moved[late] = (t_ns[late - 1] + t_ns[late + 1]) // 2
    return moved


@compiled
def _flawless(t_ns: Ints, values: Floats, limits: Floats, oldest_ns: int) -> bool:
    """Whether every sample is new, finite and inside the sensor's range."""
    if not (t_ns > oldest_ns).all() or not np.isfinite(values).all():
        return False
    return not (np.abs(values) / limits > 1.0 - _CLIPPED).any()


@compiled
def _appended(
    t_ns: Ints, values: Floats, more_ns: Ints, more: Floats, period_ns: int, needed_ns: int
) -> tuple[Ints, Floats, bool]:
    """Put samples behind those at hand that are needed, respaced; False where they are not in order of time."""
    first = np.searchsorted(t_ns, needed_ns)
    together = np.concatenate((t_ns[first:], more_ns))
    ordered = bool((together[1:] > together[:-1]).all())
    return respaced(together, period_ns) if ordered else together, np.concatenate((values[first:], more)), ordered


class Samples(NamedTuple):
    """A stream as plain values: stamps (s,) in order, values (s, 6), its usual rate, the low-pass that it went through.

    ``cutoff_hz`` is (6,), 0 where there is none.
    """

    t_ns: Ints
    values: Floats
    rate_hz: float
    cutoff_hz: Floats
    filtered: bool


class Averages(NamedTuple):
    """A stream over consecutive cells; zero where not covered.

    Attributes
    ----------
    mean : (n, 6) float64
    moment : (n,) float64
        First moment of the vertical axis, ``integral (t - middle) z dt / h^2``.
    cut : (n,) float64
        See :func:`companion.core.tracking.resampling.cut_shares` and ``bridged_shares``.
    covered : (n,) bool
        There are samples.
    resolved : (n,) bool
        There are enough for a moment, and none was lost.
    """

    mean: Floats
    moment: Floats
    cut: Floats
    covered: Bools
    resolved: Bools


@dataclass(slots=True)
class Stream:
    """Samples of one station that may still be needed, sorted by stamp.

    Attributes
    ----------
    newest_ns : int or None
        Stamp of the newest sample that was kept.
    saturated_ns : int or None
        Stamp of the newest sample that was refused as saturated.
    filtered : bool
        Whether the source low-passes what it sends.
    """

    sensor: Sensor
    t_ns: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    values: Floats = field(default_factory=lambda: np.empty((0, CHANNELS)))
    axes: Axis = Axis.NONE
    newest_ns: int | None = None
    saturated_ns: int | None = None
    filtered: bool = field(init=False)
    _waiting: list[tuple[Ints, Floats]] = field(default_factory=list)
    _needed_ns: int = -(2**62)
    _range: Floats = field(init=False)
    _cutoff_hz: Floats = field(init=False)
    _period_ns: int = field(init=False)
    _floor: Floats = field(init=False)
    _judged_ns: int = -(2**62)  # up to here it is known which samples contradict their neighbours
    _lapsed: int = 0  # that have not been told

    def __post_init__(self) -> None:
        own = self.sensor
        self._range = _ranges(own)
        self._cutoff_hz = np.repeat([own.lowpass_accel_hz, own.lowpass_gyro_hz], 3)
        self._period_ns = round(1e9 / own.rate_hz)
        noise = np.repeat([own.accel_noise_mps2_rthz, own.gyro_noise_radps_rthz], 3)
        self._floor = _MISSED * noise * np.sqrt(0.5 * own.rate_hz)
        self.filtered = own.lowpass_accel_hz > 0.0 or own.lowpass_gyro_hz > 0.0

    def add(self, batch: ImuBatch, oldest_ns: int) -> list[Rejected]:
        """Take a batch; samples at or before ``oldest_ns``, not finite or outside the range are refused and counted.

        So are those, of earlier batches, that have since turned out to contradict all their neighbours.
        """
        told, t, values = self._told(batch), plain(batch.t_ns), plain(batch.values)
        if batch.axes is not self.axes:
            self.axes |= batch.axes
        if len(t) and _flawless(t, values, self._range, oldest_ns):
            self._take(t, values)
            return told
        batch, beyond = within_range(batch, self.sensor)
        return [*told, *beyond, *self._take_good(batch, oldest_ns)]

    def _told(self, batch: ImuBatch) -> list[Rejected]:
        count, self._lapsed = self._lapsed, 0
        return [Rejected(Reject.LAPSED, _name(batch), batch.received_host_ns, count)] if count else []

    def _take_good(self, batch: ImuBatch, oldest_ns: int) -> list[Rejected]:
        t, values = plain(batch.t_ns), plain(batch.values)
        late = t <= oldest_ns
        infinite = ~np.isfinite(values).all(axis=1)
        with np.errstate(invalid="ignore"):
            full = ~infinite & ((np.abs(values) / self._range).max(axis=1, initial=0.0) > 1.0 - _CLIPPED)
        bad = late | infinite | full
        if full.any():
            self.saturated_ns = max(int(t[full].max()), self.saturated_ns or 0)
        if bad.any():
            t, values = t[~bad], values[~bad]
        if len(t):
            self._take(t, values)
        causes = ((Reject.NOT_FINITE, infinite), (Reject.SATURATED, full), (Reject.TOO_LATE, late & ~infinite & ~full))
        return [Rejected(why, _name(batch), batch.received_host_ns, int(hit.sum())) for why, hit in causes if hit.any()]

    def _take(self, t_ns: Ints, values: Floats) -> None:
        self._waiting.append((t_ns, values))
        newest_ns = int(t_ns.max())
        self.newest_ns = newest_ns if self.newest_ns is None else max(newest_ns, self.newest_ns)

    def first_ns(self) -> int | None:
        """Stamp of the oldest sample at hand."""
        self._settle()
        return int(self.t_ns[0]) if len(self.t_ns) else None

    def samples(self) -> tuple[Ints, Floats]:
        """Everything at hand, in order of the stamps."""
        self._settle()
        return self.t_ns, self.values

    def forget(self, before_ns: int) -> None:
        """Drop what lies before an instant, as soon as more comes."""
        self._needed_ns = before_ns

    def _settle(self) -> None:
        if not self._waiting:
            return
        t, values = self._waiting[0]
        if len(self._waiting) > 1:
            t = np.concatenate([part[0] for part in self._waiting])
            values = np.concatenate([part[1] for part in self._waiting])
        self._waiting.clear()
        oldest_ns = int(t.min())
        t, values, ordered = _appended(self.t_ns, self.values, t, values, self._period_ns, self._needed_ns)
        if not ordered:
            t, values = _sorted(t, values)
            t, values, _ = _appended(t[:0], values[:0], t, values, self._period_ns, self._needed_ns)
        self.t_ns, self.values = t, values
        self._judge(min(oldest_ns, self._judged_ns + 1))

    def _judge(self, from_ns: int) -> None:
        """Take out the samples from an instant on that contradict their neighbours, as far as there are enough."""
        t_ns = self.t_ns
        if len(t_ns) <= 2 * BESIDE:
            return
        lapsed = lapses(t_ns, self.values, int(np.searchsorted(t_ns, from_ns)), self._floor, float(self._period_ns))
        self._judged_ns = int(t_ns[-1 - BESIDE])
        if lapsed.any():
            self._lapsed += int(lapsed.sum())
            self.t_ns, self.values = t_ns[~lapsed], self.values[~lapsed]

    def average(self, edges_ns: Ints) -> Averages:
        """Average over the cells between consecutive, equally spaced edges, (n + 1,)."""
        return averages(self.plain(int(edges_ns[-1])), edges_ns)

    def plain(self, until_ns: int) -> Samples:
        """Everything at hand, for what is compiled; samples that nobody has judged only if there is no other way."""
        self._settle()
        judged = int(np.searchsorted(self.t_ns, self._judged_ns, side="right"))
        if judged < 2 or self.t_ns[judged - 2] < until_ns:
            judged = len(self.t_ns)
        t_ns, values = self.t_ns[:judged], self.values[:judged]
        return Samples(t_ns, values, self.sensor.rate_hz, self._cutoff_hz, self.filtered)


def _name(batch: ImuBatch) -> str:
    return f"{batch.station.name.lower()} inertial sample"


def _sorted(t_ns: Ints, values: Floats) -> tuple[Ints, Floats]:
    """In order of the stamps; equal ones are averaged."""
    order = np.argsort(t_ns, kind="stable")
    t_ns, values = t_ns[order], values[order]
    fresh = np.concatenate([[True], np.diff(t_ns) > 0])
    group = np.cumsum(fresh) - 1
    summed = np.stack([np.bincount(group, column) for column in values.T], axis=1)
    return t_ns[fresh], summed / np.bincount(group)[:, None]


@compiled
def averages(samples: Samples, edges_ns: Ints) -> Averages:
    """Average over the cells between consecutive, equally spaced edges, (n + 1,)."""
    cells = len(edges_ns) - 1
    low = max(int(np.searchsorted(samples.t_ns, edges_ns[0])) - 4, 0)
    high = int(np.searchsorted(samples.t_ns, edges_ns[-1])) + 4
    t_ns, y = samples.t_ns[low:high], samples.values[low:high]
    if len(t_ns) < 4:
        nothing, none = np.zeros(cells), np.zeros(cells, np.bool_)
        return Averages(np.zeros((cells, CHANNELS)), nothing, nothing, none, none)
    t = (t_ns - edges_ns[0]) * 1e-9
    edges = (edges_ns - edges_ns[0]) * 1e-9
    limit_s = max(_GAP_PERIODS / samples.rate_hz, _GAP_FLOOR_S)
    if samples.filtered:
        mean, moment = cell_means_unfiltered(t, y, edges, samples.cutoff_hz), np.zeros(cells)
        cut = np.zeros(cells)
    else:
        period_s = 1.0 / samples.rate_hz
        full_t, full_y = bridged(t, y, period_s, limit_s)
        mean, moment = cell_means(full_t, full_y, edges)
        cut = cut_shares(full_t, edges) + bridged_shares(t, edges, period_s)
    widest = _widest_gaps(t, edges)
    covered, resolved = widest <= limit_s, widest <= _LOST_PERIODS / samples.rate_hz
    for k in range(cells):
        if not covered[k]:
            mean[k], moment[k] = 0.0, 0.0
    if samples.filtered or (edges[1] - edges[0]) * samples.rate_hz < _RESOLVED:
        resolved[:] = False
    return Averages(mean, moment, cut, covered, resolved)


@compiled
def _widest_gaps(t: Floats, edges: Floats) -> Floats:
    """Of each cell the longest gap between samples, those around it included; infinite without these, (n,)."""
    gap, widest = t[1:] - t[:-1], np.full(len(edges) - 1, np.inf)
    after = np.searchsorted(t, edges[:-1], side="right")
    until = np.searchsorted(t, edges[1:], side="left")
    for k in range(len(widest)):
        if after[k] > 0 and until[k] < len(t):
            widest[k] = gap[after[k] - 1 : until[k]].max()
    return widest
