"""Many flights at once: parts, failures, killed workers, and the same results whatever the number of processes."""

from __future__ import annotations

import csv
import json
import os
import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli import fleet
from companion.cli.main import main
from companion.cli.steps import fleet_tasks
from companion.core.wing.lowpass import Biquad
from companion.errors import RecordingError
from companion.evaluation.fleet.campaign import work_off
from companion.evaluation.fleet.file_task import FileTask, tasks_of, without_copies
from companion.evaluation.fleet.page import render, short_name
from companion.evaluation.fleet.parquet import write_parquet
from companion.evaluation.fleet.rows import as_csv, diagnosis_row, flattened, flight_row, identification_row, tuning_row
from companion.evaluation.fleet.runner import attempt, run
from companion.evaluation.fleet.trends import findings, sentences, unremarkable
from companion.evaluation.flight_log import gather
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import AutopilotParameter, Axis, ClockName, ImuBatch, Station, Tick


def measure(task: FileTask) -> dict[str, Any]:
    """Count letters; what is called bad cannot be read, and what is called deadly kills its worker."""
    if task.path.stem.startswith("bad"):
        raise RecordingError(f"{task.path.name}: cannot be read")
    if task.path.stem.startswith("odd"):
        raise ZeroDivisionError("a defect")
    once = task.path.with_suffix(".killed")
    if task.path.stem.startswith("deadly") or (task.path.stem.startswith("once") and not once.exists()):
        once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if task.path.stem.startswith("last"):
        threading.Timer(0.1, os._exit, [3]).start()
    with task.path.with_suffix(".count").open("a") as count:
        count.write("x")
    return {"file": str(task.path), "letters": len(task.path.read_text())}


def files(folder: Path, *names: str) -> list[Path]:
    paths = [folder / f"{name}.txt" for name in names]
    for place, path in enumerate(paths):
        path.write_text("a" * (place + 1))
    return paths


def results(paths: list[Path], out: Path, workers: int) -> dict[str, dict[str, Any]]:
    return {task.path.stem: row for task, row in run(tasks_of(paths, ("measure",), out), measure, workers)}


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    paths = files(tmp_path, "one", "two", "bad", "odd", "three")
    got = [results(paths, tmp_path / f"out{workers}", workers) for workers in (1, 2)]
    assert got[0] == got[1]
    assert [got[0][name]["letters"] for name in ("one", "two", "three")] == [1, 2, 5]
    assert "cannot be read" in got[0]["bad"]["failed"]
    assert got[0]["odd"]["failed"] == "ZeroDivisionError: a defect"


@pytest.mark.slow
def test_a_second_run_makes_only_what_is_missing_or_has_changed(tmp_path: Path) -> None:
    paths = files(tmp_path, "one", "two")
    out = tmp_path / "out"
    first = results(paths, out, 1)
    assert results(paths, out, 1) == first
    assert paths[0].with_suffix(".count").read_text() == "x"
    paths[0].write_text("longer now")
    assert results(paths, out, 1)["one"]["letters"] == 10
    assert [path.with_suffix(".count").read_text() for path in paths] == ["xx", "x"]


def test_an_airframe_s_text_a_folder_s_files_and_the_version_name_another_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    airframe, lab = tmp_path / "my.toml", tmp_path / "lab"
    airframe.write_text("a = 1")
    lab.mkdir()
    (lab / "accel.csv").write_text("t_s,left_z_mps2\n0,1\n")
    task = FileTask(lab, ("identify", "--airframe", str(airframe)), tmp_path / "out")
    keys = [task.key, task.key]
    airframe.write_text("a = 2")
    keys.append(task.key)
    with (lab / "accel.csv").open("a") as table:
        table.write("1,1\n")
    keys.append(task.key)
    (lab / "range.csv").write_text("t_s\n")
    keys.append(task.key)
    monkeypatch.setattr("companion.evaluation.fleet.file_task.metadata.version", lambda _name: "another")
    keys.append(task.key)
    assert keys[0] == keys[1]
    assert len(set(keys)) == 5


def test_a_copy_of_a_recording_counts_once(tmp_path: Path) -> None:
    first, second, other = files(tmp_path, "a", "b", "c")
    second.write_text(first.read_text())
    other.write_text("z")  # as long, and another
    lab = tmp_path / "lab"
    lab.mkdir()
    unique, copies = without_copies([lab, other, second, first])
    assert unique == [first, other, lab]
    assert copies == [(second, first)]


