"""The one path that the live service, replay and the tests all drive: ``step(state, record) -> (state, records)``.

Inputs go in in arrival order; everything that happens on time happens on a :class:`~companion.records.Tick`, so that
the replay of a recording repeats every output exactly. The state belongs to the caller and is updated in place.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.core.clock.motion_alignment import SIGMAS, lowpass_delay_s
from companion.core.pipeline_state import PipelineState, start
from companion.core.pipeline_status import status, tracked, unlearned, unsynced_clocks
from companion.core.silence import TELLING
from companion.core.stereo.consistency_gate import RANGE_MEMORY_NS
from companion.core.stereo.vehicle_motion import velocity_of
from companion.core.stereo.vision import VisionState, vision_step
from companion.core.tracking.streams import within_range
from companion.core.tracking.tracker import WingTracker
from companion.core.trigger.blur import GroundMotion
from companion.errors import ConfigError
from companion.params.airframe import Airframe
from companion.params.vehicle import implausible
from companion.records import (
    AutopilotParameter,
    Axis,
    CameraFeedback,
    ClockName,
    ClockRestart,
    ImuBatch,
    MatchSet,
    Notice,
    OutputRecord,
    ParameterChange,
    Record,
    Reject,
    Rejected,
    Shot,
    Station,
    Tick,
    TimesyncReply,
    VehicleState,
)
from companion.units import Severity

__all__ = ["PipelineState", "VisionState", "start", "step", "vision_step"]

_STATUS_PERIOD_NS = 1_000_000_000  # MAVLink's heartbeat
_TRACK_PERIOD_NS = 40_000_000  # the planner's: it asks for the newest state, and nobody else for one between (derived)
# two seconds: a 3 Hz wing of 3 % damping has lost two thirds of what the wheels and the rotation shook it by (derived)
_LIFT_OFF_NS = 2_000_000_000
_BY_PIN = "exposures stamped by the autopilot"
_SAMPLES = {station: f"samples {station.name.lower()}" for station in Station}  # names of counters


def step(state: PipelineState, record: Record) -> tuple[PipelineState, list[OutputRecord]]:
    """Handle one input record; give the records that follow from it, in order."""
    handler = _HANDLERS.get(type(record))
    if handler is None:
        return state, []
    outputs = handler(state, record)
    if type(record) in TELLING:
        state.silence.note(record)
    for output in outputs:
        state.silence.note(output)
        if isinstance(output, Rejected):
            state.counters[str(output.reason)] += output.count
    return state, outputs


# ------------------------------------------------------------------------------------------------ inputs


def _on_samples(state: PipelineState, batch: ImuBatch) -> list[OutputRecord]:
    """Samples wait for the next turn of the tracker: one conversion for many costs little per sample."""
    if len(batch.t_ns):
        state.waiting.setdefault(batch.station, []).append(batch)
    return []


def _take_samples(state: PipelineState) -> list[OutputRecord]:
    refused: list[OutputRecord] = []
    for batches in state.waiting.values():
        for batch in joined(batches):
            state.rate_monitor.note(batch)
            state.counters[_SAMPLES[batch.station]] += len(batch.t_ns)
            now_refused = _track(state, batch)
            late = sum(each.count for each in now_refused if each.reason is Reject.TOO_LATE)
            state.rate_monitor.note_late(batch.station, len(batch.t_ns), late)
            refused += now_refused
    state.waiting.clear()
    return refused


def _adapt_to_delivery(state: PipelineState, now_ns: int) -> list[OutputRecord]:
    """Take the rates that really come for those that the airframe file believes."""
    said: list[OutputRecord] = []
    airframe = state.airframe
    for station, rate_hz in state.rate_monitor.changed(airframe):
        name, sensor = station.name.lower(), airframe.sensor(station)
        changed: dict[str, Any] = {name: dataclasses.replace(sensor, rate_hz=rate_hz)}
        airframe = dataclasses.replace(airframe, **changed)
        text = f"{name} comes at {rate_hz:.0f} Hz, not {sensor.rate_hz:.0f}: tracker restarted"
        said.append(Notice(Severity.WARNING, text, now_ns))
    if said:
        _rebuild(state, airframe)
    return said


def _rebuild(state: PipelineState, airframe: Airframe) -> None:
    """Start the tracker with another airframe; one that no tracker can be built for does not stay."""
    state.tracker, state.validity = WingTracker(airframe, state.settings), None
    state.airframe = airframe


def _track(state: PipelineState, batch: ImuBatch) -> list[Rejected]:
    batch, refused = within_range(batch, state.airframe.sensor(batch.station))
    if not len(batch.t_ns):
        return refused
    batch = state.corrections.corrected(state.filters.undone(batch))
    state.unsynced_nodes.note(batch, state.airframe.sensor(batch.station), state.airframe.root)
    if batch.clock is not ClockName.HOST:
        converted = state.clocks.to_host(batch.clock, batch.t_ns, batch.received_host_ns)
        if isinstance(converted, Reject):
            what = f"{batch.station.name.lower()} samples"
            return [*refused, Rejected(converted, what, batch.received_host_ns, len(batch.t_ns))]
        clock, t_ns = ClockName.HOST, converted[0]
        batch = ImuBatch(batch.station, clock, t_ns, batch.values, batch.axes, batch.received_host_ns)
    if batch.station is Station.ROOT:
        state.unsynced_nodes.note_root(batch)
        if state.correction is not None and batch.axes & Axis.GYRO == Axis.GYRO:
            # a turn between two exposures lasts far longer than the filter's delay varies
            delay_ns = round(1e9 * lowpass_delay_s(state.airframe.root.lowpass_gyro_hz))
            state.correction.turns.add(batch.t_ns - delay_ns, batch.values[:, 3:])
    return [*refused, *state.tracker.add(batch)]


def _align(state: PipelineState, now_ns: int) -> list[OutputRecord]:
    """Clock exchanges from the motion of nodes that answer no TIMESYNC."""
    said: list[OutputRecord] = []
    for exchange in state.unsynced_nodes.exchanges(now_ns, state.clocks):
        clock, restarts = exchange.clock, state.clocks.restarts(exchange.clock)
        before = clock in state.unsynced_nodes.aligned and state.clocks.state(clock).synced
        after = state.clocks.exchange(exchange)
        if state.clocks.restarts(clock) != restarts:
            state.tracker.clock_restarted(_tips_on_clock(state.airframe, clock))
        if after.synced and not before:
            said += [after, *_adopt_alignment(state, clock, now_ns)]
    return said


def _adopt_alignment(state: PipelineState, clock: ClockName, now_ns: int) -> list[OutputRecord]:
    """The tracker learns how well the node's time is known; the node joins only now."""
    sigma_s = state.clocks.state(clock).bound_ns * 1e-9 / SIGMAS
    for name in ("left", "right"):
        sensor = getattr(state.airframe, name)
        if sensor.source.clock is clock and sensor.time_offset_sigma_s < sigma_s:
            changed: dict[str, Any] = {name: dataclasses.replace(sensor, time_offset_sigma_s=sigma_s)}
            _rebuild(state, dataclasses.replace(state.airframe, **changed))
    text = f"{clock} answers no TIMESYNC: aligned by motion, sigma {1e3 * sigma_s:.1f} ms"
    return [Notice(Severity.WARNING, text, now_ns)]


