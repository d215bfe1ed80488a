"""Chunks of bytes in, records out: the one place where MAVLink's units become SI.

A decoder's state comes from the chunks it was given and from nothing else, so replaying the recorded chunks, in order,
gives the very same records. What we sent is recorded as chunks too, with ``link`` = :data:`OUTGOING` + link. Of these
only our TIMESYNC requests matter here, to know them when they are answered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np

from companion.adapters.mavlink.decode.bulk import BulkDecoder, SampleRun
from companion.adapters.mavlink.decode.counters import RefusalCounters
from companion.adapters.mavlink.decode.inertial import StationReader
from companion.adapters.mavlink.decode.layouts import LAYOUTS, TUNNEL_IMU_TYPE
from companion.adapters.mavlink.decode.message_records import Echo, Heard, Translator
from companion.adapters.mavlink.decode.source_map import build_mapping
from companion.adapters.mavlink.link.dialect import ID_OF, NAME_OF, build_message
from companion.adapters.mavlink.link.scan import Frame, ScanCounters, Scanner, sender
from companion.adapters.mavlink.vehicle.clock_reset_detector import ClockResetDetector
from companion.adapters.mavlink.vehicle.vehicle_choice import VehicleChoice
from companion.errors import described
from companion.params.airframe import Airframe
from companion.records import ClockRestart, ImuBatch, Notice, RawChunk, Record, Reject
from companion.units import Severity

OUTGOING = 128
"""Added to the link number of chunks that we sent (convention)."""

_RARE_NAMES = (
    "ATTITUDE",
    "AUTOPILOT_VERSION",
    "CAMERA_FEEDBACK",
    "COMMAND_ACK",
    "COMMAND_INT",
    "COMMAND_LONG",
    "DISTANCE_SENSOR",
    "EKF_STATUS_REPORT",
    "ESTIMATOR_STATUS",
    "EXTENDED_SYS_STATE",
    "FILE_TRANSFER_PROTOCOL",
    "GLOBAL_POSITION_INT",
    "GPS_RAW_INT",
    "HEARTBEAT",
    "MESSAGE_INTERVAL",
    "NAMED_VALUE_INT",
    "OBSTACLE_DISTANCE",
    "PARAM_REQUEST_LIST",
    "PARAM_REQUEST_READ",
    "PARAM_SET",
    "PARAM_VALUE",
    "RANGEFINDER",
    "STATUSTEXT",
    "SYSTEM_TIME",
    "TIMESYNC",
    "VFR_HUD",
    "VIBRATION",
)
RARE = frozenset(ID_OF[name] for name in _RARE_NAMES)
_TUNNEL = ID_OF["TUNNEL"]
_TUNNEL_KIND = TUNNEL_IMU_TYPE.to_bytes(2, "little")


@dataclass(slots=True)
class Decoded:
    """Content of one chunk: records for the pipeline, and rare messages for the adapter itself."""

    records: list[Record] = field(default_factory=list)
    heard: list[Heard] = field(default_factory=list)
    echoed: list[Echo] = field(default_factory=list)


class Decoder:
    """Decodes the chunks of all links of one vehicle.

    Parameters
    ----------
    airframe
        Its sources say which messages are mapped; see :func:`build_mapping` for the errors.
    component_id
        Our own component id; frames that carry it with the vehicle's system id are echoes of ours.
    system
        The vehicle's system id where it is configured; 0 for the autopilot that is there, before which samples of any
        system are read.
    """

    def __init__(self, airframe: Airframe, component_id: int, system: int = 0) -> None:
        self.mapping = build_mapping(airframe)
        self.refusals = RefusalCounters()
        self.delivered: dict[tuple[int, int], int] = {}
        self.echoes = 0
        self._component_id = component_id
        self._configured = system or None
        self._reset_detector = ClockResetDetector()
        self._translator = Translator(self.mapping, self._reset_detector, self.refusals, system)
        self._scanners: dict[int, Scanner] = {}
        self._messages = self.mapping.messages
        self._readers: dict[tuple[int, int], list[StationReader]] = {}
        self._plain: list[Callable[..., Iterable[Record]]] = []  # by station
        for source in self.mapping.sources:
            reader = StationReader(source, self._reset_detector, self.refusals)
            self._readers.setdefault((source.message, source.component), []).append(reader)
            self._plain.append(reader.plain)
        self._bulk = BulkDecoder(self.mapping.sources)

    @property
    def system_id(self) -> int | None:
        """The vehicle's system id, once its autopilot was heard."""
        return self._translator.system

    @property
    def choice(self) -> VehicleChoice:
        """Which autopilot is served, and which others were heard."""
        return self._translator.choice

    @property
    def px4(self) -> bool:
        """Whether the autopilot's last heartbeat said that it is PX4."""
        return self._translator.px4

    def counters(self, link: int) -> ScanCounters:
        """The scanner's counters of one link (or of what we sent on it)."""
        return self._scanner(link).counters

    def decode_chunk(self, chunk: RawChunk) -> list[Record]:
        """Give the records of one chunk: rare ones as they came, inertial batches by station, refusals that are due."""
        return self.decode(chunk).records

    def decode(self, chunk: RawChunk) -> Decoded:
        """As :meth:`decode_chunk`, with the rare messages themselves.

        A chunk that raises all the same, which is a defect, is refused, counted and told; the scanner of its link
        begins anew, lest what raised comes again with the next.
        """
        try:
            return self._decode(chunk)
        except Exception as error:
            self._scanner(chunk.link).forget()
            self.refusals.add(Reject.INTERNAL_ERROR, f"bytes of link {chunk.link}")
            due = self.refusals.due(chunk.received_host_ns)
            if any(refused.reason is Reject.INTERNAL_ERROR for refused in due):  # at most once a second
                text = f"internal error: bytes of link {chunk.link} refused: {described(error)}"
                return Decoded([*due, Notice(Severity.ERROR, text, chunk.received_host_ns)])
            return Decoded([*due])

    def _decode(self, chunk: RawChunk) -> Decoded:
        scan = self._scanner(chunk.link).scan(chunk.data, self.system_id)
        out = Decoded()
        many: dict[int, list[bytes]] = {}
        for frame in scan.frames:
            if frame[0] >> 16 in RARE:
                self._hear(chunk, frame, out)
            many.setdefault(frame[0], []).append(frame[1])
        if chunk.link < OUTGOING:
            self._inertial(chunk, many, scan.runs, out)
        out.records += self.refusals.due(chunk.received_host_ns)
        return out

    def _scanner(self, link: int) -> Scanner:
        if link not in self._scanners:
            self._scanners[link] = Scanner(self._bulk)
        return self._scanners[link]

    def _hear(self, chunk: RawChunk, frame: Frame, out: Decoded) -> None:
        (system, component, kind), payload = sender(frame[0]), frame[1]
        message = build_message(kind, payload)
        if chunk.link >= OUTGOING:
            self._translator.sent(message)
        elif (system, component) == (self.system_id, self._component_id):
            self.echoes += 1
            out.echoed.append(Echo(system, component, kind, payload, chunk.received_host_ns))
        else:
            heard = Heard(chunk.link, system, component, message, chunk.received_host_ns, payload)
            out.heard.append(heard)
            out.records += self._translator.records(heard)

    def _inertial(self, chunk: RawChunk, many: dict[int, list[bytes]], runs: list[SampleRun], out: Decoded) -> None:
        received_ns = chunk.received_host_ns
        if not many:  # nothing but plain runs, in the order of the stations
            for run in runs:
                source = run.source
                self._count((source.message, source.component), len(run.t_ns))
                out.records += self._plain[source.station](run, received_ns)
            return
        vehicle = self._configured if self.system_id is None else self.system_id
        reads: list[tuple[int, Callable[..., Iterable[Record]], tuple[Any, ...]]] = []
        for run in runs:
            source = run.source
            self._count((source.message, source.component), len(run.t_ns))
            reads.append((source.station, self._plain[source.station], (run, received_ns)))
        for frame_key, payloads in many.items():
            system, component, message = sender(frame_key)
            ours = vehicle in (None, system)
            if ours:
                self._count((message, component), len(payloads))
            if message in self._messages:
                readers = self._readers.get((message, component)) if ours else None
                if readers:
                    reads.append((readers[0].source.station, self._read, (readers, payloads, received_ns)))
                else:
                    self._foreign(frame_key, payloads)
        reads.sort(key=itemgetter(0))
        for _, read, arguments in reads:
            out.records += read(*arguments)

    def _count(self, key: tuple[int, int], frames: int) -> None:
        self.delivered[key] = self.delivered.get(key, 0) + frames

    def _foreign(self, key: int, payloads: list[bytes]) -> None:
        system, component, message = sender(key)
        if message == _TUNNEL:
            payloads = [payload for payload in payloads if payload.startswith(_TUNNEL_KIND)]
        if payloads:
            what = f"{NAME_OF[message]} of {system}/{component}"
            self.refusals.add(Reject.FOREIGN_SOURCE, what, len(payloads))

    def _read(
        self, readers: list[StationReader], payloads: list[bytes], received_host_ns: int
    ) -> Iterator[ImuBatch | ClockRestart]:
        with np.errstate(all="ignore"):  # not-a-number is looked for, and refused by name
            samples, damaged = LAYOUTS[readers[0].source.message].read(payloads)
            if damaged:
                self.refusals.add(Reject.INCONSISTENT, f"{readers[0].name}: batch of an unknown size", damaged)
            if len(samples.t_ns):
                for reader in readers:
                    yield from reader.batches(samples, received_host_ns)