@pytest.mark.slow
def test_a_file_of_an_odd_name_costs_no_other_its_row(tmp_path: Path) -> None:
    names = ["a", "f" * 240, "ü" * 120, os.fsdecode(b"f\xff"), os.fsdecode(b"bad\xff")]
    tasks = tasks_of(files(tmp_path, *names), ("measure",), tmp_path / "out")
    rows = work_off(tasks, measure, 1)
    assert [row["letters"] for row in rows if "letters" in row] == [1, 2, 4, 3]
    table, page = as_csv(rows).encode(), render("report", rows).encode()
    assert b"f\\udcff.txt" in table
    assert b"f\\udcff.txt" in page
    (failed,) = (row for row in rows if "failed" in row)
    assert failed["failed"] == "bad\\udcff.txt: cannot be read"


def test_a_part_that_cannot_be_written_is_the_failure_of_its_task_alone(tmp_path: Path) -> None:
    (path,) = files(tmp_path, "one")
    (tmp_path / "out").write_text("a file where the folder should be")
    (task,) = tasks_of([path], ("measure",), tmp_path / "out")
    assert attempt(task, measure)["failed"].startswith("its part could not be written: ")


def test_a_link_to_a_page_leads_there_whatever_its_name() -> None:
    text = render("report", [flight(0, page="pages/50% #2 what?.html")])
    assert 'href="pages/50%25%20%232%20what%3F.html"' in text


@pytest.mark.slow
def test_a_part_that_was_cut_off_is_made_anew(tmp_path: Path) -> None:
    (path,) = files(tmp_path, "one")
    out = tmp_path / "out"
    results([path], out, 1)
    (part_file,) = (out / "parts").iterdir()
    part_file.write_text('{"file": "o')
    assert results([path], out, 1)["one"]["letters"] == 1


@pytest.mark.long
def test_a_killed_worker_costs_nothing_but_time_and_a_deadly_file_only_itself(tmp_path: Path) -> None:
    paths = files(tmp_path, "once", "deadly", "other", "more")
    got = results(paths, tmp_path / "out", 2)
    assert [got[name].get("letters") for name in ("once", "other", "more")] == [1, 3, 4]
    assert "its worker ended (-9), 2 times" in got["deadly"]["failed"]


@pytest.mark.slow
def test_a_worker_that_ends_between_two_files_costs_none_of_them(tmp_path: Path) -> None:
    paths = files(tmp_path, "last", "other", "more")
    got = {}
    for task, row in run(tasks_of(paths, ("measure",), tmp_path / "out"), measure, 1):
        got[task.path.stem] = row.get("letters")
        time.sleep(0.5)  # who takes the rows is slow, and the worker is gone before its next file
    assert got == {"last": 1, "other": 2, "more": 3}


@pytest.mark.slow
def test_a_campaign_s_rows_come_in_the_order_of_its_tasks_with_a_line_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tasks = tasks_of(files(tmp_path, "one", "bad", "three"), ("measure",), tmp_path / "out")
    rows = work_off(tasks, measure, 2, describe=lambda row: f"{row['letters']} letters")
    assert [row["file"] for row in rows] == [task.name for task in tasks]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(tasks)
    assert any(line.endswith("bad.txt failed: cannot be read") for line in lines)
    assert any(line.endswith(" 3 letters") for line in lines)


def test_a_nested_result_becomes_columns() -> None:
    nested = {"a": {"b": 1.5, "c": None}, "names": ["x", "y"], "trials": [{}, {}], "word": "w"}
    row = flattened(nested)
    assert row == {"a.b": 1.5, "a.c": None, "names": "x, y", "trials": 2, "word": "w"}
    table = list(csv.DictReader(as_csv([{"file": "1", **row}, {"file": "2", "new": 3}]).splitlines()))
    assert table[0]["a.b"] == "1.5"
    assert table[1]["new"] == "3"


def flight(number: int, **changes: Any) -> dict[str, Any]:
    row = {"file": f"/log/{number}.mcap", "airframe": "nadir-2m", "symmetric_hz": 5.0 + 0.01 * (number % 3),
           "symmetric_sigma_hz": 0.05, "left_rate_hz": 1000.0}  # fmt: skip
    return row | changes


