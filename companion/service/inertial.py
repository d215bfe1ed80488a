"""The inertial process: link, clock, tracker, planner, correction, heartbeat. The one that must never stall."""

from __future__ import annotations

import dataclasses
import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from companion.core.containment import contained
from companion.core.pipeline import PipelineState
from companion.errors import described
from companion.lifetime import StopFlag
from companion.ports import Autopilot, Clock, Recorder
from companion.rate_limiter import RateLimiter
from companion.records import (
    CorrectedRange,
    ModeState,
    NoRange,
    Notice,
    ParameterChange,
    Record,
    Reject,
    Rejected,
    ServiceStatus,
    Shot,
    Tick,
    TriggerLatency,
    TriggerPlan,
)
from companion.service.pace import WINDOW_NS, Overload, TickPace
from companion.service.parameter_request import ParameterRequest
from companion.units import Severity

TICK_NS = 10_000_000  # chosen: a hundred turns a second, four for each plan
_POLL_S = 0.002  # chosen: samples wait no longer than this, and the turn is never late by more
_SECOND_NS = 1_000_000_000  # by definition
_OVERLOADED_NS = 5 * WINDOW_NS  # chosen: an overload that is repeated no more was that of a process that is no more
_SHOWN = (CorrectedRange, ModeState, Notice, ServiceStatus, TriggerPlan, NoRange, TriggerLatency)
_UNFIRED = (Reject.PLAN_EXPIRED, Reject.DEVICE_FAILED)


class ShotPort(Protocol):
    """The inertial side of the trigger process."""

    def send(self, plan: TriggerPlan) -> None:
        """Hand over the newest plan."""
        ...

    def poll(self) -> list[Shot | Rejected]:
        """Shots made since the last call."""
        ...

    def warnings(self) -> list[str]:
        """Sentences for the operator since the last call."""
        ...


@dataclass(slots=True)
class InertialLoop:
    """One turn reads, estimates, publishes. Kept apart from its process so that tests can turn it by hand.

    ``fires_by_link`` says that the trigger process only keeps the time and the autopilot fires: each shot is published
    at once, before anything is made of it. ``tell_vision`` gets changed settings and plans. ``alive`` gets the time of
    each tick and the state in words: what watches over the process hears from its loop or not at all.
    """

    state: PipelineState
    autopilot: Autopilot
    clock: Clock
    shots: ShotPort
    inbox: Callable[[], Sequence[Record | Overload | ParameterRequest]]
    show: Callable[[Record], object]
    recorder: Recorder
    fires_by_link: bool = False
    tell_vision: Callable[[Record], object] = lambda _: None
    alive: Callable[[int, str], object] = lambda _now_ns, _status: None
    status: str = ""
    next_tick_ns: int = 0
    errors: RateLimiter = field(default_factory=lambda: RateLimiter(_SECOND_NS))
    pace: TickPace = field(default_factory=TickPace)
    overloads: dict[str, tuple[str, int]] = field(default_factory=dict)

    def run_once(self) -> None:
        """Handle what has arrived, then the tick if it is due."""
        for record in self.autopilot.poll(_POLL_S):
            self._handle(record)
        for shot in self.shots.poll():
            if self.fires_by_link and isinstance(shot, Shot):
                self.autopilot.publish(shot)
            self._handle(shot)
        for said in self.inbox():
            if isinstance(said, Overload):
                self._overloaded(said)
            elif isinstance(said, ParameterRequest):
                self.autopilot.set_own_parameter(said.name, said.value)
            else:
                self._handle(said)
        now_ns = self.clock.now_ns()
        for sentence in self.shots.warnings():
            self._route(Notice(Severity.WARNING, sentence, now_ns))
        if now_ns >= self.next_tick_ns:
            self.next_tick_ns = max(self.next_tick_ns + TICK_NS, now_ns)
            self._handle(Tick(now_ns))
            self.alive(now_ns, self.status)
            if (overload := self.pace.ticked(now_ns)) is not None:
                self._overloaded(overload)

    def _overloaded(self, overload: Overload) -> None:
        """Say who cannot keep up, or does again, and let the state's reason say it as long as that lasts."""
        is_known = self.overloads.pop(overload.who, None) is not None
        if overload.text:
            self.overloads[overload.who] = overload.text, self.clock.now_ns()
            if is_known:
                return
        severity = Severity.WARNING if overload.text else Severity.INFO
        self._route(Notice(severity, overload.sentence, self.clock.now_ns()))

    def _overload_texts(self) -> list[str]:
        """Overloads that were repeated lately; the others are forgotten."""
        oldest_ns = self.clock.now_ns() - _OVERLOADED_NS
        self.overloads = {who: said for who, said in self.overloads.items() if said[1] >= oldest_ns}
        return [text for text, _ in self.overloads.values()]

    def _handle(self, record: Record) -> None:
        if isinstance(record, Notice):  # the adapter's own words, for the operator and not for the estimation
            self._route(record)
            return
        self.recorder.write(record)
        if isinstance(record, ParameterChange):
            self.tell_vision(record)
        if isinstance(record, Shot) or (isinstance(record, Rejected) and record.reason in _UNFIRED):
            self.show(record)
        self.state, outputs = contained(self.state, record)
        for output in outputs:
            self._route(output)

    def _route(self, output: Record) -> None:
        self.recorder.write(output)
        # the machine's, not the estimation's: a replay has none
        if isinstance(output, ServiceStatus) and (texts := self._overload_texts()):
            reason = "; ".join([output.reason, *(f"cannot keep up: {text}" for text in texts)])
            output = dataclasses.replace(output, reason=reason)
        if isinstance(output, ServiceStatus):
            self.status = f"{output.health.name.lower()}: {output.reason}"
        if isinstance(output, TriggerPlan):
            self.shots.send(output)
            self.tell_vision(output)
        self._publish(output)
        if isinstance(output, _SHOWN):
            self.show(output)

    def _publish(self, output: Record) -> None:
        """Send it; what cannot be sent is said, at most once a second, and the next goes out."""
        try:
            self.autopilot.publish(output)
        except Exception as error:  # whatever it is: the wing is tracked on
            now_ns = self.clock.now_ns()
            if self.errors.take(now_ns):
                name = type(output).__name__
                text = f"internal error: {name} not sent: {described(error)}"
                self._route(Notice(Severity.ERROR, text, now_ns))


def run(loop: InertialLoop, stop: StopFlag) -> None:
    """Turn until told to stop; collection pauses are taken before the flight, not in it."""
    gc.collect()
    gc.freeze()
    try:
        while not stop.is_set():
            loop.run_once()
    finally:
        loop.autopilot.close()
        loop.recorder.close()
