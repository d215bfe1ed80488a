"""The decoder against pymavlink: of the same bytes both accept the same messages, and no record holds a NaN."""

from __future__ import annotations

import functools
import random
import struct
from collections import Counter
from collections.abc import Iterator

import numpy as np

from companion.adapters.mavlink.decode.bulk import BulkDecoder
from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.link.dialect import build_message
from companion.adapters.mavlink.link.scan import Scanner, sender
from companion.params.files import load_airframe
from companion.params.vehicle import VEHICLE_PARAMETERS
from companion.records import AutopilotParameter, ImuBatch, RawChunk, Reject, Rejected, VehicleState
from companion.sim.flight.flight import build_flight
from sitl_tests.fuzz import mutators, structured
from sitl_tests.fuzz.target import LIMIT_S, Ending, Violation
from sitl_tests.loop.simulated_service import SimulatedService
from sitl_tests.unit.test_mavlink_scan import random_frame, stepping_oracle

_LENGTH = struct.Struct("<H")
_MOST_PIECES = 30
MS = 1_000_000


@functools.cache
def flight_frames() -> list[bytes]:
    """Two seconds of a simulated vehicle's link: inertial samples, attitudes, clocks, parameters."""
    service = SimulatedService(build_flight(load_airframe("nadir-2m"), 1, 4.0))
    frames: list[bytes] = []
    carry = service.wire.send

    def send(data: bytes | list[bytes]) -> bool:
        if not isinstance(data, bytes):
            frames.extend(data)
        return carry(data)

    service.wire.send = send  # type: ignore[method-assign]
    service.fly(2.0)
    service.close()
    return frames


def pieces(data: bytes) -> Iterator[bytes]:
    """The datagrams of a case."""
    at = 0
    while at + 2 <= len(data):
        (size,) = _LENGTH.unpack_from(data, at)
        yield data[at + 2 : at + 2 + size]
        at += 2 + size


def joined(parts: list[bytes]) -> bytes:
    """A case of these datagrams."""
    return b"".join(_LENGTH.pack(len(datagram)) + datagram for datagram in parts)


class DecoderTarget:
    """Datagrams of valid, hostile and damaged frames."""

    name = "decoder"
    limit_s = LIMIT_S

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._airframe = load_airframe("nadir-2m")

    def warm(self) -> None:
        self.run(joined(flight_frames()[:200]))

    def case(self, rng: np.random.Generator) -> bytes:
        source = random.Random(int(rng.integers(2**62)))
        parts = []
        for _ in range(int(rng.integers(1, _MOST_PIECES))):
            frames = [self._frame(rng, source) for _ in range(int(rng.integers(1, 6)))]
            data = b"".join(frames)
            parts.append(mutators.mutate(data, rng, most=3)[:60_000] if rng.random() < 0.5 else data)
        return joined(parts)

    def _frame(self, rng: np.random.Generator, source: random.Random) -> bytes:
        if rng.random() < 0.4:
            return random_frame(source)
        frame = flight_frames()[int(rng.integers(len(flight_frames())))]
        return structured.hostile_frame(frame, rng) if rng.random() < 0.6 else frame

    def run(self, data: bytes) -> Ending:
        decoder = Decoder(self._airframe, component_id=191)
        for number, datagram in enumerate(pieces(data)):
            _same_frames(datagram)
            _finite(decoder, RawChunk(0, (number + 1) * 10 * MS, datagram))
        self.counts["frames accepted"] += decoder.counters(0).frames
        return Ending.DATA


def _same_frames(data: bytes) -> None:
    expected = stepping_oracle(data)
    for bulk in (None, BulkDecoder(())):
        accepted = [
            f"{system}/{component} {message} {build_message(message, payload).to_dict()!r}"
            for key, payload in Scanner(bulk).scan(data).frames
            for system, component, message in [sender(key)]
        ]
        if accepted != expected:
            raise Violation(f"{'plain' if bulk is None else 'compiled'}: {accepted} where pymavlink has {expected}")


def _finite(decoder: Decoder, chunk: RawChunk) -> None:
    for record in decoder.decode(chunk).records:
        if isinstance(record, Rejected) and record.reason is Reject.INTERNAL_ERROR:
            raise Violation(f"contained: {record.what}")
        if isinstance(record, ImuBatch):
            good = bool(np.isfinite(record.values).all())
        elif isinstance(record, VehicleState):
            numbers = (record.roll_rad, record.pitch_rad, record.yaw_rad, record.airspeed_mps, record.climb_mps)
            good = bool(np.isfinite([*numbers, record.throttle]).all())
        elif isinstance(record, AutopilotParameter):  # its value is judged, and named, by the pipeline
            good = record.name in VEHICLE_PARAMETERS
        else:
            good = True
        if not good:
            raise Violation(f"not finite: {record!r}"[:500])