def joined(batches: list[ImuBatch]) -> list[ImuBatch]:
    """Consecutive batches of one station as few as possible: what has the same clock and axes becomes one."""
    before = batches[0]
    runs = [[before]]
    for batch in batches[1:]:
        if batch.clock is before.clock and batch.axes == before.axes:
            runs[-1].append(batch)
        else:
            runs.append([batch])
            before = batch
    return [run[0] if len(run) == 1 else _together(run) for run in runs]


def _together(run: list[ImuBatch]) -> ImuBatch:
    t_ns = np.concatenate([batch.t_ns for batch in run])
    values = np.concatenate([batch.values for batch in run])
    last = run[-1]
    return ImuBatch(last.station, last.clock, t_ns, values, last.axes, last.received_host_ns)


def _on_timesync(state: PipelineState, reply: TimesyncReply) -> list[OutputRecord]:
    state.unsynced_nodes.answered(reply.clock, reply.received_host_ns)
    before, restarts = state.clocks.synced(reply.clock), state.clocks.restarts(reply.clock)
    after = state.clocks.exchange(reply)
    if state.clocks.restarts(reply.clock) != restarts:  # nothing announced it: the exchanges show it
        state.tracker.clock_restarted(_tips_on_clock(state.airframe, reply.clock))
    return [after] if after.synced != before else []


