"""Small valid files of every format, written at run time; pieces of real recordings where they are at hand."""

from __future__ import annotations

import functools
import io
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from scipy.io import savemat

from companion.adapters.recordings.mcap.images import ImageFormat
from companion.adapters.recordings.mcap.writer import McapWriter
from companion.params.files import load_airframe
from companion.records import FramePair, ParameterChange, Side
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService
from sitl_tests.unit import test_recordings_bin as onboard
from sitl_tests.unit import test_recordings_mcap as ours
from sitl_tests.unit import test_recordings_tlog as telemetry
from sitl_tests.unit import test_recordings_ulog as px4

DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))
_PIECE_BYTES = 150_000


def _piece(name: str, head_bytes: int = 0) -> list[bytes]:
    """The head of a real file and a piece of its middle; nothing where the file is not here."""
    path = DATA / name
    if not path.is_file():
        return []
    with path.open("rb") as file:
        head = file.read(head_bytes)
        file.seek(max(head_bytes, path.stat().st_size // 2))
        return [head + file.read(_PIECE_BYTES)]


@functools.cache
def tlogs() -> list[bytes]:
    return [telemetry.flight(1.0).data, *_piece("recordings/flight_clean.tlog", 20_000)]


@functools.cache
def bins() -> list[bytes]:
    filtered = onboard.Log("PARM", "IMU", "ATT", "TST")
    for i in range(60):
        filtered.add("IMU", 2500 * i, i % 3, 0.1, 0.2, 0.3, 1.0, 2.0, -9.8)
    return [onboard.flight(40).data, filtered.data, *_piece("recordings/flight.BIN", 60_000)]


@functools.cache
def ulogs() -> list[bytes]:
    combined = px4.Log(("sensor_combined", 0), ("vehicle_attitude", 0), parameters={"IMU_GYRO_CUTOFF": 40.0})
    for k in range(60):
        combined.add("sensor_combined", 0, 4000 * k, 0.1, 0.2, 0.3, -1000, 0.0, 0.0, -9.8)
        combined.add("vehicle_attitude", 0, 4000 * k, 1.0, 0.0, 0.0, 0.0)
    combined.dropout(12)
    integrated = px4.Log(("vehicle_imu", 0))
    for k in range(60):
        integrated.add("vehicle_imu", 0, 5000 * k + 9, 5000 * (k + 1), 0.01, 0.0, 0.0, 0.0, 0.0, -0.049, 5000, 5000)
    return [px4.three_imus(40).data, combined.data, integrated.data, *_piece("measured/px4-ulog/sample.ulg", 150_000)]


@functools.cache
def mcaps() -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        return [_written(Path(folder) / "a.mcap"), _flown(Path(folder) / "b.mcap", 2.5)]


@functools.cache
def flown_mcaps() -> list[bytes]:
    """A start, and a flight that is long enough for trusted ranges."""
    with tempfile.TemporaryDirectory() as folder:
        return [_flown(Path(folder) / f"{seconds:g}.mcap", seconds) for seconds in (2.5, 11.5)]


def _written(path: Path) -> bytes:
    writer = McapWriter(path, ours.about(ImageFormat.PNG))
    for record in [*ours.seconds_of_flight(3), FramePair(1, ours.frame(Side.LEFT, 1), ours.frame(Side.RIGHT, 1))]:
        writer.write(record)
    writer.close()
    return path.read_bytes()


def _flown(path: Path, seconds: float) -> bytes:
    service = SimulatedService(build_flight(load_airframe("nadir-2m"), 1, seconds + 3.5), recording=path)
    service.fly(1.5)
    service.loop._handle(ParameterChange("RNG_TRUST", 0.04, service.clock.now_ns()))
    service.fly(seconds)
    service.close()
    return path.read_bytes()


@functools.cache
def accel_tables() -> list[bytes]:
    rows = b"".join(b"%.3f,-9.81,%.3f,-9.79,5000\n" % (i / 1000, 0.01 * i) for i in range(150))
    return [
        b"t_s,left_z_mps2,left_p_radps,right_z_mps2,rpm\n" + rows,
        b"t_s,left_z_g,root_z_g,airspeed_mps\n" + b"".join(b"%.3f,-1.0,-1,17\n" % (i / 500) for i in range(150)),
    ]


@functools.cache
def range_tables() -> list[bytes]:
    return [b"t_s,range_m,reference_m\n" + b"".join(b"%.3f,%.2f,60\n" % (i / 20, 50 + i) for i in range(40))]


@functools.cache
def text_tables() -> list[bytes]:
    rows = b"".join(b"%.1f\tx\t%.3f\t0.2\n" % (2.5 * i, 0.1 * i - 0.5) for i in range(120))
    return [b"rig 7\nno date\nTime\tOther\tAcc L\tGauge\n\n" + rows]


@functools.cache
def matlab_files() -> list[bytes]:
    rng = np.random.default_rng(1)
    names = np.array([["input"], ["left"], ["right"]], dtype=object)
    files = []
    for packed in (False, True):
        file = io.BytesIO()
        savemat(file, {"data": rng.standard_normal((60, 3)), "names": names, "note": "rig 7"}, do_compression=packed)
        files.append(file.getvalue())
    return files


@functools.cache
def pictures() -> dict[str, list[bytes]]:
    """Encoded images, by suffix."""
    image = np.random.default_rng(2).integers(0, 256, (48, 64), dtype=np.uint8)
    files: dict[str, list[bytes]] = {}
    for suffix in (".png", ".jpg", ".bmp", ".tif", ".pgm"):
        _, data = cv2.imencode(suffix, image)
        files[suffix] = [data.tobytes()]
    return files


Corpus = Callable[[], list[bytes]]
