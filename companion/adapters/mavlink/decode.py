"""Chunks of bytes in, records out: the one place where MAVLink's units become SI.

A decoder's state comes from the chunks it was given and from nothing else, so replaying the recorded chunks, in order,
gives the very same records. What we sent matters for one thing, to know our own TIMESYNC requests when they are
answered: each request is therefore a chunk too, with ``link`` = :data:`OUTGOING` + link, recorded and decoded like the
others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from companion.adapters.mavlink.dialect import ID_OF, NAME_OF, build_message
from companion.adapters.mavlink.inertial import StationReader
from companion.adapters.mavlink.layouts import LAYOUTS, TUNNEL_IMU_TYPE
from companion.adapters.mavlink.mapping import build_mapping
from companion.adapters.mavlink.restart import ClockWatch
from companion.adapters.mavlink.scan import Route, ScanCounters, Scanner
from companion.adapters.mavlink.tally import Tally
from companion.adapters.mavlink.translate import Echo, Heard, Translator
from companion.params.airframe import Airframe
from companion.records import RawChunk, Record, Reject

OUTGOING = 128
"""Added to the link number of chunks that we sent."""

_RARE_NAMES = (
    "ATTITUDE",
    "AUTOPILOT_VERSION",
    "CAMERA_FEEDBACK",
    "COMMAND_ACK",
    "COMMAND_INT",
    "COMMAND_LONG",
    "DISTANCE_SENSOR",
    "FILE_TRANSFER_PROTOCOL",
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
)
RARE = frozenset(ID_OF[name] for name in _RARE_NAMES)
_TUNNEL = ID_OF["TUNNEL"]
_TUNNEL_KIND = TUNNEL_IMU_TYPE.to_bytes(2, "little")


@dataclass(slots=True)
class Decoded:
    """What one chunk held: records for the pipeline, and rare messages for the adapter itself."""

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
    """

    def __init__(self, airframe: Airframe, component_id: int) -> None:
        self.mapping = build_mapping(airframe)
        self.tally = Tally()
        self.delivered: dict[tuple[int, int], int] = {}
        self.echoes = 0
        self._component_id = component_id
        self._watch = ClockWatch()
        self._translator = Translator(self.mapping, self._watch, self.tally)
        self._scanners: dict[int, Scanner] = {}
        self._rare: list[tuple[Route, bytes]] = []
        self._messages = self.mapping.messages
        self._readers: dict[tuple[int, int], list[StationReader]] = {}
        for source in self.mapping.sources:
            reader = StationReader(source, self._watch, self.tally)
            self._readers.setdefault((source.message, source.component), []).append(reader)

    @property
    def system_id(self) -> int | None:
        """The vehicle's system id, once its autopilot was heard."""
        return self._translator.system

    @property
    def armed(self) -> bool:
        """Whether the autopilot's last heartbeat said so."""
        return self._translator.armed

    def counters(self, link: int) -> ScanCounters:
        """The scanner's counters of one link (or of what we sent on it)."""
        return self._scanner(link).counters

    def decode_chunk(self, chunk: RawChunk) -> list[Record]:
        """Give the records of one chunk: rare ones as they came, inertial batches by station, refusals that are due."""
        return self.decode(chunk).records

    def decode(self, chunk: RawChunk) -> Decoded:
        """As :meth:`decode_chunk`, with the rare messages themselves."""
        scanner = self._scanner(chunk.link)
        scanner.scan(chunk.data)
        out = Decoded()
        rare, self._rare = self._rare, []
        for route, payload in rare:
            self._hear(chunk, route, payload, out)
        with np.errstate(all="ignore"):  # not-a-number is looked for, and refused by name
            self._inertial(chunk, scanner, out)
        out.records += self.tally.due(chunk.received_host_ns)
        return out

    def _scanner(self, link: int) -> Scanner:
        if link not in self._scanners:
            self._scanners[link] = Scanner(self._collect)
        return self._scanners[link]

    def _collect(self, route: Route) -> Callable[[bytes], None]:
        keep = route.payloads.append
        if route.message not in RARE:
            return keep

        def keep_order(payload: bytes) -> None:
            keep(payload)
            self._rare.append((route, payload))

        return keep_order

    def _hear(self, chunk: RawChunk, route: Route, payload: bytes, out: Decoded) -> None:
        message = build_message(route.message, payload)
        if chunk.link >= OUTGOING:
            self._translator.sent(message)
        elif (route.system, route.component) == (self.system_id, self._component_id):
            self.echoes += 1
            out.echoed.append(Echo(route.system, route.component, route.message, payload, chunk.received_host_ns))
        else:
            heard = Heard(chunk.link, route.system, route.component, message, chunk.received_host_ns)
            out.heard.append(heard)
            out.records += self._translator.records(heard)

    def _inertial(self, chunk: RawChunk, scanner: Scanner, out: Decoded) -> None:
        found: list[tuple[int, list[StationReader], list[bytes]]] = []
        for route in scanner.routes.values():
            if not route.payloads:
                continue
            payloads = route.payloads.copy()
            route.payloads.clear()
            if chunk.link >= OUTGOING:
                continue
            key = (route.message, route.component)
            ours = self.system_id in (None, route.system)
            if ours:
                self.delivered[key] = self.delivered.get(key, 0) + len(payloads)
            if route.message in self._messages:
                readers = self._readers.get(key) if ours else None
                if readers:
                    found.append((readers[0].source.station, readers, payloads))
                else:
                    self._foreign(route, payloads)
        for _, readers, payloads in sorted(found, key=itemgetter(0)):
            self._read(readers, payloads, chunk, out)

    def _foreign(self, route: Route, payloads: list[bytes]) -> None:
        if route.message == _TUNNEL:
            payloads = [payload for payload in payloads if payload.startswith(_TUNNEL_KIND)]
        if payloads:
            what = f"{NAME_OF[route.message]} of {route.system}/{route.component}"
            self.tally.add(Reject.FOREIGN_SOURCE, what, len(payloads))

    def _read(self, readers: list[StationReader], payloads: list[bytes], chunk: RawChunk, out: Decoded) -> None:
        samples, damaged = LAYOUTS[readers[0].source.message].read(payloads)
        if damaged:
            self.tally.add(Reject.INCONSISTENT, f"{readers[0].name}: batch of an unknown size", damaged)
        if len(samples.t_ns):
            for reader in readers:
                out.records += reader.batches(samples, chunk.received_host_ns)
