"""Replaying a recording gives what was published, byte for byte, each time; a recording cut short replays to its cut.

What is recorded here are the raw bytes of the link, as the service's own loop read them (in simulated time).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import struct
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.main import main
from companion.cli.replay import encoded
from companion.evaluation.replay import own_inputs
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    CorrectedRange,
    Deflection,
    ModeState,
    NoRange,
    RawChunk,
    Record,
    Reject,
    Rejected,
    ServiceStatus,
    Tick,
    TriggerPlan,
)
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService

FLOWN_S = 6.0
OUTPUTS = (ModeState, TriggerPlan, Deflection, CorrectedRange, NoRange, ServiceStatus)

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Flown:
    path: Path
    records: list[Record]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    service = SimulatedService(build_flight(load_airframe("nadir-2m"), 7, FLOWN_S + 2.0), recording=path)
    records = service.fly(FLOWN_S).records
    service.close()
    return Flown(path, records)


def replay(path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, dict[str, Any], str]:
    code = main(["replay", str(path), "--json", *options])
    said = capsys.readouterr()
    return code, json.loads(said.out), said.err


def test_a_recording_replays_to_what_was_published_every_time(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kinds = Counter(type(record).__name__ for record in flown.records)
    assert kinds["RawChunk"] > 1000
    assert kinds["CorrectedRange"] > 10
    results = []
    for number in range(2):
        code, result, problems = replay(flown.path, capsys, "--out", str(tmp_path / f"{number}.mcap"))
        assert code == 0
        assert problems == ""
        assert result["reproduced"] is True
        results.append(result)
    first, again = results
    assert first == again
    assert first["compared"] == sum(isinstance(record, OUTPUTS) for record in flown.records)
    first_bytes, second_bytes = ((tmp_path / f"{number}.mcap").read_bytes() for number in range(2))
    assert first_bytes == second_bytes


def test_the_replayed_outputs_are_the_recorded_ones_field_by_field(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same comparison without the replay's own: what it wrote against what the loop handed to the recorder."""
    out = tmp_path / "again.mcap"
    _, result, _ = replay(flown.path, capsys, "--out", str(out))
    published = [encoded(record) for record in flown.records if isinstance(record, OUTPUTS)]
    replayed = [encoded(record) for record in open_recording(out).records() if isinstance(record, OUTPUTS)]
    assert replayed == published
    assert result["outputs"]["CorrectedRange"] == sum(isinstance(record, CorrectedRange) for record in flown.records)


