"""Gathers evidence: listens to a live vehicle as the service would, or reads a log."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from companion.adapters.mavlink.component.component import OnboardComponent
from companion.adapters.mavlink.component.parameter_server import ParameterServer
from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.decode.message_records import Heard, parameter_value
from companion.adapters.mavlink.link.dialect import mavlink
from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.link.signing import Signing
from companion.adapters.mavlink.link.udp import buffer_shortfall
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.adapters.recordings.logs.onboard_log import OnboardLog
from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.adapters.recordings.recording import Recording
from companion.core.clock.bank import ClockBank
from companion.doctor.evidence import Beat, Evidence
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.params.vehicle import VEHICLE_PARAMETERS
from companion.ports import Clock
from companion.records import (
    AutopilotParameter,
    ClockName,
    ClockRestart,
    ImuBatch,
    Ints,
    MatchSet,
    RawChunk,
    Record,
    Reject,
    Rejected,
    Shot,
    Station,
    TimesyncReply,
)

SETTLE_SHARE = 0.4  # of the time given, for rates that were just asked for (choice)


class Examination:
    """A live vehicle, listened to for a while. ``run_once`` does one pass, so that tests can step it by hand.

    Rates are taken over the last 60 % of the time: the first part is spent on asking for them. ``each`` is shown
    every record, afterwards too. ``signing`` is that of the links, where they are signed.
    """

    def __init__(
        self,
        links: Sequence[Link],
        clock: Clock,
        airframe: Airframe,
        settings: Settings,
        seconds: float,
        each: Callable[[Record], None] | None = None,
        signing: Signing | None = None,
    ) -> None:
        self._each = each
        self.pilot = MavlinkAutopilot(
            links,
            airframe,
            settings,
            clock,
            listener=self._hear,
            component=OnboardComponent(ParameterServer(settings), signing=signing),
            needed=tuple(VEHICLE_PARAMETERS),
        )
        self._evidence = Evidence(airframe, settings, live=True, seconds=seconds)
        self._links = list(links)
        self._spelling = {link.number: link.spelling for link in links}
        self._clock = clock
        self._clocks = ClockBank()
        self._began_host_ns = clock.now_ns()
        self._counting_host_ns = self._began_host_ns + round(seconds * SETTLE_SHARE * 1e9)
        self._ends_host_ns = self._began_host_ns + round(seconds * 1e9)
        self._counts: dict[Station, int] = dict.fromkeys(Station, 0)

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self._clock.now_ns() >= self._ends_host_ns

    def run_once(self, timeout_s: float = 0.002) -> None:
        """Take in what has arrived, and let the adapter ask what it asks."""
        for record in self.pilot.poll(timeout_s):
            self._take(record)
            if self._each is not None:
                self._each(record)

    def evidence(self) -> Evidence:
        """Evidence gathered until now."""
        evidence, decoder = self._evidence, self.pilot.decoder
        now = self._clock.now_ns()
        evidence.seconds = (now - self._began_host_ns) / 1e9
        counted_s = (now - self._counting_host_ns) / 1e9
        evidence.system = decoder.system_id
        evidence.realtime = _may_be_realtime()
        has_udp = any(link.spelling.startswith("udp") for link in self._links)
        evidence.buffer_shortfall = buffer_shortfall() if has_udp else None
        evidence.twice = self.pilot.component.identity.foreign
        signing = self.pilot.component.signing
        evidence.refused = Counter() if signing is None else Counter(signing.refused)
        if counted_s > 0:
            evidence.rate_hz = {station: count / counted_s for station, count in self._counts.items() if count}
        for clock in {evidence.airframe.sensor(station).source.clock for station in Station} - {ClockName.HOST}:
            state = self._clocks.state(clock, now)
            if state.synced or clock in evidence.clocks:
                evidence.clocks[clock] = state
        counters = [decoder.counters(link.number) for link in self._links]
        evidence.frames = sum(entry.frames for entry in counters)
        evidence.crc_errors = sum(entry.crc_errors for entry in counters)
        evidence.skipped_bytes = sum(entry.skipped_bytes for entry in counters)
        for link in self._links:
            _, comma, baud = link.spelling.partition(",")
            if comma:
                evidence.serial_baud[link.spelling] = int(baud)
        return evidence

    def _take(self, record: Record) -> None:
        evidence = self._evidence
        if isinstance(record, ImuBatch):
            evidence.count_samples(record)
            if self._clock.now_ns() >= self._counting_host_ns:
                self._counts[record.station] += len(record.t_ns)
        elif isinstance(record, Rejected) and record.reason is Reject.FOREIGN_SOURCE:
            evidence.foreign_imu[record.what] += record.count
        else:
            _follow_time(evidence, self._clocks, record)

    def _hear(self, heard: Heard) -> None:
        if heard.name == "COMMAND_ACK" and heard.message.target_component == self._evidence.settings.component_id:
            self._evidence.acknowledged += 1
        if heard.system == self.pilot.decoder.system_id:
            self._evidence.link_components.setdefault(self._spelling[heard.link], set()).add(heard.component)
        note(self._evidence, heard, self.pilot.decoder.system_id)


def _may_be_realtime() -> bool:
    """Whether the trigger process would be granted SCHED_FIFO."""
    import resource  # not everywhere

    limit: int = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    return os.geteuid() == 0 or limit > 0 or limit == resource.RLIM_INFINITY


def note(evidence: Evidence, heard: Heard, system: int | None) -> None:
    """Keep what one rare message tells."""
    message, sender = heard.message, (heard.system, heard.component)
    if heard.name == "HEARTBEAT":
        count = evidence.beats[sender].count if sender in evidence.beats else 0
        evidence.beats[sender] = Beat(message.type, message.autopilot, count + 1)
    elif heard.system != system:
        return
    elif heard.name == "NAMED_VALUE_INT":
        key, newest = (heard.component, message.name), message.value
        before = evidence.node_counters.get(key, newest)
        # a node that nobody read has lost what its port could not hold; one that has started again counts from 0
        evidence.node_losses[key] += newest - before if newest >= before else newest
        evidence.node_counters[key] = newest
    elif heard.name == "DISTANCE_SENSOR":
        evidence.range_senders[(*sender, message.orientation)] += 1
    elif heard.component != mavlink.MAV_COMP_ID_AUTOPILOT1:
        return
    elif heard.name == "PARAM_VALUE":
        pilot = evidence.beats.get(sender)
        bytewise = pilot is not None and pilot.autopilot == mavlink.MAV_AUTOPILOT_PX4
        evidence.parameters[message.param_id] = parameter_value(message, bytewise=bytewise)
    elif heard.name == "VIBRATION":
        evidence.autopilot_clips.append(message.clipping_0 + message.clipping_1 + message.clipping_2)
    elif heard.name == "CAMERA_FEEDBACK":
        evidence.feedback.setdefault(message.cam_idx, set()).add(message.img_idx)


def read_log(recording: Recording, airframe: Airframe, settings: Settings) -> Evidence:
    """The evidence of a recording: ours, a tlog, a .BIN or a ULog.

    Raises
    ------
    RecordingError
        It cannot be read.
    """
    evidence = Evidence(airframe, settings, live=False, onboard=isinstance(recording, OnboardLog))
    decoder = Decoder(airframe, settings.component_id, settings.system_id)
    spans: dict[Station, _Span] = {}
    raw = isinstance(recording, TlogRecording)
    records = recording.chunks() if isinstance(recording, TlogRecording) else recording.records()
    chunks_ns: list[int] = []
    clocks = ClockBank()
    for record in records:
        decoded: list[Record] = [record]
        if isinstance(record, RawChunk):
            chunks_ns = [*chunks_ns[:1], record.received_host_ns]
            messages = decoder.decode(record)
            for heard in messages.heard:
                note(evidence, heard, decoder.system_id)
            raw, decoded = True, list(messages.records)
        elif raw and isinstance(record, ImuBatch | TimesyncReply | ClockRestart):
            continue  # decoded from the chunks already
        for entry in decoded:
            _count(evidence, spans, entry)
            _follow_time(evidence, clocks, entry)
    evidence.system = decoder.system_id
    evidence.seconds = (chunks_ns[-1] - chunks_ns[0]) / 1e9 if chunks_ns else 0.0
    evidence.rate_hz = {
        station: span.steps * 1e9 / span.duration_ns for station, span in spans.items() if span.duration_ns
    }
    return evidence


class _Span(NamedTuple):
    """Steps of a station's stamps and the time that they took; a step back, of a clock that began anew, is none."""

    steps: int = 0
    duration_ns: int = 0
    last_ns: int | None = None

    def extended(self, t_ns: Ints) -> _Span:
        """The span with further stamps (n,)."""
        first, last = int(t_ns[0]), int(t_ns[-1])
        if self.last_ns is None or first <= self.last_ns:
            return _Span(self.steps + len(t_ns) - 1, self.duration_ns + last - first, last)
        return _Span(self.steps + len(t_ns), self.duration_ns + last - self.last_ns, last)


def _count(evidence: Evidence, spans: dict[Station, _Span], record: Record) -> None:
    evidence.plan_outcomes.take(record)
    if isinstance(record, ImuBatch) and len(record.t_ns):
        evidence.count_samples(record)
        spans[record.station] = spans.get(record.station, _Span()).extended(record.t_ns)
    elif isinstance(record, AutopilotParameter):
        evidence.parameters[record.name] = record.value
    elif isinstance(record, Shot):
        evidence.shots += 1
    elif isinstance(record, MatchSet):
        evidence.pairs += 1
    elif isinstance(record, Rejected) and record.reason is Reject.UNPAIRED:
        evidence.unpaired += record.count
    elif isinstance(record, Rejected) and record.reason is Reject.FRAME_LOST:
        evidence.lost += record.count


def _follow_time(evidence: Evidence, clocks: ClockBank, record: Record) -> None:
    if isinstance(record, TimesyncReply):
        evidence.clocks[record.clock] = clocks.exchange(record)
    elif isinstance(record, ClockRestart):
        clocks.restart(record)
