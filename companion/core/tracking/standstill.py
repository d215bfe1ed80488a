"""Channels of a stream that stand still: a sensor that hangs sends its last value again and again."""

from __future__ import annotations

import numpy as np

from companion.params.airframe import Sensor
from companion.records import AXIS_LETTERS, Axis, Floats, Ints

_SPAN_NS = 50_000_000  # chosen: the usual reorder window, so that the filter has taken none of them
_FEWEST = 10  # chosen: samples in a row, of a slow stream
_BACK_NS = 200_000_000  # chosen: a channel that has moved for so long hangs no more
_LOOK_NS = 100_000_000  # chosen: between looks while all channels move: a look costs as much as the rest of a batch
_MEMORY_S = 5.0  # chosen: in which a channel shows how often it repeats its value
_MOST_REPEATED = 0.5  # chosen: of 50 samples all alike are one in 1e15 then
_NOISE_BAND = 1.11  # derived: of a Butterworth filter of second order, in cut-offs
_MARGIN = 0.99  # chosen, of the range: what is clipped stands still there


class Standstill:
    """Watch on one stream for channels whose value is bitwise the same for 50 ms and ten samples.

    A channel that repeats its value often, or whose resolution is coarser than its stated noise, may stand still.

    Attributes
    ----------
    since_ns : int or None
        Stamp of the last sample before the standstill, behind which none is to be used; None where all channels move.
    """

    def __init__(self, sensor: Sensor) -> None:
        noise = np.repeat([sensor.accel_noise_mps2_rthz, sensor.gyro_noise_radps_rthz], 3)
        cutoff_hz = np.repeat([sensor.lowpass_accel_hz, sensor.lowpass_gyro_hz], 3)
        band_hz = np.where(cutoff_hz > 0.0, _NOISE_BAND * cutoff_hz, np.inf)
        self._noise_sigma: Floats = noise * np.sqrt(np.minimum(band_hz, 0.5 * sensor.rate_hz))
        self._sent = sensor.axes.mask
        self._span_ns = max(_SPAN_NS, round(_FEWEST * 1e9 / sensor.rate_hz))
        self._newest: Floats = np.full(len(AXIS_LETTERS), np.nan)
        self._changed_ns = np.zeros(len(AXIS_LETTERS), np.int64)  # the newest value came first
        self._still_ns = np.zeros(len(AXIS_LETTERS), np.int64)  # it stood still last
        self._step: Floats = np.full(len(AXIS_LETTERS), np.inf)  # least change that it has shown
        self._repeated: Floats = np.ones(len(AXIS_LETTERS))  # share of the last seconds' samples
        self._lively = np.zeros(len(AXIS_LETTERS), np.bool_)  # may not stand still
        self._hangs = np.zeros(len(AXIS_LETTERS), np.bool_)
        self._looked_ns = -(2**62)
        self.since_ns: int | None = None

    def update(self, t_ns: Ints, values: Floats, axes: Axis, range_of: Floats) -> None:
        """Look at the next samples, (n,) and (n, 6) with n > 0, with the range of each channel (6,)."""
        newest_ns = int(t_ns[-1])
        if self.since_ns is not None or self._may_hang(newest_ns, values):
            self._look(t_ns, values, axes, range_of)
        self._newest = values[-1].copy()

    def _may_hang(self, newest_ns: int, values: Floats) -> bool:
        """Whether to look closely: it is time to, or a channel has not moved for half of the span."""
        np.copyto(self._changed_ns, newest_ns, where=values[-1] != (values[-2] if len(values) > 1 else self._newest))
        if not 0 <= newest_ns - self._looked_ns < _LOOK_NS:
            return True
        return bool((newest_ns - self._changed_ns)[self._lively].max(initial=0) > self._span_ns // 2)

    def _look(self, t_ns: Ints, values: Floats, axes: Axis, range_of: Floats) -> None:
        newest_ns = int(t_ns[-1])
        with np.errstate(invalid="ignore"):
            change = np.abs(values - np.concatenate((self._newest[np.newaxis], values[:-1])))
            self._step = np.minimum(self._step, np.where(change > 0.0, change, np.inf).min(axis=0))
            same = (change == 0.0) & (np.abs(values) < _MARGIN * range_of)
        last = len(t_ns) - 1 - (~same[::-1]).argmax(axis=0)  # that differs from the one before
        self._changed_ns = np.where(same.all(axis=0), np.minimum(self._changed_ns, newest_ns), t_ns[last])
        still = newest_ns - self._changed_ns >= self._span_ns
        self._still_ns = np.where(still, newest_ns, np.minimum(self._still_ns, newest_ns))
        self._lively = (self._repeated < _MOST_REPEATED) & (self._step < self._noise_sigma) & self._sent
        hung = self._hangs
        self._hangs = np.where(hung, newest_ns - self._still_ns < _BACK_NS, still & self._lively)
        self._hangs &= axes.mask
        weight = min(max(newest_ns - self._looked_ns, 0) * 1e-9 / _MEMORY_S, 1.0)
        self._repeated += np.where(hung, 0.0, weight * (same.mean(axis=0) - self._repeated))
        self._looked_ns = newest_ns
        if not self._hangs.any():
            self.since_ns = None
        elif self.since_ns is None:
            self.since_ns = int(self._changed_ns[self._hangs].min())

    def sentences(self, place: str) -> list[str]:
        """Sentence for the operator, where a channel stands still."""
        axes = "".join(letter for letter, hangs in zip(AXIS_LETTERS, self._hangs, strict=True) if hangs)
        return [f"{place} {axes} stands still: its samples are not used"] if axes else []
