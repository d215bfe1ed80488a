"""One inertial stream: samples in order, refusals counted, averages over any cells."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.core.mode.averaging import cell_means, cell_means_unfiltered, cut_shares
from companion.params.airframe import Sensor
from companion.records import Axis, Bools, Floats, ImuBatch, Ints, Reject, Rejected

CHANNELS = 6
_CLIPPED = 0.002  # so near to the range a value was clipped; one well beyond was not, whatever the range is said to be
_GAP_PERIODS = 3.5
_GAP_FLOOR_S = 0.012
_CLOSE, _FAR = 0.4, 1.3  # periods
_RESOLVED = 2.9  # samples per cell that make a moment


def respaced(t_ns: Ints, period_ns: int) -> Ints:
    """Put back what was stamped late: a sample close ahead of the next, and far behind the one before it.

    A sender that stamps at the instant of sending and was held up sends two samples in one go. The first belongs in
    the middle of the gap.
    """
    late = 1 + np.flatnonzero(
        (t_ns[2:] - t_ns[1:-1] < _CLOSE * period_ns) & (t_ns[1:-1] - t_ns[:-2] > _FAR * period_ns)
    )
    if not len(late):
        return t_ns
    moved = t_ns.copy()
    moved[late] = (t_ns[late - 1] + t_ns[late + 1]) // 2
    return moved


@dataclass(frozen=True, slots=True)
class Averages:
    """A stream over consecutive cells; zero where not covered.

    Attributes
    ----------
    mean : (n, 6) float64
    moment : (n,) float64
        First moment of the vertical axis, ``integral (t - middle) z dt / h^2``.
    cut : (n,) float64
        See :func:`companion.core.mode.averaging.cut_shares`.
    covered, resolved : (n,) bool
        There are samples; there are enough for a moment.
    """

    mean: Floats
    moment: Floats
    cut: Floats
    covered: Bools
    resolved: bool


@dataclass(slots=True)
class Stream:
    """Samples of one station that may still be needed, sorted by stamp.

    Attributes
    ----------
    newest_ns : int or None
        Stamp of the newest sample that was kept.
    saturated_ns : int or None
        Stamp of the newest sample that was refused as saturated.
    """

    sensor: Sensor
    t_ns: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    values: Floats = field(default_factory=lambda: np.empty((0, CHANNELS)))
    axes: Axis = Axis.NONE
    newest_ns: int | None = None
    saturated_ns: int | None = None
    _waiting: list[tuple[Ints, Floats]] = field(default_factory=list)
    _range: Floats = field(init=False)
    _cutoff_hz: Floats = field(init=False)

    def __post_init__(self) -> None:
        own = self.sensor
        self._range = np.repeat([own.accel_range_mps2, own.gyro_range_radps], 3)
        self._cutoff_hz = np.repeat([own.lowpass_accel_hz, own.lowpass_gyro_hz], 3)

    def add(self, batch: ImuBatch, oldest_ns: int) -> list[Rejected]:
        """Take a batch; samples at or before ``oldest_ns``, not finite or saturated are refused and counted."""
        t, values = batch.t_ns, batch.values
        late = t <= oldest_ns
        infinite = ~np.isfinite(values).all(axis=1)
        with np.errstate(invalid="ignore"):
            full = (np.abs(np.abs(values) / self._range - 1.0) < _CLIPPED).any(axis=1)
        full &= ~infinite
        bad = late | infinite | full
        self.axes |= batch.axes
        if full.any():
            self.saturated_ns = max(int(t[full].max()), self.saturated_ns or 0)
        if bad.any():
            t, values = t[~bad], values[~bad]
        if len(t):
            self._waiting.append((t, values))
            self.newest_ns = max(int(t.max()), self.newest_ns) if self.newest_ns is not None else int(t.max())
        if not bad.any():
            return []
        causes = ((Reject.NOT_FINITE, infinite), (Reject.SATURATED, full), (Reject.TOO_LATE, late & ~infinite & ~full))
        what = f"{batch.station.name.lower()} inertial sample"
        return [Rejected(why, what, batch.received_host_ns, int(hit.sum())) for why, hit in causes if hit.any()]

    def first_ns(self) -> int | None:
        """Stamp of the oldest sample at hand."""
        self._settle()
        return int(self.t_ns[0]) if len(self.t_ns) else None

    def samples(self) -> tuple[Ints, Floats]:
        """Everything at hand, in order of the stamps."""
        self._settle()
        return self.t_ns, self.values

    def forget(self, before_ns: int) -> None:
        """Drop what lies before an instant."""
        self._settle()
        keep = int(np.searchsorted(self.t_ns, before_ns))
        if keep > 64:
            self.t_ns, self.values = self.t_ns[keep:].copy(), self.values[keep:].copy()

    def _settle(self) -> None:
        if not self._waiting:
            return
        t = np.concatenate([self.t_ns, *(part[0] for part in self._waiting)])
        values = np.concatenate([self.values, *(part[1] for part in self._waiting)])
        self._waiting.clear()
        steps = np.diff(t)
        if (steps <= 0).any():
            order = np.argsort(t, kind="stable")
            t, values = t[order], values[order]
            fresh = np.concatenate([[True], np.diff(t) > 0])
            group = np.cumsum(fresh) - 1  # equal stamps are averaged
            values = np.stack([np.bincount(group, column) for column in values.T], axis=1) / np.bincount(group)[:, None]
            t = t[fresh]
        self.t_ns, self.values = respaced(t, round(1e9 / self.sensor.rate_hz)), values

    def average(self, edges_ns: Ints) -> Averages:
        """Average over the cells between consecutive, equally spaced edges, (n + 1,)."""
        self._settle()
        cells = len(edges_ns) - 1
        low = max(int(self.t_ns.searchsorted(edges_ns[0])) - 4, 0)
        high = int(self.t_ns.searchsorted(edges_ns[-1])) + 4
        t_ns, y = self.t_ns[low:high], self.values[low:high]
        if len(t_ns) < 4:
            nothing = np.zeros(cells)
            return Averages(np.zeros((cells, CHANNELS)), nothing, nothing, np.zeros(cells, dtype=bool), False)
        t = (t_ns - edges_ns[0]) * 1e-9
        edges = (edges_ns - edges_ns[0]) * 1e-9
        covered = self._covered(t, edges)
        if self.filtered:
            mean, moment = cell_means_unfiltered(t, y, edges, self._cutoff_hz), np.zeros(cells)
            cut = np.zeros(cells)
        else:
            mean, moment = cell_means(t, y, edges)
            cut = cut_shares(t, edges)
        if not covered.all():
            mean[~covered], moment[~covered] = 0.0, 0.0
        resolved = not self.filtered and (edges[1] - edges[0]) * self.sensor.rate_hz >= _RESOLVED
        return Averages(mean, moment, cut, covered, bool(resolved))

    def _covered(self, t: Floats, edges: Floats) -> Bools:
        limit = max(_GAP_PERIODS / self.sensor.rate_hz, _GAP_FLOOR_S)
        gaps = np.zeros(len(t), dtype=np.int64)
        np.cumsum(t[1:] - t[:-1] > limit, out=gaps[1:])
        after = t.searchsorted(edges[:-1], side="right")
        until = t.searchsorted(edges[1:], side="left")
        inside = (after > 0) & (until < len(t))
        covered: Bools = inside & (gaps[np.minimum(until, len(t) - 1)] == gaps[np.maximum(after, 1) - 1])
        return covered

    @property
    def filtered(self) -> bool:
        """Whether the source low-passes what it sends."""
        return self.sensor.lowpass_accel_hz > 0.0 or self.sensor.lowpass_gyro_hz > 0.0
