"""Many flights at once: parts, failures, killed workers, and the same results whatever the number of processes."""

from __future__ import annotations

import csv
import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli.main import main
from companion.errors import RecordingError
from companion.evaluation.fleet.page import findings
from companion.evaluation.fleet.rows import as_csv, flattened
from companion.evaluation.fleet.runner import FileTask, run, tasks_of
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Axis, ClockName, ImuBatch, Station, Tick


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


def test_results_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    paths = files(tmp_path, "one", "two", "bad", "odd", "three")
    got = [results(paths, tmp_path / f"out{workers}", workers) for workers in (1, 2)]
    assert got[0] == got[1]
    assert [got[0][name]["letters"] for name in ("one", "two", "three")] == [1, 2, 5]
    assert "cannot be read" in got[0]["bad"]["failed"]
    assert got[0]["odd"]["failed"] == "ZeroDivisionError: a defect"


def test_a_second_run_makes_only_what_is_missing_or_has_changed(tmp_path: Path) -> None:
    paths = files(tmp_path, "one", "two")
    out = tmp_path / "out"
    first = results(paths, out, 1)
    assert results(paths, out, 1) == first
    assert paths[0].with_suffix(".count").read_text() == "x"
    paths[0].write_text("longer now")
    assert results(paths, out, 1)["one"]["letters"] == 10
    assert [path.with_suffix(".count").read_text() for path in paths] == ["xx", "x"]


def test_a_part_that_was_cut_off_is_made_anew(tmp_path: Path) -> None:
    (path,) = files(tmp_path, "one")
    out = tmp_path / "out"
    results([path], out, 1)
    (part,) = (out / "parts").iterdir()
    part.write_text('{"file": "o')
    assert results([path], out, 1)["one"]["letters"] == 1


def test_a_killed_worker_costs_nothing_but_time_and_a_deadly_file_only_itself(tmp_path: Path) -> None:
    paths = files(tmp_path, "once", "deadly", "other", "more")
    got = results(paths, tmp_path / "out", 2)
    assert [got[name].get("letters") for name in ("once", "other", "more")] == [1, 3, 4]
    assert "its worker ended (-9), 2 times" in got["deadly"]["failed"]


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


def test_a_mode_that_leaves_its_median_and_a_sensor_that_slows_are_named() -> None:
    rows = [flight(number) for number in range(6)]
    assert findings(rows) == []
    drifted, slowed = flight(7, symmetric_hz=4.6), flight(8, left_rate_hz=900.0)
    first, second = findings([*rows, drifted, slowed])
    assert "left sensor 10 % slower than usual in 8.mcap" in first
    assert "symmetric mode -0.41 Hz off its median 5.01 Hz in 7.mcap" in second
    other = flight(9, airframe="forward-2m", symmetric_hz=3.0)
    assert len(findings([*rows, other])) == 0, "another airframe has a median of its own"


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
    (logs / "broken.mcap").write_bytes(b"no recording")
    assert main(["fleet", "report", str(logs), "--out", str(tmp_path / "out"), "--workers", "2"]) == 0
    assert "2 of 3 files" in capsys.readouterr().out
    table = list(csv.DictReader((tmp_path / "out" / "fleet.csv").read_text().splitlines()))
    assert [Path(row["file"]).name for row in table] == ["a.mcap", "b.mcap", "broken.mcap"]
    assert [row["left_rate_hz"] for row in table] == ["1000.0", "1000.0", ""]
    page = (tmp_path / "out" / "fleet.html").read_text()
    assert "2 of 3 files give a result" in page
    assert "broken.mcap" in page
    assert len(list((tmp_path / "out" / "pages").iterdir())) == 2
    parts = [json.loads(part.read_text()) for part in (tmp_path / "out" / "parts").iterdir()]
    assert sum("failed" in part for part in parts) == 1


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    assert main(["fleet", "report", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
