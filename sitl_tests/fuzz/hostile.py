"""The whole service in simulated time, with hostile but valid messages among those of a real flight."""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.files import load_airframe
from companion.params.settings import tunables
from companion.records import CorrectedRange, Notice, Record, Reject, Rejected, ServiceStatus
from companion.sim.flight.flight import Flight, build_flight
from sitl_tests.fuzz import mutators, structured
from sitl_tests.fuzz.target import Ending, Violation
from sitl_tests.loop.simulated_service import GROUND_M, SimulatedService

_ENTRY = struct.Struct("<IBH")
_SEND, _ALTER, _DROP = range(3)
_FLOWN_S = 14.0
_WARM_S = 3.0  # until shots have been fired and corrected, so that everything is loaded (chosen; they begin at 2 s)
_DROP_MS = 300
_SENDERS = ((1, 1), (1, 1), (1, 200), (1, 201), (1, 191), (1, 100), (255, 190), (2, 1), (2, 200), (0, 0))
_FAVOURITES = (
    "HIGHRES_IMU", "RAW_IMU", "SCALED_IMU2", "HEARTBEAT", "TIMESYNC", "PARAM_VALUE", "PARAM_SET", "CAMERA_FEEDBACK",
    "ATTITUDE", "VFR_HUD", "SYSTEM_TIME", "COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK", "DISTANCE_SENSOR", "STATUSTEXT",
    "MESSAGE_INTERVAL", "PARAM_REQUEST_READ", "FILE_TRANSFER_PROTOCOL", "TUNNEL", "AUTOPILOT_VERSION",
)  # fmt: skip
_PARAMETERS = (
    "INS_ACCEL_FILTER", "INS_GYRO_FILTER", "INS_HNTCH_ENABLE", "INS_HNTCH_FREQ", "INS_HNTCH_BW", "INS_HNTCH_ATT",
    "INS_HNTCH_HMNCS", "INS_HNTC2_FREQ", "INS_HNTC2_BW", "SCHED_LOOP_RATE", "INS_FAST_SAMPLE", "IMU_INTEG_RATE",
    "IMU_GYRO_CUTOFF", "IMU_ACCEL_CUTOFF", "IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF0_BW", "INS_GYRO_RATE", "INS_RAW_LOG_OPT",
)  # fmt: skip
_KINDS = {kind.msgname: kind for kind in mavlink.mavlink_map.values()}


