"""Many tasks worked off by processes here or by a Dask cluster, with a line for each as it ends."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from companion.evaluation.fleet.cluster import run_on_cluster
from companion.evaluation.fleet.file_task import reason_alone
from companion.evaluation.fleet.runner import Row, Task, run
from companion.reporting.page import printable

T = TypeVar("T", bound=Task)


def work_off(
    tasks: Sequence[T],
    work: Callable[[T], Row],
    workers: int,
    scheduler: str = "",
    describe: Callable[[Row], str] = lambda row: f"{row['file']} done",
) -> list[Row]:
    """Give the rows in the order of the tasks, whose names differ; ``describe`` is the line of a row that did not fail.

    Texts of the rows can be printed and written, whatever bytes the files' names have.

    Raises
    ------
    MissingExtra, LinkError
        As :func:`companion.evaluation.fleet.cluster.run_on_cluster` does, where ``scheduler`` is an address.
    """
    began_s = time.monotonic()
    rows: dict[str, Row] = {}
    results = run_on_cluster(tasks, work, scheduler) if scheduler else run(tasks, work, workers)
    for task, made in results:
        row = {key: printable(value) if isinstance(value, str) else value for key, value in made.items()}
        rows[task.name] = row
        failed, name = row.get("failed"), printable(task.name)
        what = f"{name} failed: {reason_alone(name, str(failed))}" if failed else describe(row)
        took_s = time.monotonic() - began_s
        print(f"{len(rows)}/{len(tasks)}, {took_s:.0f} s: {what}", file=sys.stderr, flush=True)
    return [rows[task.name] for task in tasks]
