"""Whatever bytes a recording consists of, reading it gives records or one of our errors, never anything else."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.opening import open_recording
from companion.adapters.recordings.writer import McapWriter
from companion.errors import SpanwiseError
from companion.params.files import load_airframe
from companion.records import FramePair, Side
from sitl_tests.unit import test_recordings_bin as onboard
from sitl_tests.unit import test_recordings_mcap as ours
from sitl_tests.unit import test_recordings_tlog as telemetry
from sitl_tests.unit import test_recordings_ulog as px4

AIRFRAME = load_airframe("sitl-plane")


@functools.cache
def mcap() -> bytes:
    path = Path(__file__).with_name("damage.tmp.mcap")
    writer = McapWriter(path, ours.about())
    for record in [*ours.seconds_of_flight(3), FramePair(1, ours.frame(Side.LEFT, 1), ours.frame(Side.RIGHT, 1))]:
        writer.write(record)
    writer.close()
    try:
        return path.read_bytes()
    finally:
        path.unlink()


WHOLE: dict[str, Callable[[], bytes]] = {
    "a.mcap": mcap,
    "a.tlog": lambda: telemetry.flight(1.0).data,
    "a.BIN": lambda: onboard.flight(40).data,
    "a.ulg": lambda: px4.three_imus(40).data,
    "accel.csv": lambda: b"t_s,left_z_mps2,rpm\n" + b"".join(b"%.3f,-9.81,5000\n" % (i / 1000) for i in range(99)),
}


def damaged(whole: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(whole)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(len(data)))
        kind = rng.integers(4)
        if kind == 0:
            data[at] = int(rng.integers(256))
        elif kind == 1:
            del data[at : at + int(rng.integers(1, 300))]
        elif kind == 2:
            data[at:at] = rng.bytes(int(rng.integers(1, 300)))
        else:
            del data[at + 1 :]
    return bytes(data)


@pytest.mark.slow
@pytest.mark.parametrize("name", WHOLE)
def test_damaged_files_never_raise_anything_foreign(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(20260101)
    path, opened, refusals = tmp_path / name, 0, list[str]()
    for _ in range(150):
        path.write_bytes(damaged(WHOLE[name](), rng))
        try:
            recording = open_recording(tmp_path if name == "accel.csv" else path, AIRFRAME)
            for _ in recording.records():
                pass
        except SpanwiseError as error:
            refusals.append(str(error))
        else:
            opened += 1
    assert opened > 5, "much damage leaves something to read"
    assert not [text for text in refusals if str(tmp_path) not in text], "the file is named"
