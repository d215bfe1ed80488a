"""``spanwise convert``: a recording as a telemetry log that pymavlink reads, and as tables that pandas would read."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil

from companion.adapters.recordings.logs.tlog_writer import utc_offset_ns
from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.recordings.recording_factory import open_recording
from companion.adapters.recordings.tables.csv import CsvRecording
from companion.adapters.recordings.tables.record_tables import RecordTables
from companion.adapters.recordings.tables.tables_readme import column_unit
from companion.cli.main import main
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    Axis,
    ClockName,
    CorrectedRange,
    Flow,
    Health,
    ImuBatch,
    MatchSet,
    RawChunk,
    ServiceStatus,
    Station,
    VehicleState,
)
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService
from sitl_tests.unit.test_mavlink_scan import frame

AIRFRAME = load_airframe("nadir-2m")
_FLOWN_S = 12.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve seconds of the service beside a simulated vehicle, ranges among them."""
    path = tmp_path_factory.mktemp("convert") / "flight.mcap"
    service = SimulatedService(build_flight(AIRFRAME, 1, _FLOWN_S + 1.0), recording=path)
    service.fly(_FLOWN_S)
    service.close()
    return path


def recorded(path: Path, kind: type) -> list[Recordable]:
    return [record for record in open_recording(path).records() if isinstance(record, kind)]


