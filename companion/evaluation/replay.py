"""Drive the pipeline with a recording, as the live service drove it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.core.containment import contained
from companion.core.pipeline import PipelineState, start
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import (
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

TICK_NS = 10_000_000
_LONGEST_LEAP_NS = 3_600_000_000_000
_LONGEST_GAP_NS = 30_000_000_000  # no ticks beyond: one damaged stamp may be ages ahead
_OWN_INPUTS = (RawChunk, MatchSet, Shot, Tick, ParameterChange)
_DEVICES_REFUSALS = (Reject.DEVICE_FAILED, Reject.PLAN_EXPIRED, Reject.UNPAIRED, Reject.FRAME_LOST)
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
    newest_ns: int | None = None
    for record in records:
        if not isinstance(record, ImuBatch | VehicleState | Rejected):
            continue
        if isinstance(record, ImuBatch):
            record, ahead = _without_leaps(record, newest_ns)
            if ahead:
                yield Rejected(
                    Reject.TIME_BACKWARDS, f"{record.station.name.lower()}: an hour ahead", newest_ns or 0, ahead
                )
            if not record.t_ns.size:
                continue
            newest_ns = max(newest_ns or 0, record.received_host_ns)
            now_ns = record.received_host_ns
            if next_tick_ns is None or now_ns - next_tick_ns > _LONGEST_GAP_NS:
                next_tick_ns = now_ns
            while next_tick_ns <= now_ns:
                yield Tick(next_tick_ns)
                next_tick_ns += TICK_NS
        yield record


def _without_leaps(batch: ImuBatch, newest_ns: int | None) -> tuple[ImuBatch, int]:
    """The samples that are not an hour or more ahead of the newest before: damage, which would be flown through."""
    limit_ns = int(batch.t_ns[0] if newest_ns is None else newest_ns) + _LONGEST_LEAP_NS if batch.t_ns.size else 0
    good = batch.t_ns <= limit_ns
    if good.all() and batch.received_host_ns <= limit_ns:
        return batch, 0
    t_ns = batch.t_ns[good]
    arrived_ns = min(batch.received_host_ns, int(t_ns.max())) if t_ns.size else batch.received_host_ns
    kept = dataclasses.replace(batch, t_ns=t_ns, values=batch.values[good], received_host_ns=arrived_ns)
    return kept, int(batch.t_ns.size - t_ns.size)


def drive(
    inputs: Iterable[Record],
    airframe: Airframe,
    settings: Settings,
    hub: ClockName | None,
    each: Callable[[PipelineState, Record], None] | None = None,
) -> Iterator[Record]:
    """Step through the inputs; yield every output. ``each`` sees the state after each input."""
    state = start(airframe, settings, hub)
    for record in inputs:
        state, outputs = contained(state, record)
        yield from outputs
        if each is not None:
            each(state, record)
