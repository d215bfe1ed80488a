"""A defect costs a record and a few seconds, not the process: what raises in the pipeline is refused, counted, told.

Live service and replay both go through :func:`contained`, so that the replay of a recording repeats the refusal. Tests
drive ``step`` itself, where a defect still raises.

A handler that stopped half-way may leave anything half done. The estimation begins anew: tracker, planner, correction
and samples that wait. It cannot be told which of them the defect has touched, and a tracker of mixed states would give
ranges that look sound; ten seconds of learning are the smaller harm. The clocks begin anew too where the record was
about them. Airframe, settings, what the vehicle told of itself and the counters stay: they are replaced whole.
"""

from __future__ import annotations

from companion.core.pipeline import PipelineState, start, step
from companion.errors import described
from companion.records import (
    ClockRestart,
    Health,
    Notice,
    OutputRecord,
    Record,
    Reject,
    Rejected,
    ServiceStatus,
    Tick,
    TimesyncReply,
)
from companion.units import Severity

_PERIOD_NS = 1_000_000_000  # the heartbeat's (convention)
_ABOUT_CLOCKS = (TimesyncReply, ClockRestart)


def contained(state: PipelineState, record: Record) -> tuple[PipelineState, list[OutputRecord]]:
    """As :func:`companion.core.pipeline.step`; a record whose handler raises is refused, and the estimation restarted.

    The sentence and, where ticks raise, the status (CRITICAL, for no tick gives one) come at most once a second.
    """
    if isinstance(record, Tick):
        state.now_ns = record.now_host_ns
    try:
        return step(state, record)
    except Exception as error:  # whatever it is: the next record must find a process
        return _refused(state, record, error)


def _refused(state: PipelineState, record: Record, error: Exception) -> tuple[PipelineState, list[OutputRecord]]:
    name = type(record).__name__
    fresh = _anew(state, clocks=isinstance(record, _ABOUT_CLOCKS))
    fresh.counters[str(Reject.INTERNAL_ERROR)] += 1
    outputs: list[OutputRecord] = [Rejected(Reject.INTERNAL_ERROR, name, state.now_ns)]
    if state.errors.take(state.now_ns):
        text = f"internal error: {name} refused, estimation restarted: {described(error)}"
        counters = dict(sorted(fresh.counters.items()))
        status = ServiceStatus(state.now_ns, Health.CRITICAL, str(Reject.INTERNAL_ERROR), counters)
        outputs.append(Notice(Severity.ERROR, text, state.now_ns))
        if isinstance(record, Tick):
            outputs.append(status)
            fresh.next_status_ns = state.now_ns + 2 * _PERIOD_NS  # where ticks go on raising, no other comes between
    return fresh, outputs


def _anew(state: PipelineState, *, clocks: bool) -> PipelineState:
    fresh = start(state.airframe, state.settings, state.hub, None if clocks else state.clocks)
    # the airframe has named effects as plain values already, from which the corrections cannot be told again
    fresh.corrections, fresh.filters, fresh.vehicle = state.corrections, state.filters, state.vehicle
    fresh.counters, fresh.airborne_ns = state.counters, state.airborne_ns
    fresh.now_ns, fresh.errors = state.now_ns, state.errors
    fresh.next_track_ns, fresh.next_status_ns = state.next_track_ns, state.next_status_ns
    return fresh