@pytest.mark.slow
def test_pymavlink_reads_every_frame_of_the_log_at_its_receive_time(flown: Path, tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    assert main(["convert", str(flown), str(log)]) == 0
    chunks = [record for record in recorded(flown, RawChunk) if isinstance(record, RawChunk)]
    expected = sorted(chunk.received_host_ns for chunk in chunks)
    connection = mavutil.mavlink_connection(str(log))
    stamps = []
    while (message := connection.recv_msg()) is not None:
        assert message.get_type() != "BAD_DATA"
        stamps.append(message._timestamp)
    connection.close()
    parser = mavutil.mavlink.MAVLink(None)
    parser.robust_parsing = True
    link_bytes = b"".join(chunk.data for chunk in chunks if chunk.link < 128)
    received = [entry for entry in parser.parse_buffer(link_bytes) or [] if entry.get_type() != "BAD_DATA"]
    assert len(stamps) >= len(received) > 1000
    assert stamps[-1] - stamps[0] == pytest.approx((expected[-1] - expected[0]) * 1e-9, abs=0.02)


def test_a_frame_across_two_chunks_is_whole_and_links_do_not_mix(tmp_path: Path) -> None:
    path, log = tmp_path / "split.mcap", tmp_path / "split.tlog"
    heartbeat, other = frame(0, bytes(range(1, 10))), frame(30, bytes(range(1, 29)))
    writer = McapWriter(path, About.of(AIRFRAME, Settings()))
    for host_ms, link, data in ((1, 0, heartbeat[:7]), (2, 1, other[:9]), (3, 0, heartbeat[7:]), (4, 1, other[9:])):
        writer.write(RawChunk(link, host_ms * 1_000_000, data))
    writer.close()
    assert main(["convert", str(path), str(log)]) == 0
    data = log.read_bytes()
    assert data[8 : 8 + len(heartbeat)] == heartbeat
    assert data[16 + len(heartbeat) :] == other
    first_us, second_us = (int.from_bytes(data[at : at + 8], "big") for at in (0, 8 + len(heartbeat)))
    assert second_us - first_us == 1000


def test_the_date_is_that_of_the_vehicle() -> None:
    unix_us = 1_790_000_000_000_000
    unset, set_ = (frame(2, value.to_bytes(8, "little") + bytes([1, 0, 0, 0])) for value in (0, unix_us))
    assert utc_offset_ns([RawChunk(0, 5_000, unset)]) is None
    assert utc_offset_ns([RawChunk(0, 5_000, unset), RawChunk(0, 7_000, set_)]) == unix_us * 1000 - 7_000


@pytest.mark.slow
def test_tables_hold_every_range_and_every_sample(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "tables"
    assert main(["convert", str(flown), str(folder)]) == 0
    with (folder / "range_corrected.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    ranges = recorded(flown, CorrectedRange)
    assert len(rows) == len(ranges) > 5
    for row, record in zip(rows, ranges, strict=True):
        assert isinstance(record, CorrectedRange)
        assert (float(row["range_m"]), float(row["sigma_m"])) == (record.range_m, record.sigma_m)
        assert (row["trusted"], row["reject"]) == (str(record.trusted), str(record.reject or ""))
    batches = [entry for entry in recorded(flown, ImuBatch) if isinstance(entry, ImuBatch)]
    root = np.concatenate([batch.values[:, 2] for batch in batches if batch.station is Station.ROOT])
    clock = next(batch.clock for batch in batches if batch.station is Station.ROOT)
    written = np.genfromtxt(folder / f"samples_{clock}" / "accel.csv", delimiter=",", names=True)
    assert np.array_equal(written["root_z_mps2"], root)
    assert "range_corrected.csv: " in capsys.readouterr().out


def test_every_row_of_a_kind_has_the_columns_of_the_first(flown: Path, tmp_path: Path) -> None:
    with RecordTables(tmp_path) as tables:
        for record in open_recording(flown).records():
            tables.add(record)
    assert len(tables.rows) > 8
    for file in tmp_path.glob("*.csv"):
        with file.open(encoding="utf-8") as lines:
            assert len({len(row) for row in csv.reader(lines)}) == 1, file.name


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


PAIR = MatchSet(
    7, 3, (ClockName.CAM_LEFT, ClockName.CAM_RIGHT), np.array([10, 12]), 2_000_000, 0,
    np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), np.array([[0.5, 2.0], [2.5, 4.0], [4.5, 6.0]]),
    np.array([0.1, 0.2, 0.3]), 99, 1, Flow(6, np.array([1]), np.array([[3.25, 4.5]]), np.array([0.4])),
)  # fmt: skip


def test_every_match_is_a_row_with_its_place_in_the_earlier_image(tmp_path: Path) -> None:
    with RecordTables(tmp_path) as tables:
        tables.add(PAIR)
    (pair,) = table(tmp_path / "vision_matches.csv")
    assert (pair["pair_id"], pair["clocks_1"], pair["mid_exposure_ns_1"]) == ("7", "cam_right", "12")
    assert (pair["matches"], pair["in_earlier_image"], pair["filled"]) == ("3", "1", "1")
    points = table(tmp_path / "vision_points.csv")
    assert [(row["left_column_px"], row["right_row_px"], row["sigma_px"]) for row in points] == [
        ("1.0", "2.0", "0.1"),
        ("3.0", "4.0", "0.2"),
        ("5.0", "6.0", "0.3"),
    ]
    assert [row["filled"] for row in points] == ["False", "False", "True"]
    assert [row["earlier_column_px"] for row in points] == ["", "3.25", ""]
    assert tables.rows == {"vision_matches.csv": 1, "vision_points.csv": 3}


def test_a_velocity_has_three_columns_also_before_the_autopilot_tells_it(tmp_path: Path) -> None:
    silent = VehicleState(1, 1, 0.0, 0.0, 0.0, 20.0, 0.0, 0.5, armed=True)
    with RecordTables(tmp_path) as tables:
        tables.add(silent)
        tables.add(dataclasses.replace(silent, velocity_ned_mps=(22.0, 0.5, 0.1), velocity_sigma_mps=0.3))
    first, second = table(tmp_path / "vehicle_state.csv")
    names = [f"velocity_ned_mps_{i}" for i in range(3)]
    assert [first[name] for name in names] == ["", "", ""]
    assert [second[name] for name in names] == ["22.0", "0.5", "0.1"]
    assert second["velocity_sigma_mps"] == "0.3"


def test_counters_are_json(tmp_path: Path) -> None:
    counters = {"samples left": 965, "clock not synced": 197}
    with RecordTables(tmp_path) as tables:
        tables.add(ServiceStatus(1, Health.ACTIVE, "tracking", counters))
    (row,) = table(tmp_path / "status_service.csv")
    assert json.loads(row["counters"]) == counters


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("symmetric.frequency_hz", "Hz"),
        ("velocity_ned_mps_2", "m/s"),
        ("t_host_ns", "ns"),
        ("skew_ppm", "ppm"),
        ("body_rate_radps_0", "rad/s"),
        ("left_row_px", "px"),
        ("pair_id", ""),
        ("count", ""),
        ("covariance_12", ""),
    ],
)
def test_a_column_s_unit_is_read_from_its_name(column: str, unit: str) -> None:
    assert column_unit(column) == unit


def test_the_folder_explains_each_of_its_tables_and_is_known_for_what_it_is(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "tables"
    assert main(["convert", str(flown), str(folder)]) == 0
    text = (folder / "README.txt").read_text(encoding="utf-8")
    for place in folder.iterdir():
        assert place.name == "README.txt" or f"\n{place.name}" in text, place.name
    assert "range_m [m], sigma_m [m]" in text
    assert "covariance_0 to covariance_35" in text
    assert "corrected for the bend" in text, "the meaning of a table is that of its record"
    assert "images, which the recording keeps" in text
    for airframe in ([], ["--airframe", "nadir-2m"]):
        assert main(["info", str(folder), *airframe]) == 1
        assert "tables that spanwise convert wrote, no recording" in capsys.readouterr().err


def test_a_single_file_of_tables_is_refused_with_a_name_that_would_do(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(flown), str(tmp_path / "flight.csv")]) == 1
    assert f"name a folder, such as {tmp_path / 'flight'}" in capsys.readouterr().err
    assert not (tmp_path / "flight.csv").exists()


