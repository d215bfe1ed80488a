"""Replaying a recording gives what was published, byte for byte, each time; a recording cut short replays to its cut.

What is recorded here are the raw bytes of the link, as the service's own loop read them (in simulated time).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from companion.adapters.recordings.opening import open_recording
from companion.adapters.recordings.writer import About, McapWriter
from companion.cli.main import main
from companion.cli.replay import encoded
from companion.cli.replaying import own_inputs
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
from companion.sim.flight import build_flight
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
    one, other = ((tmp_path / f"{number}.mcap").read_bytes() for number in range(2))
    assert one == other


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
    whole = sum(isinstance(record, OUTPUTS) for record in flown.records)
    assert 0.5 * whole < result["compared"] < whole


def test_other_settings_are_a_different_flight_and_are_not_compared(
    flown: Flown, capsys: pytest.CaptureFixture[str]
) -> None:
    _, result, _ = replay(flown.path, capsys, "--set", "RNG_MAX=20")
    assert result["reproduced"] is None
    assert result["ranges"]["corrected"] > 10
    assert result["ranges"]["trusted"] == 0


def test_raw_bytes_and_ticks_are_enough(flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the bytes decode to is decoded again: leaving the recorded samples out changes no mode state."""
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
    """What the trigger process could not fire is counted by the pipeline; only the recording knows of it."""
    told = [Rejected(reason, "plan 3", 7) for reason in (Reject.DEVICE_FAILED, Reject.PLAN_EXPIRED, Reject.UNPAIRED)]
    made = [Rejected(reason, "left samples", 8) for reason in (Reject.CLOCK_UNSYNCED, Reject.STALE, Reject.TOO_LATE)]
    records: list[Record] = [*told, *made, Tick(9)]
    assert list(own_inputs(records, load_airframe("nadir-2m"), Settings())) == [*told, Tick(9)]
