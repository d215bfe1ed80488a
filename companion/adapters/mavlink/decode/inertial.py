"""From an inertial message's samples to batches of one station: instance, axes, signs, finiteness, time order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator

import numpy as np

from companion.adapters.mavlink.decode.bulk import SampleRun
from companion.adapters.mavlink.decode.counters import RefusalCounters
from companion.adapters.mavlink.decode.layouts import WRAPPING, MessageSamples
from companion.adapters.mavlink.decode.source_map import MappedSource
from companion.adapters.mavlink.link.dialect import NAME_OF
from companion.adapters.mavlink.vehicle.clock_reset_detector import LEAPS, ClockResetDetector
from companion.records import Axis, Bools, ClockRestart, Floats, ImuBatch, Ints, Reject

_COLUMNS = np.arange(6)
_BEYOND_NS = -1  # mark of the layouts: a stamp beyond any clock (convention)


class StationReader:
    """Makes the batches of one station from the payloads of its source."""

    def __init__(self, source: MappedSource, reset_detector: ClockResetDetector, refusals: RefusalCounters) -> None:
        self.source = source
        self.name = f"{NAME_OF[source.message]} of component {source.component}"
        self._reset_detector, self._followed = reset_detector, reset_detector.follow(source.clock)
        self._refusals = refusals
        self._order, self._signs = source.order, source.signs
        self._wraps = NAME_OF[source.message] in WRAPPING
        self._turned = source.body_from_sensor is not None

    def batches(self, samples: MessageSamples, received_host_ns: int) -> Iterator[ImuBatch | ClockRestart]:
        """Give this station's batches, and a restart of its clock where one shows."""
        chosen = self._of_instance(samples)
        if chosen is not None and not chosen.any():
            return
        t_ns, values, fields = samples.t_ns, samples.values, samples.fields
        if chosen is not None:
            t_ns, values = t_ns[chosen], values[chosen]
            fields = None if fields is None else fields[chosen]
        if self._turned:
            values = values[:, self._order] * self._signs
        for rows, axes in self._runs(fields):
            yield from self._emit(t_ns[rows], values[rows], axes, received_host_ns)

    def _of_instance(self, samples: MessageSamples) -> Bools | None:
        """Select this station's instance; None where all samples are of it."""
        if samples.instances is None:
            return None if self.source.instance == "0" else np.zeros(len(samples.t_ns), dtype=np.bool_)
        chosen = np.array([name == self.source.instance for name in samples.instances], dtype=np.bool_)
        return None if chosen.all() and len(chosen) else chosen

    def _runs(self, fields: Ints | None) -> Iterator[tuple[slice, Axis]]:
        """Split into runs of samples that updated the same axes."""
        if fields is None:
            yield slice(None), self.source.sends
            return
        borders = [0, *(np.flatnonzero(np.diff(fields)) + 1).tolist(), len(fields)]
        for start, stop in itertools.pairwise(borders):
            sensed = int(fields[start])
            body = sum(1 << column for column, origin in enumerate(self._order.tolist()) if sensed >> origin & 1)
            axes = self.source.sends & Axis(body)
            if axes:
                yield slice(start, stop), axes
            else:
                self._refusals.add(Reject.STALE, f"{self.name}: fields_updated names no axis", stop - start)

    def _emit(self, t_ns: Ints, values: Floats, axes: Axis, received_host_ns: int) -> Iterator[ImuBatch | ClockRestart]:
        t_ns, values = self._plausible(t_ns, values, axes)
        if len(t_ns):
            yield from self.in_time(t_ns, values, axes, received_host_ns)

    def in_time(
        self, t_ns: Ints, values: Floats, axes: Axis, received_host_ns: int
    ) -> Iterator[ImuBatch | ClockRestart]:
        """Give the batches of samples, ``values`` (n, 6), in which nothing is odd but perhaps their time."""
        if self._wraps:
            t_ns = self._followed.unwrapped(t_ns, received_host_ns)
        verdict = self._reset_detector.check(self._followed, t_ns, received_host_ns)
        if verdict.keep is None:
            yield self._batch(t_ns, values, axes, received_host_ns)
            return
        if verdict.backward:
            self._refusals.add(Reject.TIME_BACKWARDS, self.name, verdict.backward)
        if verdict.ahead:
            self._refusals.add(Reject.INCONSISTENT, self.name + LEAPS, verdict.ahead)
        restart_at = verdict.restart_at
        cut = max(restart_at, 0)
        for epoch in (slice(0, cut), slice(cut, None)):
            if epoch.stop is None and restart_at >= 0:
                yield ClockRestart(self.source.clock, received_host_ns)
            keep = verdict.keep[epoch]
            if keep.any():
                yield self._batch(t_ns[epoch][keep], values[epoch][keep], axes, received_host_ns)

    def plain(self, run: SampleRun, received_host_ns: int) -> Iterable[ImuBatch | ClockRestart]:
        """As :meth:`in_time`, of a run; where time goes on, as it nearly always does, there is but one batch."""
        if self._reset_detector.onward(self._followed, run.oldest_ns, run.newest_ns, received_host_ns):
            return (self._batch(run.t_ns, run.values, run.source.sends, received_host_ns),)
        return self.in_time(run.t_ns, run.values, run.source.sends, received_host_ns)

    def _plausible(self, t_ns: Ints, values: Floats, axes: Axis) -> tuple[Ints, Floats]:
        """Zero the axes that are not sent; drop samples that are not finite, or stamped beyond any clock."""
        if axes != Axis.ALL:
            values = np.where(int(axes) >> _COLUMNS & 1, values, 0.0)
        if not math.isfinite(np.vdot(values, values)):  # a sum of squares is finite if and only if every number is
            good = np.isfinite(values).all(axis=1)
            self._refusals.add(Reject.NOT_FINITE, self.name, int((~good).sum()))
            t_ns, values = t_ns[good], values[good]
        if len(t_ns) and min(t_ns.tolist()) == _BEYOND_NS:
            good = t_ns != _BEYOND_NS
            self._refusals.add(Reject.INCONSISTENT, f"{self.name}: stamp beyond any clock", int((~good).sum()))
            t_ns, values = t_ns[good], values[good]
        return t_ns, values

    def _batch(self, t_ns: Ints, values: Floats, axes: Axis, received_host_ns: int) -> ImuBatch:
        source = self.source
        stamped = t_ns + source.stamp_offset_ns if source.stamp_offset_ns else t_ns
        return ImuBatch(source.station, source.clock, stamped, values, axes, received_host_ns)
