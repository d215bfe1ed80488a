"""The bulk decoder on a recorded flight: every inertial sample that pymavlink reads, with the same numbers."""

from __future__ import annotations

import dataclasses
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.params.airframe import Airframe, Source
from companion.params.files import load_airframe
from companion.records import ClockName, ImuBatch, RawChunk, Station

DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))
FLIGHT = DATA / "recordings" / "flight.tlog"
MESSAGES = {Station.ROOT: "HIGHRES_IMU", Station.LEFT: "SCALED_IMU2", Station.RIGHT: "RAW_IMU"}
FRAMES = 20_000


def airframe() -> Airframe:
    base = load_airframe("nadir-2m")
    stations = {
        station.name.lower(): dataclasses.replace(base.sensor(station), source=Source(message, 1, ClockName.BOOT))
        for station, message in MESSAGES.items()
    }
    return dataclasses.replace(base, **stations)


def frames() -> list[tuple[int, bytes]]:
    """Receive time in us and bytes of the first frames of the log (unsigned MAVLink 2 throughout)."""
    data, at, stamped_frames = FLIGHT.read_bytes(), 0, []
    while len(stamped_frames) < FRAMES:
        (stamp,) = struct.unpack_from(">Q", data, at)
        length = 12 + data[at + 9]
        stamped_frames.append((stamp, data[at + 8 : at + 8 + length]))
        at += 8 + length
    return stamped_frames


@pytest.mark.slow
@pytest.mark.skipif(not FLIGHT.exists(), reason="recordings/flight.tlog is not here (SPANWISE_DATA)")
def test_a_recorded_flight_reads_as_pymavlink_reads_it() -> None:
    log = frames()
    parsed = mavlink.MAVLink(None).parse_buffer(b"".join(piece for _, piece in log))
    decoder = Decoder(airframe(), 192)
    records = []
    for start in range(0, len(log), 37):
        piece = log[start : start + 37]
        records += decoder.decode_chunk(RawChunk(0, piece[-1][0] * 1000, b"".join(data for _, data in piece)))
    for station, name in MESSAGES.items():
        batches = [record for record in records if isinstance(record, ImuBatch) and record.station == station]
        expected = [message for message in parsed if message.get_type() == name]
        scale = np.ones(6) if name == "HIGHRES_IMU" else np.array([9.80665e-3] * 3 + [1e-3] * 3)
        axes = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
        values = np.array([[getattr(message, axis) for axis in axes] for message in expected]) * scale
        np.testing.assert_allclose(np.concatenate([batch.values for batch in batches]), values, rtol=1e-12)
        stamps = [
            message.time_boot_ms * 1_000_000 if name == "SCALED_IMU2" else message.time_usec * 1000
            for message in expected
        ]
        assert np.concatenate([batch.t_ns for batch in batches]).tolist() == stamps
        assert len(expected) > 2000
