"""Drive the pipeline with a recording, as the live service drove it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.core.containment import contained
from companion.core.pipeline import start
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import (
    Bools,
    ClockName,
    ImuBatch,
    MatchSet,
    ParameterChange,
    RawChunk,
    Record,
    Reject,
    Rejected,
    Shot,
    Tick,
    VehicleState,
)

TICK_NS = 10_000_000  # convention: the live service's (service/inertial.py)
_LONGEST_LEAP_NS = 3_600_000_000_000  # chosen: an hour: a clock that leaps further is damaged, or it was another flight
_RESUMED_SAMPLES = 50  # that go on from each other behind a leap: a pause of the logger, not damage (choice)
_RESUMED_NS = 500_000_000  # chosen: over so long a time at least: a burst is no stream
_RESUMED_STEP_NS = 1_000_000_000  # and in steps of so much at most (choice)
_LONGEST_GAP_NS = 30_000_000_000  # no ticks beyond: one damaged stamp may be ages ahead (choice)
_OWN_INPUTS = (RawChunk, MatchSet, Shot, Tick, ParameterChange)
_LOGGED = (ImuBatch, VehicleState, Rejected)
_DEVICES_REFUSALS = (Reject.DEVICE_FAILED, Reject.PLAN_EXPIRED, Reject.UNPAIRED, Reject.FRAME_LOST, Reject.FROZEN)
"""Made by the trigger and vision processes alone, so they come in; all others are made again by the replay."""


def own_inputs(records: Iterable[Record], airframe: Airframe, settings: Settings) -> Iterator[Record]:
    """The inputs of one of our own recordings, raw bytes decoded again, everything that was derived left out."""
    decoder = Decoder(airframe, settings.component_id, settings.system_id)
    for record in records:
        if isinstance(record, _OWN_INPUTS) or (isinstance(record, Rejected) and record.reason in _DEVICES_REFUSALS):
            yield record
        if isinstance(record, RawChunk):
            yield from decoder.decode_chunk(record)


def foreign_inputs(records: Iterable[Record]) -> Iterator[Record]:
    """The inputs of a log that knows nothing of us: samples and flight state, with ticks put between them."""
    next_tick_ns: int | None = None
    for record in _without_leaps(record for record in records if isinstance(record, _LOGGED)):
        if isinstance(record, ImuBatch):
            now_ns = record.received_host_ns
            if next_tick_ns is None or now_ns - next_tick_ns > _LONGEST_GAP_NS:
                next_tick_ns = now_ns
            while next_tick_ns <= now_ns:
                yield Tick(next_tick_ns)
                next_tick_ns += TICK_NS
        yield record


def _without_leaps(records: Iterable[Record]) -> Iterator[Record]:
    """The same records without samples of damaged stamps, an hour or more ahead, which would be flown through.

    A logger that paused for hours leaps as well. Samples that are ahead wait, and what comes behind them; they are
    believed as soon as enough of them go on from each other, and refused where the time before goes on.
    """
    newest_ns: int | None = None
    waiting = _Waiting()
    for record in records:
        if not isinstance(record, ImuBatch):
            if waiting.batches:
                waiting.records.append(record)
            else:
                yield record
            continue
        if not record.t_ns.size:
            continue
        good, ahead = _split(record, int(record.t_ns[0]) if newest_ns is None else newest_ns)
        if good is not None:
            yield from waiting.refused(newest_ns or 0)
            newest_ns = max(newest_ns or 0, good.received_host_ns)
            yield good
        if ahead is not None:
            yield from waiting.add(ahead, newest_ns or 0)
            if waiting.agree:
                yield from waiting.records
                newest_ns, waiting = waiting.newest_ns, _Waiting()
    yield from waiting.refused(newest_ns or 0)


@dataclass(slots=True)
class _Waiting:
    """Records from the first sample on that was an hour or more ahead."""

    records: list[Record] = field(default_factory=list)
    batches: int = 0
    samples: int = 0
    oldest_ns: int = 0
    newest_ns: int = 0

    @property
    def agree(self) -> bool:
        """Whether these are too many, over too long a time, for damage."""
        return self.samples >= _RESUMED_SAMPLES and self.newest_ns - self.oldest_ns >= _RESUMED_NS

    def add(self, batch: ImuBatch, now_ns: int) -> Iterator[Record]:
        """Hold a batch back; those before are refused where it does not go on from them, it too if it leaps itself."""
        steps_ns = np.abs(np.diff(batch.t_ns, prepend=[self.newest_ns] if self.batches else batch.t_ns[:1]))
        if steps_ns[0] > _RESUMED_STEP_NS:
            yield from self.refused(now_ns)
        self.oldest_ns = min(self.oldest_ns or int(batch.t_ns[0]), int(batch.t_ns.min()))
        self.newest_ns = max(self.newest_ns, int(batch.t_ns.max()))
        self.records.append(batch)
        self.batches += 1
        self.samples += batch.t_ns.size
        if (steps_ns[1:] > _RESUMED_STEP_NS).any():
            yield from self.refused(now_ns)

    def refused(self, now_ns: int) -> Iterator[Record]:
        """Give what waited without its samples, and forget it."""
        for record in self.records:
            if isinstance(record, ImuBatch):
                name = record.station.name.lower()
                yield Rejected(Reject.TIME_BACKWARDS, f"{name}: an hour ahead", now_ns, record.t_ns.size)
            else:
                yield record
        self.records, self.batches, self.samples, self.oldest_ns, self.newest_ns = [], 0, 0, 0, 0


def _split(batch: ImuBatch, newest_ns: int) -> tuple[ImuBatch | None, ImuBatch | None]:
    """The samples of a batch that go on from the newest before, and those that are an hour or more ahead."""
    limit_ns = newest_ns + _LONGEST_LEAP_NS
    good = batch.t_ns <= limit_ns
    if good.all() and batch.received_host_ns <= limit_ns:
        return batch, None
    return _chosen(batch, good), _chosen(batch, ~good)


def _chosen(batch: ImuBatch, chosen: Bools) -> ImuBatch | None:
    if not chosen.any():
        return None
    t_ns = batch.t_ns[chosen]
    arrived_ns = min(batch.received_host_ns, int(t_ns.max()))
    if chosen.all() and arrived_ns == batch.received_host_ns:
        return batch
    return dataclasses.replace(batch, t_ns=t_ns, values=batch.values[chosen], received_host_ns=arrived_ns)


def drive(inputs: Iterable[Record], airframe: Airframe, settings: Settings, hub: ClockName | None) -> Iterator[Record]:
    """Step through the inputs; yield every output."""
    state = start(airframe, settings, hub)
    for record in inputs:
        state, outputs = contained(state, record)
        yield from outputs