def test_a_flight_whose_mode_or_sensor_leaves_its_aircraft_s_median_is_named() -> None:
    rows = [flight(number) for number in range(6)]
    assert findings(rows) == []
    off, slowed = flight(7, symmetric_hz=4.6), flight(8, left_rate_hz=900.0)
    first, second = findings([*rows, off, slowed])
    assert first == "nadir-2m: left sensor's rate 900, usually 1000 Hz, in 8.mcap"
    assert second == "nadir-2m: symmetric mode 4.6, usually 5.01 Hz, in 7.mcap"
    lossy = flight(8, left_rate_hz=900.0, incomplete=True)
    assert findings([*rows, lossy]) == [], "no sensor is to blame for what a file has lost"
    assert "or a disk that was too slow), and judged by what is there: 8.mcap" in render("report", [*rows, lossy])
    other = flight(9, airframe="forward-2m", symmetric_hz=3.0)
    assert findings([*rows, other]) == [], "another airframe has a median of its own"


@pytest.mark.parametrize(
    ("count", "sentence"),
    [
        (2, "nadir-2m: too few flights for a usual value (2; 3 are needed, 9 for a drift)"),
        (5, "nadir-2m: none of 5 flights leaves their median by three sigma; too few for a drift (9 are needed)"),
        (9, "nadir-2m: nothing drifts over 9 flights, and none leaves their median by three sigma"),
    ],
)
def test_nothing_remarkable_is_said_with_the_number_of_flights_behind_it(count: int, sentence: str) -> None:
    rows = [flight(number) for number in range(count)]
    assert unremarkable(rows) == [sentence]
    assert sentence in render("report", rows)
    assert unremarkable([*rows, *rows, flight(90, symmetric_hz=4.0)]) == [], "a finding stands in its place"


def test_the_page_names_cut_and_failed_files_among_all_and_no_normal_verdict() -> None:
    failed = {"file": "/log/bad.mcap", "failed": "/log/bad.mcap: is empty (0 bytes)"}
    shared = {"verdict": "usable", "withheld: sigma too large": 9, "active_ratio": 0.7705, "cut": False}
    rows = [failed, *(flight(number, **shared) for number in range(3)), flight(3, verdict="usable", cut=True)]
    text = render("report", rows)
    assert "4 of 5 files give a result (1 of them cut off), 1 airframe" in text.lower()
    assert "cut off while recording, and judged by what is there: 3.mcap" in text
    assert "verdict: usable" not in text
    assert "withheld now and then is normal" in text
    assert '<td>withheld: sigma too large</td><td class="n">3 of 4</td>' in text
    assert "<td>bad.mcap</td><td>is empty (0 bytes)</td>" in text, "the name of the file is not said twice"
    every_file = text.partition("Every file")[2]
    assert '<td>bad.mcap</td><td class="bad">failed</td>' in every_file
    assert "<td>3.mcap</td><td>cut</td>" in every_file
    assert '<th class="n">service active, % of time</th>' in every_file
    assert '<td class="n">77.05</td>' in every_file
    assert "spanwise fleet report" in text
    assert 'class="verdict good"' in render("report", rows[1:4])


def test_what_comes_equally_often_is_listed_in_the_same_order_in_every_run() -> None:
    names = [f"withheld: reason {letter}" for letter in "hgfedcba"]
    text = render("report", [flight(number, **dict.fromkeys(names, 1)) for number in range(2)])
    places = [text.index(name) for name in sorted(names)]
    assert places == sorted(places)


def test_a_long_name_keeps_its_end_beneath_the_picture() -> None:
    assert short_name("/log/flight-2026-11-26T10-30-05.mcap") == "…26-11-26T10-30-05"
    assert short_name("/log/7.mcap") == "7"


def test_a_mode_that_falls_and_a_sensor_whose_noise_grows_are_named_once_each_with_their_change() -> None:
    rng = np.random.default_rng(5)
    steady = [flight(k, symmetric_hz=5.0 + 0.03 * rng.standard_normal(), left_noise=0.02) for k in range(30)]
    assert findings(steady) == []
    # thirds of a line that falls by 6 % are 4 % apart, two thirds of all
    aged = [row | {"airframe": "old", "symmetric_hz": row["symmetric_hz"] * (1.0 - 0.06 * k / 29),
                   "left_noise": 0.02 * (1.0 + k / 29)} for k, row in enumerate(steady)]  # fmt: skip
    named = findings([*steady, *aged])
    assert len(named) == 2
    (softer,) = [text for text in named if "symmetric mode" in text]
    percent = float(softer.partition("(")[2].partition(" %")[0])
    assert percent == pytest.approx(-4.0, abs=1.2), "three sigma of two medians of ten flights"
    assert softer.startswith("old: symmetric mode went from ")
    assert any(text.startswith("old: left sensor's noise went from") for text in named)