class FlightTarget:
    """A flight of some seconds, and what is sent into it; nothing raises and nothing leaves that is not finite."""

    name = "flight"
    limit_s = 40.0  # of simulation; the flight lasts 14 s

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._flights: dict[bool, Flight] = {}

    def warm(self) -> None:
        self._fly(b"", px4=False, until_s=_WARM_S)

    def case(self, rng: np.random.Generator) -> bytes:
        entries = []
        for _ in range(int(rng.integers(1, 12))):
            at_ms = int(rng.integers(500, 1000 * _FLOWN_S - 500))
            entries += self._burst(rng, at_ms)
        entries.sort(key=lambda entry: entry[0])
        body = b"".join(_ENTRY.pack(at_ms, kind, len(data)) + data for at_ms, kind, data in entries)
        return bytes([rng.random() < 0.2]) + body

    def _burst(self, rng: np.random.Generator, at_ms: int) -> Iterator[tuple[int, int, bytes]]:
        """One kind of hostility, once or for a while."""
        for _ in range(int(rng.choice((1, 1, 5, 50)))):
            fate = rng.random()
            if fate < 0.5:
                yield at_ms, _SEND, _message(rng)
            elif fate < 0.98:
                yield at_ms, _ALTER, int(rng.integers(2**32)).to_bytes(4, "little")
            else:
                yield at_ms, _DROP, b""
            at_ms += int(rng.choice((0, 1, 5, 20)))

    def run(self, data: bytes) -> Ending:
        self._fly(data[1:], px4=bool(data[:1] == b"\x01"), until_s=_FLOWN_S)
        return Ending.DATA

    def _fly(self, data: bytes, *, px4: bool, until_s: float) -> None:
        service = SimulatedService(self._flight(), px4=px4)
        outgoing: list[bytes] = []
        meddler = Meddler(data)
        carry = service.wire.send

        def send(sent: bytes | list[bytes]) -> bool:
            if isinstance(sent, bytes):
                outgoing.append(sent)
                return carry(sent)
            return carry(meddler.meddle(sent, service.world.autopilot._tick_ns // 1_000_000))

        service.wire.send = send  # type: ignore[method-assign]
        try:
            tape = service.fly(until_s)
        finally:
            service.close()
        _check_outgoing(outgoing)
        check_contained(tape.records)
        self._count(tape.records)

    def _flight(self) -> Flight:
        if False not in self._flights:
            self._flights[False] = build_flight(load_airframe("nadir-2m"), 6, _FLOWN_S + 2.0)
        return self._flights[False]

    def _count(self, records: list[Any]) -> None:
        ranges = [record for record in records if isinstance(record, CorrectedRange) and record.trusted]
        wrong = [r for r in ranges if abs(r.range_m - GROUND_M) > max(5 * r.sigma_m, 0.05 * GROUND_M)]
        self.counts["trusted ranges"] += len(ranges)
        self.counts["trusted ranges wrong by more than 5 sigma and 5 %"] += len(wrong)
        self.counts["cases with a wrong range"] += bool(wrong)
        self.counts["records refused"] += sum(record.count for record in records if isinstance(record, Rejected))
        self.counts["status records"] += sum(isinstance(record, ServiceStatus) for record in records)


class Meddler:
    """Puts a case's messages among the vehicle's, alters and drops some of those."""

    def __init__(self, data: bytes) -> None:
        self._entries = list(_entries(data))
        self._dropping_until_ms = 0

    def meddle(self, frames: list[bytes], now_ms: int) -> list[bytes]:
        out, frames = [], list(frames)
        while self._entries and self._entries[0][0] <= now_ms:
            _, kind, data = self._entries.pop(0)
            if kind == _SEND:
                out.append(data)
            elif kind == _ALTER and frames:
                rng = np.random.default_rng(int.from_bytes(data, "little"))
                index = int(rng.integers(len(frames)))
                frames[index] = structured.hostile_frame(bytes(frames[index]), rng)
            elif kind == _DROP:
                self._dropping_until_ms = now_ms + _DROP_MS
        return out if now_ms < self._dropping_until_ms else [*out, *frames]


def _entries(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    at = 0
    while at + _ENTRY.size <= len(data):
        at_ms, kind, size = _ENTRY.unpack_from(data, at)
        at += _ENTRY.size
        yield at_ms, kind, data[at : at + size]
        at += size


def _message(rng: np.random.Generator) -> bytes:
    """A valid message of some sender with some values."""
    system, component = _SENDERS[int(rng.integers(len(_SENDERS)))]
    packer = mavlink.MAVLink(None, system, component)
    packer.seq = int(rng.integers(256))
    fate = rng.random()
    if fate < 0.15:
        name = _PARAMETERS[int(rng.integers(len(_PARAMETERS)))]
        value = _single(mutators.FLOATS[int(rng.integers(len(mutators.FLOATS)))])
        kind = int(rng.choice((9, 9, 6, 4, 200)))
        return bytes(mavlink.MAVLink_param_value_message(name.encode(), value, kind, 1000, 7).pack(packer))
    if fate < 0.3:
        rows = list(tunables())
        row = rows[int(rng.integers(len(rows)))]
        ends = (row.minimum, row.maximum, row.default, mutators.FLOATS[int(rng.integers(len(mutators.FLOATS)))])
        value = _single(ends[int(rng.integers(4))])
        return bytes(mavlink.MAVLink_param_set_message(1, 191, row.name.encode(), value, 9).pack(packer))
    names = _FAVOURITES if fate < 0.85 else sorted(_KINDS)
    kind = _KINDS[names[int(rng.integers(len(names)))]]
    size = struct.Struct(kind.unpacker.format).size
    payload = rng.bytes(size) if rng.random() < 0.5 else bytes(size)
    payload = structured.hostile_payload(payload, kind, rng)
    header = bytes([0xFD, 0, 0, 0, packer.seq, system, component]) + kind.id.to_bytes(3, "little")
    return structured.frame_with(header, payload)


def _single(value: float) -> float:
    return value if not math.isfinite(value) or abs(value) < 3.4e38 else 0.0


def check_contained(records: Iterable[Record]) -> None:
    """Raise for records whose handler raised: the service contains such a defect, but a defect it is."""
    raised, sentences = Counter[str](), []
    for record in records:
        if isinstance(record, Rejected) and record.reason is Reject.INTERNAL_ERROR:
            raised[record.what] += record.count
        elif isinstance(record, Notice) and record.text.startswith(str(Reject.INTERNAL_ERROR)):
            sentences.append(record.text)
    if raised:
        raise Violation(f"contained: {dict(raised)}; {'; '.join(sentences)}"[:1500])


def _check_outgoing(frames: list[bytes]) -> None:
    parser = mavlink.MAVLink(None)
    for frame in frames:
        for message in parser.parse_buffer(frame) or []:
            for name, value in message.to_dict().items():
                numbers = value if isinstance(value, list) else [value]
                if not all(math.isfinite(number) for number in numbers if isinstance(number, float)):
                    raise Violation(f"{message.get_type()}.{name} is {value}")