def _on_restart(state: PipelineState, restart: ClockRestart) -> list[OutputRecord]:
    state.clocks.restart(restart)
    state.unsynced_nodes.restarted(restart.clock)
    state.tracker.clock_restarted(_tips_on_clock(state.airframe, restart.clock))
    return [Notice(Severity.WARNING, f"{restart.clock} clock restarted; waiting for sync", restart.seen_host_ns)]


def _tips_on_clock(airframe: Airframe, clock: ClockName) -> list[Station]:
    """The tips whose stamps, relative to the fuselage's, hang on this clock."""
    root = airframe.root.source.clock
    tips = [station for station in Station if station is not Station.ROOT]
    clocks = {station: airframe.sensor(station).source.clock for station in tips}
    return [station for station in tips if clocks[station] is not root and clock in (clocks[station], root)]


def _on_vehicle(state: PipelineState, vehicle: VehicleState) -> list[OutputRecord]:
    if state.on_ground and vehicle.on_ground is False:
        state.tracker.lifted_off()
        state.airborne_ns = vehicle.received_host_ns + _LIFT_OFF_NS
    state.vehicle = vehicle
    if vehicle.on_ground is not None:
        state.on_ground = vehicle.on_ground
    if state.correction is not None:
        state.correction.vehicle.add(vehicle)
    return []


def _on_autopilot_parameter(state: PipelineState, parameter: AutopilotParameter) -> list[OutputRecord]:
    """The autopilot's filters are its own affair: take what it says over what the airframe file believes."""
    filters, at_ns = state.filters, parameter.received_host_ns
    why = implausible(parameter.name, parameter.value)
    fresh = filters.note_refusal(parameter.name, why)
    if why is not None:
        refused = Rejected(Reject.IMPLAUSIBLE, f"parameter {parameter.name}", at_ns)
        return [refused, Notice(Severity.WARNING, why, at_ns)] if fresh else [refused]
    before = (filters.gyro_delay_s, filters.stamp_shift_ns)
    if not filters.take(parameter.name, parameter.value):
        return []
    airframe = filters.applied(state.airframe)
    said: list[OutputRecord] = []
    if airframe != state.airframe:
        _rebuild(state, airframe)
        text = f"{parameter.name} is {parameter.value:g} Hz on the vehicle: tracker restarted with it"
        said.append(Notice(Severity.WARNING, text, at_ns))
    if (filters.gyro_delay_s, filters.stamp_shift_ns) != before:
        delays_ms = f"rates {1e3 * filters.gyro_delay_s:.2f} ms, stamps {1e-6 * filters.stamp_shift_ns:+.2f} ms"
        text = f"{parameter.name} {parameter.value:g}: undone ({delays_ms})"
        said.append(Notice(Severity.INFO, text, at_ns))
    return said


def _on_change(state: PipelineState, change: ParameterChange) -> list[OutputRecord]:
    try:
        state.settings = state.settings.replace(change.name, change.value, flown=True)
    except ConfigError as error:  # of a damaged recording; live, the parameter server has checked it
        refused = Rejected(Reject.INCONSISTENT, f"parameter {change.name}", change.changed_host_ns)
        return [refused, Notice(Severity.WARNING, f"{error}: not used", change.changed_host_ns)]
    state.tracker.adopt(state.settings)
    if state.scheduling is not None:
        state.scheduling.adopt(state.settings)
    if state.correction is not None:
        state.correction.settings = state.settings
    return []