def test_a_sensor_without_noise_is_stuck_and_spoils_no_median() -> None:
    noises = [0.0, 1e-17, 0.0, *(0.02 + 1e-4 * (k % 2) for k in range(9))]
    rows = [flight(k, left_noise=noise) for k, noise in enumerate(noises)]
    expected = "nadir-2m: left sensor is stuck: it has no noise at all in 3 of 12 flights, first in 0.mcap"
    assert findings(rows) == [expected]
    assert unremarkable(rows) == []


def test_a_drift_from_nothing_has_no_percentage() -> None:
    rows = [flight(k, symmetric_damping=0.0 if k < 4 else 0.02, symmetric_damping_sigma=1.0) for k in range(9)]
    assert findings(rows) == [
        "nadir-2m: symmetric mode's damping went from 0 to 0.02 of critical between the first and the last third of "
        "9 flights"
    ]


def test_what_is_not_shown_of_many_findings_is_no_aircraft_without_any() -> None:
    rows = [
        flight(k, airframe=f"a{aircraft}", symmetric_hz=5.5 if k == 5 else 5.0)
        for aircraft in range(25)
        for k in range(6)
    ]
    said = sentences(rows)
    assert len(said) == 21, "twenty of them"
    assert said[-1] == "and 5 more"


def test_a_flight_is_held_against_a_median_that_has_a_sigma_of_its_own() -> None:
    """One long flight among short ones: the median is known to 0.03 Hz, whatever the long one's sigma is."""
    short = [flight(k, symmetric_hz=5.0 + 0.05 * (k - 2), symmetric_sigma_hz=0.05) for k in range(5)]
    assert findings([*short, flight(9, symmetric_hz=5.06, symmetric_sigma_hz=0.005)]) == []
    assert len(findings([*short, flight(9, symmetric_hz=5.2, symmetric_sigma_hz=0.005)])) == 1
    assert findings([*short, flight(9, symmetric_hz=5.2, symmetric_sigma_hz=None)]) == [], "nothing judges it"


