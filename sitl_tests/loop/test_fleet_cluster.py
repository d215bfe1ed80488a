"""A fleet on a real Dask cluster: the rows and parts of plain processes, whoever of its workers is killed."""

from __future__ import annotations

import gc
import json
import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main
from companion.errors import LinkError
from companion.evaluation.fleet.cluster import run_on_cluster
from companion.evaluation.fleet.file_task import FileTask, tasks_of
from companion.evaluation.fleet.runner import run

pytest.importorskip("distributed", reason="Dask is not installed: pip install 'spanwise[fleet]'")
from tools.bench.fleet_cluster import LocalCluster, local_cluster

pytestmark = pytest.mark.realtime
FILES = 24


def letters(task: FileTask) -> dict[str, Any]:
    """Count letters slowly; what is called odd is refused, what is called deadly kills its worker."""
    time.sleep(0.1)
    if task.path.stem.startswith("odd"):
        raise ZeroDivisionError("a defect")
    if task.path.stem.startswith("deadly"):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"file": task.name, "letters": len(task.path.read_text())}


def files(folder: Path, *further: str) -> list[Path]:
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{name}.txt" for name in (*(f"flight{number:02d}" for number in range(FILES)), *further)]
    for place, path in enumerate(paths):
        path.write_text("a" * (place + 1))
    return paths


def by_name(results: Iterator[tuple[FileTask, dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    return {task.path.stem: row for task, row in results}


def parts(folder: Path) -> dict[str, Any]:
    return {path.name: json.loads(path.read_text()) for path in (folder / "parts").iterdir()}


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    with local_cluster(2) as started:
        yield started


def test_a_cluster_of_which_a_worker_is_killed_half_way_gives_what_processes_give(
    tmp_path: Path, cluster: LocalCluster
) -> None:
    paths = files(tmp_path / "logs", "odd")
    wanted = by_name(run(tasks_of(paths, ("letters",), tmp_path / "processes"), letters, 2))
    tasks = tasks_of(paths, ("letters",), tmp_path / "dask")
    got: dict[str, dict[str, Any]] = {}
    for task, row in run_on_cluster(tasks, letters, cluster.address):
        got[task.path.stem] = row
        if len(got) == len(paths) // 2:
            os.kill(cluster.workers[0].pid, signal.SIGKILL)
    assert cluster.workers[0].wait(10) == -signal.SIGKILL, "the worker was there to be killed"
    assert got == wanted
    assert [got[f"flight{number:02d}"]["letters"] for number in range(FILES)] == list(range(1, FILES + 1))
    assert got["odd"]["failed"] == "ZeroDivisionError: a defect"
    assert parts(tmp_path / "dask") == parts(tmp_path / "processes")


def test_a_further_run_on_a_cluster_goes_on_from_the_parts(tmp_path: Path, cluster: LocalCluster) -> None:
    paths = files(tmp_path / "logs")
    tasks = tasks_of(paths, ("letters",), tmp_path / "out")
    begun = by_name(run(tasks[: FILES // 2], letters, 1))
    written = {task.result_file: task.result_file.stat().st_mtime_ns for task in tasks[: FILES // 2]}
    got = by_name(run_on_cluster(tasks, letters, cluster.address))
    assert begun.items() <= got.items()
    assert len(got) == FILES
    assert {path: path.stat().st_mtime_ns for path in written} == written, "what was made is not made again"


def test_a_file_that_kills_every_worker_costs_itself_alone(tmp_path: Path) -> None:
    # the first death condemns the file and what waited on the same worker; alone it takes a second worker with it
    with local_cluster(3, deaths=0) as cluster:
        paths = files(tmp_path / "logs", "deadly")
        got = by_name(run_on_cluster(tasks_of(paths, ("letters",), tmp_path / "out"), letters, cluster.address))
    assert got["deadly"]["failed"] == "its worker ended each time"
    assert sum("letters" in row for row in got.values()) == FILES


def test_an_address_where_nobody_listens_is_refused_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("companion.evaluation.fleet.cluster._CONNECT_S", 0.5)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    (tmp_path / "a.mcap").write_bytes(b"no recording")
    words = ["fleet", "report", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "out"), "--scheduler", address]
    assert main(words) == 1
    assert f"--scheduler {address}: no Dask scheduler answers there" in capsys.readouterr().err
    began_s = time.monotonic()
    for nowhere in ("no address at all", "bogus.invalid:8786", "tcp://127.0.0.1:no"):
        with pytest.raises(LinkError, match="no Dask scheduler answers"):
            list(run_on_cluster(tasks_of([tmp_path / "a.mcap"], (), tmp_path / "out"), letters, nowhere))
    gc.collect()
    assert time.monotonic() - began_s < 10.0, "no client waits for a scheduler, or complains at its end"
    assert "Traceback" not in capsys.readouterr().err
