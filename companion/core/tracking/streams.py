"""One inertial stream: samples in order, refusals counted."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from companion.core.kernels.arrays import plain
from companion.core.tracking.axis_presence import AxisPresence
from companion.core.tracking.clipping import Clipping
from companion.core.tracking.line_removal import (
    LOCKED_RATIO,
    PARTS,
    LineStates,
    copied,
    leaders,
    line_states,
    remove_lines,
    take_over,
)
from companion.core.tracking.line_search import SampleRing
from companion.core.tracking.sample_outliers import NEIGHBOURS, find_outliers
from companion.core.tracking.standstill import Standstill
from companion.native.library import ARRAY, INTEGER, REAL, kernel
from companion.params.airframe import Sensor
from companion.records import Axis, Floats, ImuBatch, Ints, Reject, Rejected

CHANNELS = 6  # specific force x y z, rate p q r (by definition)
_SATURATION_HOLD_NS = 200_000_000  # chosen: a period of a 5 Hz wing behind the last saturated sample
_MAX_RANGE_RATIO = 1.05  # chosen: calibration may exceed the range by this much, nothing else
_RESIDUAL_SIGMAS = 1.4  # derived: a cubic's residual, sqrt(1 + 2 (2/3)^2 + 2 (1/6)^2), in sigmas of a sample


_append = kernel("stream_append", ARRAY, ARRAY, INTEGER, ARRAY, ARRAY, INTEGER, ARRAY, ARRAY)
_all_valid = kernel("stream_all_valid", ARRAY, ARRAY, REAL, REAL, INTEGER)
_WAITED_NS = 2_000_000_000  # chosen: kept while another station is waited for, longer than any lag
_RETAINED_NS, _RETAINED_PERIODS = 50_000_000, 5  # chosen: as interpolation and resampling need at either end
_EVER_NS = -(2**63)  # before every stamp (convention)


def within_range(batch: ImuBatch, sensor: Sensor) -> tuple[ImuBatch, list[Rejected]]:
    """Batch without samples beyond the sensor's range, which no filter may take, and their count."""
    if _valid(plain(batch.t_ns), plain(batch.values), sensor, _EVER_NS):
        return batch, []  # by far the most batches
    range_ratio = (np.abs(batch.values) / channel_ranges(sensor)).max(axis=1, initial=0.0)
    beyond = np.isfinite(range_ratio) & (range_ratio > _MAX_RANGE_RATIO)
    if not beyond.any():
        return batch, []
    refused = Rejected(Reject.BEYOND_RANGE, _name(batch), batch.received_host_ns, int(beyond.sum()))
    return dataclasses.replace(batch, t_ns=batch.t_ns[~beyond], values=batch.values[~beyond]), [refused]


def _valid(t_ns: Ints, values: Floats, sensor: Sensor, oldest_ns: int) -> bool:
    """Whether every sample is newer than an instant, finite and clear of the sensor's ranges."""
    return bool(_all_valid(t_ns, values, sensor.accel_range_mps2, sensor.gyro_range_radps, oldest_ns))


def channel_ranges(sensor: Sensor) -> Floats:
    """Range of each channel, (6,)."""
    return np.repeat([sensor.accel_range_mps2, sensor.gyro_range_radps], 3)


def _appended(
    t_ns: Ints, values: Floats, more_ns: Ints, more: Floats, period_ns: int, needed_ns: int
) -> tuple[Ints, Floats, bool]:
    """Samples behind those still needed, late stamps put back; False where they are not in order of time.

    A sender that stamps at the instant of sending and was held up sends two samples in one go, the first close ahead of
    the second and far behind the one before it. It belongs in the middle of the gap.
    """
    first = int(t_ns.searchsorted(needed_ns))
    count = len(t_ns) - first + len(more_ns)
    all_ns, together = np.empty(count, np.int64), np.empty((count, values.shape[1]))
    ordered = _append(t_ns, values, first, more_ns, more, period_ns, all_ns, together)
    return all_ns, together, bool(ordered)


class StreamSamples(NamedTuple):
    """Stream as plain arrays: stamps (s,), values (s, 6), usual rate, cut-off of its low-pass (6,), 0 for none."""

    t_ns: Ints
    values: Floats
    rate_hz: float
    cutoff_hz: Floats
    filtered: bool