@pytest.mark.parametrize("count", [9, 12, 30])
def test_flights_that_only_scatter_drift_no_oftener_than_three_sigmas(count: int) -> None:
    """Four figures; 300 aircraft of which less than one drifts by chance. A change of 20 % is named."""
    rng = np.random.default_rng(count)
    spread = {"symmetric_hz": (5.0, 0.01), "antisymmetric_hz": (6.4, 0.01),
              "symmetric_damping": (0.03, 0.15), "antisymmetric_damping": (0.03, 0.15)}  # fmt: skip
    rows = [
        {"file": f"{k}.mcap", "airframe": f"a{aircraft}", "symmetric_sigma_hz": 1.0, "antisymmetric_sigma_hz": 1.0,
         "symmetric_damping_sigma": 1.0, "antisymmetric_damping_sigma": 1.0}
        | {name: level * (1.0 + ratio * rng.standard_normal()) for name, (level, ratio) in spread.items()}
        for aircraft in range(300) for k in range(count)
    ]  # fmt: skip
    assert len([text for text in findings(rows) if "went from" in text]) <= 3
    softer = [row | {"symmetric_hz": float(row["symmetric_hz"]) * (0.8 if k >= count // 2 else 1.0)}
              for k, row in enumerate(rows[:count])]  # fmt: skip
    assert findings(softer)[0].startswith("a0: symmetric mode went from")


def test_a_quieter_or_faster_sensor_is_no_finding() -> None:
    rows = [flight(k, left_noise=0.02 / (1 + k), left_rate_hz=900.0 + 10 * k) for k in range(12)]
    assert [text for text in findings(rows) if "went" in text] == []


def test_a_diagnosis_becomes_a_row_and_what_it_names_twice_a_finding() -> None:
    cause = {"name": "accel-scale", "parameters": {"left": {"value": 0.031, "sigma": 0.002}}}
    result = {"airframe": "a", "verdict": "explained", "reason": "", "causes": [cause],
              "gain": {"total": {"after": 42.0}}}  # fmt: skip
    rows = [{"file": f"{k}.mcap"} | diagnosis_row(result) for k in range(2)]
    rows.append({"file": "2.mcap"} | diagnosis_row(result | {"verdict": "adequate", "causes": [], "gain": None}))
    assert rows[0]["effects"] == "accel-scale"
    assert rows[2]["held_out_gain_nat"] is None
    assert findings(rows) == ["a: accel-scale named in 2 of 3 flights, median 0.031 (0.031 to 0.031)"]
    page = render("diagnose", rows)
    assert "effect: accel-scale" in page
    assert "withheld now and then" not in page


def test_the_lowest_mode_of_each_family_is_the_row_of_an_identification() -> None:
    mode = {"frequency_hz": 5.0, "frequency_sigma_hz": 0.02, "damping": 0.03, "damping_sigma": 0.004, "resolved": True}
    tone = mode | {"frequency_hz": 3.3, "resolved": False}
    row = identification_row(
        {"airframe": "a", "symmetric": [tone, mode, mode | {"frequency_hz": 27.0}], "antisymmetric": [tone]}
    )
    assert (row["symmetric_hz"], row["symmetric_damping"], row["symmetric_modes"]) == (5.0, 0.03, 2)
    assert (row["antisymmetric_hz"], row["antisymmetric_modes"]) == (None, 0)


def test_a_tuning_s_row_has_the_outcome_of_what_it_proposes() -> None:
    flown, better = ({"ranges": 90, "trusted": trusted, "sigma_ratio": 0.02} for trusted in (60, 75))
    trials = [{"changes": {}, "outcome": flown}, {"changes": {"GATE": 4.0}, "outcome": better}]
    row = tuning_row({"trials": trials, "proposal": {"GATE": 4.0}})
    assert (row["trials"], row["proposal"], row["trusted"], row["trusted_then"]) == (1, "GATE=4", 60, 75)
    assert row["proposed: GATE=4"]
    assert tuning_row({"trials": trials, "proposal": {}})["trusted_then"] is None


def test_a_parquet_table_holds_each_column_in_one_type(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: pip install 'spanwise[fleet]'")
    rows = [
        {"file": "a", "ranges": 3, "rate": 1000, "word": "x", "none": None},
        {"file": "b", "rate": 999.5, "word": 2},
    ]
    write_parquet(rows, tmp_path / "fleet.parquet")
    table = parquet.read_table(tmp_path / "fleet.parquet")
    assert table.to_pydict() == {"file": ["a", "b"], "ranges": [3, None], "rate": [1000.0, 999.5],
                                 "word": ["x", "2"], "none": [None, None]}  # fmt: skip
    assert [str(kind) for kind in table.schema.types] == ["string", "int64", "double", "string", "string"]


def test_white_noise_of_known_density_is_read_from_a_station_below_a_slow_wing() -> None:
    density, rate_hz = 0.02, 1000.0
    rng = np.random.default_rng(3)
    t_ns = np.arange(6000) * 1_000_000
    values = np.zeros((6000, 6))
    values[:, 2] = density * np.sqrt(0.5 * rate_hz) * rng.standard_normal(6000)
    values[:, 2] += 20.0 * np.sin(2.0 * np.pi * 5.0 * t_ns * 1e-9) - 9.8
    log = gather([ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values, Axis.ALL, int(t_ns[-1]))])
    # 11 half-overlapped segments, 200 bins: the median of chi-squared averages lies 3 % low in amplitude at most
    measured = log.noise_density(Station.LEFT)
    assert measured == pytest.approx(density, rel=0.06)
    assert log.noise_density(Station.RIGHT) is None


def test_what_a_low_pass_takes_of_the_noise_is_given_back_or_the_noise_is_not_known() -> None:
    """At a rate of 400 Hz the band is 100 to 180 Hz: of a corner at 20 Hz a twenty-fourth comes through, and is none.

    The filter runs at 2 kHz in the autopilot, which sends every fifth sample; what folds back is a fifth at 180 Hz.
    """
    density, rate_hz = 0.02, 2000.0
    rng = np.random.default_rng(3)
    white = density * np.sqrt(0.5 * rate_hz) * rng.standard_normal(60_000)
    measured = {}
    for corner_hz in (20.0, 120.0):
        biquad = Biquad.lowpass(corner_hz, rate_hz)
        values = np.zeros((12_000, 6))
        values[:, 2] = lfilter(biquad.b, (1.0, *biquad.a), white)[::5]
        t_ns = np.arange(12_000) * 2_500_000
        log = gather([ImuBatch(Station.ROOT, ClockName.HOST, t_ns, values, Axis.ALL, int(t_ns[-1]))])
        measured[corner_hz] = log.noise_density(Station.ROOT, corner_hz)
    assert measured == {20.0: None, 120.0: pytest.approx(density, rel=0.1)}


def test_the_row_of_a_flight_counts_the_low_pass_that_the_vehicle_told(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).standard_normal((4000, 6))
    t_ns = np.arange(4000) * 2_500_000
    batch = ImuBatch(Station.ROOT, ClockName.HOST, t_ns, noise, Axis.ALL, int(t_ns[-1]))
    recording = SimpleNamespace(path=tmp_path / "a.mcap", airframe=load_airframe("nadir-2m"))
    assert flight_row(recording, gather([batch]))["root_noise"] is None, "the file's 20 Hz"
    unfiltered = AutopilotParameter("INS_ACCEL_FILTER", 0.0, 0)
    # white of 1 m/s^2 rms at 400 Hz
    expected = pytest.approx(np.sqrt(1.0 / 200.0), rel=0.06)
    assert flight_row(recording, gather([unfiltered, batch]))["root_noise"] == expected


def record(path: Path, seconds: float) -> None:
    writer = McapWriter(path, About.of(load_airframe("nadir-2m"), Settings()))
    for step in range(round(50 * seconds)):
        t_ns = step * 20_000_000 + np.arange(20) * 1_000_000
        values = np.tile([0.0, 0.0, -9.8, 0.0, 0.0, 0.0], (20, 1))
        writer.write(ImuBatch(Station.LEFT, ClockName.HOST, t_ns, values, Axis.ALL, int(t_ns[-1])))
        writer.write(Tick(int(t_ns[-1])))
    writer.close()


@pytest.mark.slow
def test_the_command_writes_table_page_and_parts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    record(logs / "a.mcap", 1.0)
    record(logs / "b.mcap", 2.0)
    all_bytes = (logs / "b.mcap").read_bytes()
    (logs / "b.mcap").write_bytes(all_bytes[: len(all_bytes) * 9 // 10])
    (logs / "broken.mcap").write_bytes(b"no recording")
    command = ["fleet", "report", str(logs), "--out", str(tmp_path / "out"), "--workers", "2"]
    assert main(command) == 1, "a script notices that a file failed"
    assert "2 of 3 files" in capsys.readouterr().out
    table = list(csv.DictReader((tmp_path / "out" / "fleet.csv").read_text().splitlines()))
    assert [Path(row["file"]).name for row in table] == ["a.mcap", "b.mcap", "broken.mcap"]
    assert [row["left_rate_hz"] for row in table] == ["1000.0", "1000.0", ""]
    assert [row["cut"] for row in table] == ["False", "True", ""]
    page = (tmp_path / "out" / "fleet.html").read_text()
    assert "2 of 3 files give a result" in page
    assert "broken.mcap" in page
    assert len(list((tmp_path / "out" / "pages").iterdir())) == 2
    parts = [json.loads(part_file.read_text()) for part_file in (tmp_path / "out" / "parts").iterdir()]
    assert sum("failed" in summary for summary in parts) == 1
    (logs / "broken.mcap").unlink()
    assert main(command) == 0


def test_folders_of_tables_are_recordings_wherever_they_lie_and_converted_ones_are_none(tmp_path: Path) -> None:
    for name in (
        "lab/accel.csv",
        "deep/lab2/accel_left.csv",
        "deep/lab2/accel_right.csv",
        "tables/samples_host/accel.csv",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("t_s,left_z_mps2\n0,-9.8\n")
    (tmp_path / "deep" / "a.mcap").touch()
    expected = [tmp_path / "deep" / "a.mcap", tmp_path / "deep" / "lab2", tmp_path / "lab"]
    assert fleet._files([tmp_path]) == expected
    assert fleet._files([tmp_path / "deep" / "lab2"]) == [tmp_path / "deep" / "lab2"]


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    assert main(["fleet", "report", str(tmp_path), "--out", str(tmp_path / "out")]) == 1


def test_a_file_is_tuned_by_the_worker_that_has_it_and_by_no_pool_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[str]] = []
    monkeypatch.setattr(fleet_tasks, "main", lambda words: asked.append(words) or 3)  # type: ignore[func-returns-value]
    (tmp_path / "flight.mcap").touch()
    monkeypatch.setattr(fleet_tasks, "_is_cut", lambda _path: False)
    (task,) = tasks_of([tmp_path / "flight.mcap"], ("tune",), tmp_path)
    fleet_tasks.work(task)
    assert asked[0][asked[0].index("--workers") + 1] == "1"