def _on_matches(state: PipelineState, matches: MatchSet) -> list[OutputRecord]:
    if state.correction is None:
        return []
    matches, by_pin, sigma_s = state.feedback.stamped(matches)
    said: list[OutputRecord] = []
    if by_pin:
        if not state.counters[_BY_PIN]:
            said.append(Notice(Severity.INFO, f"{_BY_PIN}: its hot-shoe pin tells them best", matches.matched_host_ns))
        state.counters[_BY_PIN] += by_pin
    stamps = state.scheduling.exposed(matches, sigma_s) if state.scheduling is not None else None
    return [*said, *state.correction.add(matches, stamps, sigma_s)]


def _on_feedback(state: PipelineState, feedback: CameraFeedback) -> list[OutputRecord]:
    refused = state.feedback.edge(feedback)
    return [] if refused is None else [Rejected(refused, "camera feedback", feedback.received_host_ns)]


def _on_rejected(state: PipelineState, rejected: Rejected) -> list[OutputRecord]:
    """A refusal made before the pipeline (decoder, vision, trigger process) is counted with the others."""
    state.counters[str(rejected.reason)] += rejected.count
    return []


def _on_shot(state: PipelineState, shot: Shot) -> list[OutputRecord]:
    if state.scheduling is not None:
        state.scheduling.fired(shot)
    state.feedback.shot(shot)
    state.counters["shots"] += 1
    return []


# ------------------------------------------------------------------------------------------------ time


def _on_tick(state: PipelineState, tick: Tick) -> list[OutputRecord]:
    now_ns = tick.now_host_ns
    outputs: list[OutputRecord] = []
    if now_ns >= state.next_track_ns:
        state.next_track_ns = now_ns + _TRACK_PERIOD_NS
        if state.airborne_ns is not None and now_ns >= state.airborne_ns:
            state.tracker.lifted_off()
            state.airborne_ns = None
        outputs += _take_samples(state)
        outputs += [*_adapt_to_delivery(state, now_ns), *_align(state, now_ns)]
        state.validity = state.tracker.process_until(now_ns) or state.validity
    else:
        state.tracker.work()
    if state.scheduling is not None and now_ns >= state.scheduling.next_plan_ns:
        outputs += state.scheduling.tick(state.tracker, state.validity, _motion(state, now_ns), now_ns)
    if state.correction is not None:
        outputs += state.correction.due(state.tracker, now_ns)
    synced = state.validity is not None or not unsynced_clocks(state, now_ns)
    outputs += state.output_scheduler.tick(
        now_ns, outputs, state.tracker.describe, state.validity, state.settings, synced=synced
    )
    if state.correction is not None and state.validity is not None:
        state.silence.tick(now_ns, usable=tracked(state) and unlearned(state) is None)
    if now_ns >= state.next_status_ns:
        state.next_status_ns = now_ns + _STATUS_PERIOD_NS
        outputs += status(state, now_ns)
    return outputs


def _motion(state: PipelineState, now_ns: int) -> GroundMotion:
    """Ground speed smears a downward view by its share of the range; what is unknown counts as still and far.

    So does a range of some time ago: after a go-around one of 10 m would forbid every shot, and with it a newer range.
    """
    measured = state.correction.last_trusted if state.correction else None
    if state.vehicle is None or measured is None or now_ns - measured.t_host_ns > RANGE_MEMORY_NS:
        return GroundMotion()
    return GroundMotion(velocity_of(state.vehicle), measured.range_m)


_Handler = Callable[[PipelineState, Any], list[OutputRecord]]
_HANDLERS: dict[type, _Handler] = {
    ImuBatch: _on_samples,
    TimesyncReply: _on_timesync,
    ClockRestart: _on_restart,
    VehicleState: _on_vehicle,
    AutopilotParameter: _on_autopilot_parameter,
    ParameterChange: _on_change,
    MatchSet: _on_matches,
    Shot: _on_shot,
    CameraFeedback: _on_feedback,
    Rejected: _on_rejected,
    Tick: _on_tick,
}