@dataclass(slots=True)
class SampleBuffer:
    """Samples of one station that may still be needed, sorted by stamp.

    Attributes
    ----------
    place : str
        Of the sensor, for the operator.
    presence : AxisPresence
        Axes that it sends now.
    newest_ns : int or None
        Stamp of the newest accepted sample.
    saturated_ns : int or None
        Stamp of the newest sample that was refused as saturated.
    clipping : Clipping
        Samples at the sensor's limits, and what they cost.
    standstill : Standstill
        Channels that hang: nothing of the stream is used meanwhile.
    filtered : bool
        Whether the source low-passes its samples.
    ring : SampleRing
        What it has sent lately.
    """

    sensor: Sensor
    place: str = ""
    t_ns: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    values: Floats = field(default_factory=lambda: np.empty((0, CHANNELS)))
    presence: AxisPresence = field(default_factory=AxisPresence)
    newest_ns: int | None = None
    saturated_ns: int | None = None
    clipping: Clipping = field(init=False)
    standstill: Standstill = field(init=False)
    filtered: bool = field(init=False)
    ring: SampleRing = field(init=False)
    _lines: LineStates | None = None
    _shafts: list[int] = field(default_factory=list)  # numbers
    _clean_ns: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    _clean: Floats = field(default_factory=lambda: np.empty((0, CHANNELS)))
    _waiting: list[tuple[Ints, Floats]] = field(default_factory=list)
    _needed_ns: int = -(2**62)
    _cutoff_hz: Floats = field(init=False)
    _period_ns: int = field(init=False)
    _noise_sigma: Floats = field(init=False)
    _line_weight: Floats = field(init=False)
    _checked_ns: int = -(2**62)  # up to here it is known which samples contradict their neighbours
    _unreported_outliers: int = 0  # counted since the last report

    def __post_init__(self) -> None:
        sensor = self.sensor
        self.clipping = Clipping(channel_ranges(sensor), 1.0 / sensor.rate_hz)
        self.standstill = Standstill(sensor)
        self._cutoff_hz = np.repeat([sensor.lowpass_accel_hz, sensor.lowpass_gyro_hz], 3)
        self._period_ns = round(1e9 / sensor.rate_hz)
        noise = np.repeat([sensor.accel_noise_mps2_rthz, sensor.gyro_noise_radps_rthz], 3)
        self._line_weight = noise**-2.0
        self.ring = SampleRing(sensor.rate_hz)
        self._noise_sigma = _RESIDUAL_SIGMAS * noise * np.sqrt(0.5 * sensor.rate_hz)
        self.filtered = sensor.lowpass_accel_hz > 0.0 or sensor.lowpass_gyro_hz > 0.0

    def add(self, batch: ImuBatch, oldest_ns: int) -> list[Rejected]:
        """Take a batch; samples at or before ``oldest_ns``, not finite or outside the range are refused and counted.

        Clipped ones are counted, and refused only as ``Clipping.count`` says. So are outliers among
        earlier batches that have been recognised since.
        """
        reports, t, values = self._report_outliers(batch), plain(batch.t_ns), plain(batch.values)
        if len(t):
            values = self.presence.completed(t, values, batch.axes)
        if values is not batch.values:
            batch = dataclasses.replace(batch, values=values)
        if len(t) and self._hangs(t, values, batch.axes):
            return [*reports, Rejected(Reject.STALE, _name(batch), batch.received_host_ns, len(t))]
        if len(t) and not self.clipping.concerns(values) and _valid(t, values, self.sensor, oldest_ns):
            self._take(t, values)
            return reports
        batch, beyond = within_range(batch, self.sensor)
        return [*reports, *beyond, *self._take_valid(batch, oldest_ns)]

    def _hangs(self, t_ns: Ints, values: Floats, axes: Axis) -> bool:
        """Whether a channel stands still; as that is found, what came since is dropped as well."""
        before = self.standstill.since_ns
        self.standstill.update(t_ns, values, axes, self.clipping.found_range.range_of)
        since_ns = self.standstill.since_ns
        if since_ns is None:
            return False
        if before is None:
            self._merge_waiting()
            moving = self.t_ns <= since_ns
            self.t_ns, self.values = self.t_ns[moving], self.values[moving]
            self.newest_ns = min(since_ns, self.newest_ns or since_ns)
        return True

    def _report_outliers(self, batch: ImuBatch) -> list[Rejected]:
        """Count of outliers that have not been reported, as a refusal."""
        count, self._unreported_outliers = self._unreported_outliers, 0
        return [Rejected(Reject.LAPSED, _name(batch), batch.received_host_ns, count)] if count else []

    def _take_valid(self, batch: ImuBatch, oldest_ns: int) -> list[Rejected]:
        """Take the valid samples of a batch; refusals by reason."""
        t, values = plain(batch.t_ns), plain(batch.values)
        late = t <= oldest_ns
        infinite = ~np.isfinite(values).all(axis=1)
        clipped, lost, earlier = self.clipping.count(values)
        if earlier:
            self._recall(int(t[0]) - round((earlier + 0.5) * self._period_ns))
        if lost.any():
            self.saturated_ns = max(int(t[lost].max()), self.saturated_ns or 0)
        usable = ~(late | infinite | lost)
        if usable.any():
            self._take(t[usable], self.clipping.restore_mean(values[usable]))
        causes = (
            (Reject.NOT_FINITE, infinite),
            (Reject.SATURATED, clipped),
            (Reject.TOO_LATE, late & ~infinite & ~clipped),
        )
        return [Rejected(why, _name(batch), batch.received_host_ns, int(hit.sum())) for why, hit in causes if hit.any()]

    def _recall(self, from_ns: int) -> None:
        """Drop samples from an instant on: they were held, and the run that they begin is too long for that."""
        self._merge_waiting()
        before = int(self.t_ns.searchsorted(from_ns))
        self.t_ns, self.values = self.t_ns[:before], self.values[:before]

    def is_saturated(self, t_ns: int) -> bool:
        """Whether samples at its limits spoil the stream at an instant: a refused one lately, or too many."""
        return self.clipping.blinds or (
            self.saturated_ns is not None and t_ns - self.saturated_ns < _SATURATION_HOLD_NS
        )

    @property
    def axes(self) -> Axis:
        """Axes that it sends now."""
        return self.presence.axes

    @property
    def complaints(self) -> list[str]:
        """Sentences for the operator on what is wrong with the stream."""
        wrong = (self.standstill, self.presence, self.clipping.found_range)
        return [sentence for each in wrong for sentence in each.sentences(self.place)]

    def is_silent(self, since_ns: int) -> bool:
        """Whether nothing has come since an instant, not even samples at the sensor's limits."""
        return max(self.newest_ns or 0, self.saturated_ns or 0) < since_ns

    def _take(self, t_ns: Ints, values: Floats) -> None:
        """Queue samples until they are needed."""
        self._waiting.append((t_ns, values))
        newest_ns = int(t_ns.max())
        self.newest_ns = newest_ns if self.newest_ns is None else max(newest_ns, self.newest_ns)

    def first_ns(self) -> int | None:
        """Stamp of the oldest sample at hand."""
        self._merge_waiting()
        return int(self.t_ns[0]) if len(self.t_ns) else None

    def samples(self) -> tuple[Ints, Floats]:
        """All stamps (s,) and values (s, 6) at hand, in order."""
        self._merge_waiting()
        return self.t_ns, self.values

    def forget_waited(self) -> None:
        """Drop what is older than the newest seconds, as soon as more come: while other stations are waited for."""
        if self.newest_ns is not None:
            self._needed_ns = self.newest_ns - _WAITED_NS

    def forget(self, before_ns: int) -> None:
        """Drop samples well before an instant, as soon as more come."""
        self._needed_ns = before_ns - max(_RETAINED_NS, _RETAINED_PERIODS * self._period_ns)

    def _merge_waiting(self) -> None:
        """Sort the queued samples into the stream and remove outliers."""
        if not self._waiting:
            return
        t, values = self._waiting[0]
        if len(self._waiting) > 1:
            t = np.concatenate([waiting[0] for waiting in self._waiting])
            values = np.concatenate([waiting[1] for waiting in self._waiting])
        self._waiting.clear()
        oldest_ns = int(t.min())
        t, values, ordered = _appended(self.t_ns, self.values, t, values, self._period_ns, self._needed_ns)
        if not ordered:
            t, values = _sorted(t, values)
            t, values, _ = _appended(t[:0], values[:0], t, values, self._period_ns, self._needed_ns)
        self.t_ns, self.values = t, values
        self._drop_outliers(min(oldest_ns, self._checked_ns + 1))

    def _drop_outliers(self, from_ns: int) -> None:
        """Remove outliers from an instant on, as far as their neighbours are known."""
        t_ns = self.t_ns
        if len(t_ns) <= 2 * NEIGHBOURS:
            return
        outliers = find_outliers(
            t_ns, self.values, int(t_ns.searchsorted(from_ns)), self._noise_sigma, float(self._period_ns)
        )
        self._checked_ns = int(t_ns[-1 - NEIGHBOURS])
        if count := int(np.count_nonzero(outliers)):
            self._unreported_outliers += count
            self.t_ns, self.values = t_ns[~outliers], self.values[~outliers]

    def plain(self, until_ns: int) -> StreamSamples:
        """Samples as plain arrays; those not yet tested for outliers only where no others reach ``until_ns``."""
        self._merge_waiting()
        final = checked = int(self.t_ns.searchsorted(self._checked_ns, side="right"))
        if checked < 2 or self.t_ns[checked - 2] < until_ns:
            checked = len(self.t_ns)
        t_ns, values = self.t_ns[:checked], self.values[:checked]
        self.ring.add(t_ns[:final], values[:final])
        if self._lines is not None:
            t_ns, values = self._without_lines(self._lines, t_ns, values, final)
        return StreamSamples(t_ns, values, self.sensor.rate_hz, self._cutoff_hz, self.filtered)

    def follow_lines(self, leader_hz: dict[int, float], multiples: dict[int, tuple[int, ...]]) -> None:
        """Take the lines of these shafts out from here on; those that were followed by the same number still are.

        Where none was, the newest samples at hand tell the amplitudes.
        """
        fresh = line_states(
            np.array(list(leader_hz.values())), list(multiples.values()), self._line_weight, self.sensor.rate_hz
        )
        shafts = list(leader_hz)
        retained = {i: shafts.index(number) for i, number in enumerate(self._shafts) if number in leader_hz}
        if self._lines is not None and retained:
            take_over(fresh, self._lines, retained)
        self._shafts = shafts
        self._lines = fresh if shafts else None
        if self._lines is not None and not retained:
            self._clean_ns, values = self.ring.held()
            self._clean = remove_lines(self._clean_ns, values, 0, 1.0 / self.sensor.rate_hz, self._lines)

    def anchor_lines(self, leader_hz: dict[int, float]) -> None:
        """Move the anchor of each shaft's loop to where its leader is now; one that nothing turns begins there anew."""
        if self._lines is None:
            return
        anchor_radps = np.array([2.0 * np.pi * leader_hz[number] / PARTS for number in self._shafts])
        unlocked = np.array([ratio < LOCKED_RATIO for _, ratio in leaders(self._lines, self.sensor.rate_hz)])
        self._lines.anchor_radps[:] = anchor_radps
        unled = unlocked & (self._lines.led == 0)
        self._lines.omega_radps[unled] = anchor_radps[unled]
        self._lines.alpha_radps2[unled] = 0.0

    def turn_with(self, locked: SampleBuffer | None, number: int) -> None:
        """Turn a shaft, where this stream's loop is out of lock, as the loop of a stream that is in lock, if any is."""
        to, of = self._lines, None if locked is None else locked._lines
        if to is None:
            return
        i = self._shafts.index(number)
        to.led[i] = of is not None and leaders(to, self.sensor.rate_hz)[i][1] < LOCKED_RATIO
        if locked is not None and of is not None and to.led[i]:
            j = locked._shafts.index(number)
            to.omega_radps[i], to.alpha_radps2[i] = of.omega_radps[j], of.alpha_radps2[j]

    def followed_shafts(self) -> dict[int, tuple[float, float]]:
        """Leader of each shaft by number: frequency (Hz), and its power over what else the stream has."""
        if self._lines is None:
            return {}
        return dict(zip(self._shafts, leaders(self._lines, self.sensor.rate_hz), strict=True))

    def _without_lines(self, lines: LineStates, t_ns: Ints, values: Floats, final: int) -> tuple[Ints, Floats]:
        """Samples at hand without lines; the first ``final`` are final, and the lines are followed through them."""
        period_s = 1.0 / self.sensor.rate_hz
        done = int(np.searchsorted(t_ns, self._clean_ns[-1], side="right")) if len(self._clean_ns) else 0
        keep = int(np.searchsorted(self._clean_ns, t_ns[0])) if len(t_ns) else 0
        self._clean_ns, self._clean = self._clean_ns[keep:], self._clean[keep:]
        if final > done:
            more = remove_lines(t_ns[:final], values[:final], done, period_s, lines)
            self._clean_ns = np.concatenate((self._clean_ns, t_ns[done:final]))
            self._clean = np.concatenate((self._clean, more))
        tail = max(final, done)
        rest = remove_lines(t_ns, values, tail, period_s, copied(lines))
        at = np.searchsorted(t_ns[:tail], self._clean_ns)
        held = np.append(t_ns[:tail], -1)[at] == self._clean_ns  # both are in order, and -1 is the stamp of none
        return np.concatenate((self._clean_ns[held], t_ns[tail:])), np.concatenate((self._clean[held], rest))


def _name(batch: ImuBatch) -> str:
    """Name of a station's samples in refusals."""
    return f"{batch.station.name.lower()} inertial sample"


def _sorted(t_ns: Ints, values: Floats) -> tuple[Ints, Floats]:
    """Stamps and values in order; values of equal stamps are averaged."""
    order = np.argsort(t_ns, kind="stable")
    t_ns, values = t_ns[order], values[order]
    fresh = np.concatenate([[True], np.diff(t_ns) > 0])
    group = np.cumsum(fresh) - 1
    summed = np.stack([np.bincount(group, column) for column in values.T], axis=1)
    return t_ns[fresh], summed / np.bincount(group)[:, None]