def test_the_digest_is_that_of_all_outputs(flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "again.mcap"
    _, result, _ = replay(flown.path, capsys, "--out", str(out))
    written = hashlib.sha256(b"".join(encoded(record) for record in open_recording(out).records()))
    assert result["outputs_sha256"] == written.hexdigest()


def test_a_changed_output_is_found_and_named(flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A comparison that cannot fail would prove nothing."""
    forged = tmp_path / "forged.mcap"
    statuses = [index for index, record in enumerate(flown.records) if isinstance(record, ServiceStatus)]
    writer = McapWriter(forged, About.of(load_airframe("nadir-2m"), Settings()))
    for index, record in enumerate(flown.records):
        if index == statuses[3]:
            assert isinstance(record, ServiceStatus)
            record = dataclasses.replace(record, counters={**record.counters, "shots": 999})
        writer.write(record)
    writer.close()
    code, result, problems = replay(forged, capsys)
    assert code == 1
    assert result["reproduced"] is False
    assert "not reproduced" in problems
    assert "ServiceStatus" in problems


@pytest.mark.parametrize(("ratio", "code"), [(1e-12, 0), (1e-3, 1)], ids=["rounding", "difference"])
def test_rounding_of_another_machine_is_told_from_a_difference(
    flown: Flown,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ratio: float,
    code: int,
) -> None:
    """A recording of another machine whose ranges are longer by a ratio, as its arithmetic would have them."""
    monkeypatch.setattr("companion.adapters.recordings.mcap.writer.machine", lambda: "another, numpy 2.2.0")
    other = longer_ranges(flown, tmp_path / "other.mcap", ratio)
    got, result, problems = replay(other, capsys)
    assert got == code
    assert result["reproduced"] is False
    assert result["reproduced_to_rounding"] is (code == 0)
    assert ("same to rounding" in result["verdict"]) is (code == 0)
    assert "CorrectedRange.range_m" in (result["verdict"] if code == 0 else problems)
    assert "recorded with another, numpy 2.2.0" in result["verdict"]
    assert f"numpy {np.__version__}" in result["verdict"], "both machines are named"


def test_on_an_equal_machine_rounding_is_a_difference(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, result, problems = replay(longer_ranges(flown, tmp_path / "here.mcap", 1e-12), capsys)
    assert code == 1
    assert result["reproduced_to_rounding"] is False
    assert "an equal machine" in result["verdict"]
    assert "CorrectedRange.range_m" in problems


def longer_ranges(flown: Flown, path: Path, ratio: float) -> Path:
    writer = McapWriter(path, About.of(load_airframe("nadir-2m"), Settings()))
    for record in flown.records:
        longer = isinstance(record, CorrectedRange)
        writer.write(dataclasses.replace(record, range_m=record.range_m * (1.0 + ratio)) if longer else record)
    writer.close()
    return path


def test_a_truncated_recording_replays_up_to_the_cut_and_says_so(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = flown.path.read_bytes()
    cut.write_bytes(data[: int(0.8 * len(data))])
    code, result, problems = replay(cut, capsys)
    assert code == 0
    assert problems == ""
    assert any("truncated at" in notice and "everything before is here" in notice for notice in result["notices"])
    assert result["reproduced"] is True
    output_count = sum(isinstance(record, OUTPUTS) for record in flown.records)
    assert 0.5 * output_count < result["compared"] < output_count


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(4, 8))])
def test_a_cut_anywhere_replays_as_published_up_to_the_cut_or_is_refused_in_a_sentence(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    """Power fails where it will: within a chunk, between two, in the header."""
    data = flown.path.read_bytes()
    size = int(np.random.default_rng(seed).integers(1, len(data)))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[:size])
    code = main(["replay", str(cut)])
    output = capsys.readouterr()
    assert "Traceback" not in output.err
    assert "not reproduced" not in output.err
    if code == 1:
        assert size < 20_000, "only what ends before the first second is refused"
        assert re.fullmatch(r"spanwise replay: .*cut.mcap: cut off .*\n", output.err)
    else:
        assert code in (0, 3)
        assert re.search(
            r"as published up to the cut, (\d\.\d s missing|how much is missing the file does not tell)", output.out
        )


def test_what_is_missing_behind_a_cut_chunk_is_told(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    segments = [segment for segment in McapRecording(flown.path)._segments if segment.opcode == 6]
    data = flown.path.read_bytes()
    before, last = segments[2:4]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: last.offset + last.length // 2])
    code, result, _ = replay(cut, capsys)
    (ended_ns,), (end_ns,) = (struct.unpack_from("<Q", data, segment.offset + 8) for segment in (before, last))
    assert code in (0, 3)
    assert result["reproduced"] is True
    assert result["loss"]["where"] == "cut"
    assert result["loss"]["missing_s"] == pytest.approx((end_ns - ended_ns) * 1e-9, abs=1e-6)


def test_behind_a_damaged_chunk_nothing_is_compared(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(flown.path.read_bytes())
    segment = [chunk for chunk in McapRecording(flown.path)._segments if chunk.opcode == 6][2]
    data[segment.offset + segment.length // 2] ^= 0xFF
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(bytes(data))
    code, result, problems = replay(damaged, capsys)
    assert code in (0, 3)
    assert problems == ""
    assert result["reproduced"] is True
    assert result["loss"]["where"] == "damage"
    assert 0.5 < result["loss"]["missing_s"] < 2.0
    output_count = sum(isinstance(record, OUTPUTS) for record in flown.records)
    assert 0.1 * output_count < result["compared"] < 0.6 * output_count


def test_behind_dropped_records_nothing_is_compared(
    flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "drops.mcap"
    writer = McapWriter(path, About.of(load_airframe("nadir-2m"), Settings()))
    half = len(flown.records) // 2
    for number, record in enumerate(flown.records):
        if number == half:
            writer.note_drops(40)
        if not half <= number < half + 40:
            writer.write(record)
    writer.close()
    code, result, problems = replay(path, capsys)
    assert code in (0, 3)
    assert problems == ""
    assert result["reproduced"] is True
    assert result["loss"] == {"where": "first dropped record", "missing_s": 0.0, "dropped": 40}
    assert result["compared"] == sum(isinstance(record, OUTPUTS) for record in flown.records[:half])


def test_other_settings_are_a_different_flight_and_are_not_compared(
    flown: Flown, capsys: pytest.CaptureFixture[str]
) -> None:
    _, result, _ = replay(flown.path, capsys, "--set", "RNG_MAX=20")
    assert result["reproduced"] is None
    assert result["ranges"]["corrected"] > 10
    assert result["ranges"]["trusted"] == 0


def test_raw_bytes_and_ticks_are_enough(flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Samples are decoded again from the bytes: leaving the recorded samples out changes no mode state."""
    bare = tmp_path / "bare.mcap"
    writer = McapWriter(bare, About.of(load_airframe("nadir-2m"), Settings()))
    for record in flown.records:
        if isinstance(record, RawChunk | Tick):
            writer.write(record)
    writer.close()
    out = tmp_path / "out.mcap"
    replay(bare, capsys, "--out", str(out))
    states = [encoded(record) for record in open_recording(out).records() if isinstance(record, ModeState)]
    assert states == [encoded(record) for record in flown.records if isinstance(record, ModeState)]


def test_refusals_by_the_devices_are_inputs_and_our_own_are_made_again() -> None:
    """Plans that the trigger process could not fire are counted by the pipeline; only the recording knows of them."""
    device_refusals = [
        Rejected(reason, "plan 3", 7)
        for reason in (Reject.DEVICE_FAILED, Reject.PLAN_EXPIRED, Reject.UNPAIRED, Reject.FROZEN)
    ]
    made = [Rejected(reason, "left samples", 8) for reason in (Reject.CLOCK_UNSYNCED, Reject.STALE, Reject.TOO_LATE)]
    records: list[Record] = [*device_refusals, *made, Tick(9)]
    assert list(own_inputs(records, load_airframe("nadir-2m"), Settings())) == [*device_refusals, Tick(9)]
