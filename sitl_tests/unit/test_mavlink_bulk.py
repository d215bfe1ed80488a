"""The compiled way of plain samples against the plain way of all: the same records, whatever a stream holds."""

from __future__ import annotations

import contextlib
import itertools
import math
import random
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode import decoder as decode
from companion.adapters.mavlink.decode.bulk import BulkDecoder
from companion.adapters.mavlink.decode.decoder import Decoder
from companion.params.airframe import Airframe, Source
from companion.records import ClockName, ImuBatch, RawChunk, Record
from sitl_tests.unit.test_mavlink_decode import airframe, highres, packed, pilot_heartbeat

MS = 1_000_000
AIRFRAMES = {
    "alike": airframe(),
    "mixed": airframe(
        root=Source("RAW_IMU", 1, ClockName.BOOT, stamp_offset_s=0.0005),
        left=Source("HIGHRES_IMU", 200, ClockName.NODE_LEFT, axes=("y", "-x", "z")),
        right=Source("SCALED_IMU2", 201, ClockName.NODE_RIGHT, axes=("-x", "-y", "z")),
    ),
    "one sender": airframe(
        root=Source("RAW_IMU", 1, ClockName.BOOT),
        left=Source("SCALED_IMU2", 1, ClockName.BOOT),
        right=Source("SCALED_IMU3", 1, ClockName.BOOT),
    ),
    "instances": airframe(
        left=Source("HIGHRES_IMU", 200, ClockName.NODE_LEFT, instance="0"),
        right=Source("HIGHRES_IMU", 200, ClockName.NODE_LEFT, instance="1"),
    ),
}


def decoder(frame: Airframe, *, compiled: bool) -> Decoder:
    plain = mock.patch.object(decode, "BulkDecoder", return_value=None)
    with contextlib.nullcontext() if compiled else plain:
        return Decoder(frame, component_id=191)


def message(rng: random.Random, t_us: int) -> Any:
    """An inertial message, now and then with something odd in it."""
    fate, kind = rng.random(), rng.choice(("highres", "highres", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3"))
    t_us = 2**64 - 1 if fate < 0.02 else max(t_us - 3_000_000 * (0.02 < fate < 0.06), 0)
    if kind == "highres":
        values = [rng.choice((0.0, rng.uniform(-50, 50))) for _ in range(6)]
        if 0.1 < fate < 0.15:
            values[rng.randrange(6)] = rng.choice((math.nan, math.inf, -math.inf))
        fields = rng.randrange(64) if fate > 0.95 else rng.choice((63, 0xFFFF))
        return highres(t_us, tuple(values), fields, int(0.9 < fate < 0.95))
    counts = [rng.choice((0, rng.randint(-32768, 32767))) for _ in range(9)]
    if kind == "RAW_IMU":
        return mavlink.MAVLink_raw_imu_message(t_us, *counts, id=int(fate > 0.95))
    return getattr(mavlink, f"MAVLink_{kind.lower()}_message")(t_us // 1000 % 2**32, *counts)


def stream(rng: random.Random, count: int) -> bytes:
    pieces = [packed(pilot_heartbeat())]
    for k in range(count):
        fate = rng.random()
        sender = rng.choice((1, 1, 200, 201)), 7 if fate < 0.03 else 1
        pieces.append(packed(message(rng, 5_000_000 + 1000 * k), *sender))
        if fate > 0.97:
            pieces.append(packed(pilot_heartbeat(armed=fate > 0.98)))
    data = bytearray(b"".join(pieces))
    for _ in range(rng.choice((0, 0, 3))):
        data[rng.randrange(21, len(data))] ^= 1 << rng.randrange(8)  # not the heartbeat that says who is ours
    return bytes(data)


def descriptions(records: list[Record]) -> list[str]:
    with np.printoptions(precision=17, threshold=100_000):
        return [repr(record) for record in records]


@pytest.mark.parametrize("name", AIRFRAMES)
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 30))
def test_both_ways_give_the_same_records(name: str, seed: int, pieces: int) -> None:
    rng = random.Random(seed)
    data = stream(rng, 60)
    borders = [0, *sorted(rng.randint(0, len(data)) for _ in range(pieces)), len(data)]
    fast, plain = (decoder(AIRFRAMES[name], compiled=compiled) for compiled in (True, False))
    for k, (first, last) in enumerate(itertools.pairwise(borders)):
        chunk = RawChunk(0, (k + 1) * 20 * MS, data[first:last])
        assert descriptions(fast.decode_chunk(chunk)) == descriptions(plain.decode_chunk(chunk))
    assert fast.counters(0) == plain.counters(0)
    assert fast.delivered == plain.delivered


def test_plain_samples_of_a_known_vehicle_are_read_in_bulk() -> None:
    ours = decoder(airframe(), compiled=True)
    ours.decode_chunk(RawChunk(0, MS, packed(pilot_heartbeat())))
    frames = [packed(highres(1000 * k), component) for k in range(4) for component in (201, 1, 200)]
    with mock.patch.object(ours, "_read", side_effect=AssertionError("read one by one")):
        records = ours.decode_chunk(RawChunk(0, 5 * MS, b"".join(frames)))
    assert [len(record.t_ns) for record in records if isinstance(record, ImuBatch)] == [4, 4, 4]


def test_a_scan_for_no_source_hands_every_frame_on() -> None:
    frames: list[tuple[int, bytes]] = []
    data = packed(highres(1000), 200) + packed(highres(2000), 201)
    position, counted, runs = BulkDecoder(()).scan(data, 1, frames)
    assert (position, counted, runs) == (len(data), [2, 0, 0, 0], [])
    assert [key >> 8 & 0xFF for key, _ in frames] == [200, 201]