@pytest.mark.parametrize(
    ("to", "sentence"), [("there", "exists already"), ("no/such/folder.tlog", "no folder")], ids=["exists", "no folder"]
)
def test_a_place_that_cannot_be_written_is_named(
    flown: Path, tmp_path: Path, to: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there").mkdir()
    assert main(["convert", str(flown), str(tmp_path / to)]) == 1
    assert sentence in capsys.readouterr().err


def test_a_log_without_a_link_becomes_no_telemetry_log(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "accel.csv").write_text("t_s,left_z_mps2\n" + "".join(f"{0.01 * i},-9.8\n" for i in range(100)))
    assert main(["convert", str(tmp_path), str(tmp_path / "a.tlog"), "--airframe", "nadir-2m"]) == 1
    assert "holds no MAVLink frames" in capsys.readouterr().err


def test_a_laboratory_s_covariates_inputs_and_ranges_are_converted_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = tmp_path / "lab"
    lab.mkdir()
    rows = "".join(f"{0.002 * i},-9.8,{17.0 + 0.1 * i},{i % 3}\n" for i in range(200))
    (lab / "accel.csv").write_text("t_s,left_z_mps2,airspeed_mps,input_n\n" + rows)
    slow = "".join(f"{0.004 * i},-9.8,{20.0 + i}\n" for i in range(100))
    (lab / "accel_right.csv").write_text("t_s,z_mps2,temperature_degc\n" + slow)
    (lab / "range.csv").write_text("t_s,range_m\n0.1,40.5\n0.2,inf\n")
    assert main(["convert", str(lab), str(tmp_path / "tables"), "--airframe", "nadir-2m"]) == 0
    text = "with airspeed_mps, input_n, temperature_degc, 2 ranges (range.csv)"
    assert text in capsys.readouterr().out
    assert text in (tmp_path / "tables" / "README.txt").read_text()
    before, after = (CsvRecording(path, AIRFRAME) for path in (lab, tmp_path / "tables" / "samples_host"))
    for name in ("airspeed_mps", "input_n"):
        np.testing.assert_array_equal(after.covariates[name].values, before.covariates[name].values)
    slow_values = after.covariates["temperature_degc"].values
    np.testing.assert_allclose(slow_values[:3], [20.0, 20.5, 21.0])  # interpolated to the stamps of accel.csv
    assert before.ranges is not None
    assert after.ranges is not None
    np.testing.assert_array_equal(after.ranges.range_m, before.ranges.range_m)


def test_samples_whose_stamps_repeat_are_counted_as_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "twice.mcap"
    t_ns = np.array([0, 1, 2, 2, 3]) * 1_000_000
    writer = McapWriter(path, About.of(AIRFRAME, Settings()))
    writer.write(ImuBatch(Station.LEFT, ClockName.HOST, t_ns, np.ones((5, 6)), Axis.ACCEL, int(t_ns[-1])))
    writer.close()
    assert main(["convert", str(path), str(tmp_path / "tables")]) == 0
    assert "4 of left; 1 whose stamps repeat are left out" in capsys.readouterr().out


@pytest.mark.parametrize(("name", "writer"), [("tables", "write_readme"), ("link.tlog", "write_tlog")])
def test_a_conversion_that_is_stopped_leaves_nothing_that_looks_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, writer: str
) -> None:
    recording = tmp_path / "flight.mcap"
    out = McapWriter(recording, About.of(AIRFRAME, Settings(), ClockName.HOST))
    out.write(RawChunk(0, 1_000_000_000, b"bytes"))
    out.close()

    def stopped(path: Path, *_: object) -> None:
        assert path.name == f"{name}.part"
        assert not (tmp_path / name).exists()
        raise KeyboardInterrupt

    with monkeypatch.context() as interrupted:
        interrupted.setattr(f"companion.cli.convert.{writer}", stopped)
        if name == "tables":
            interrupted.setattr("companion.cli.convert._samples", lambda *_: iter([("a", "b")]))
        assert main(["convert", str(recording), str(tmp_path / name)]) == 130
    assert [path.name for path in tmp_path.iterdir()] == ["flight.mcap"]
    (tmp_path / f"{name}.part").mkdir()
    assert main(["convert", str(recording), str(tmp_path / name)]) == 1, "what a killed one left is not mixed in"
