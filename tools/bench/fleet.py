"""A fleet of recordings reported on one worker, on two, and on a Dask cluster of which a worker is killed half-way.

The table alone is made (``--no-pages``). All runs must give the same rows, and the findings must be those that were put
into the recordings. Processor time is that of all worker processes, their start included; what a longer recording costs
is measured on one of a minute, from which 10,000 flights of twenty minutes follow on paper.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from companion.cli.steps.fleet_tasks import NO_PAGES, work
from companion.evaluation.fleet.cluster import run_on_cluster
from companion.evaluation.fleet.file_task import FileTask, tasks_of
from companion.evaluation.fleet.runner import Row, run
from companion.evaluation.fleet.trends import findings
from tools.bench.fleet_cluster import local_cluster
from tools.bench.fleet_recordings import write_fleet

_LONG_S = 60.0
_FLIGHT_S = 1200.0
_FLIGHTS = 10_000
_EXPECTED = ("softening: symmetric mode went from", "noisy: left sensor's noise went from")

Results = Iterator[tuple[FileTask, Row]]


@dataclasses.dataclass(frozen=True, slots=True)
class FleetRun:
    """One run over all files: its rows by file, and what it took."""

    name: str
    rows: dict[str, Row]
    cpu_s: float
    elapsed_s: float

    @property
    def line(self) -> str:
        """The run as a line of the table."""
        count = len(self.rows)
        failed = sum(bool(row.get("failed")) for row in self.rows.values())
        each = f"{self.cpu_s / count:5.2f} s of processor time a file"
        return f"{self.name:44s} {count} files, {failed} failed, {each}, {self.elapsed_s:6.0f} s in all"


def main(arguments: list[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    paths = _recordings(options.out / f"logs-{options.files}-{options.seconds:g}", options.files, options.seconds)
    runs = []
    for name, results in _ways(paths, options.out):
        runs.append(_timed(name, results))
        print(runs[-1].line, flush=True)
    same = all(each.rows == runs[0].rows for each in runs)
    print(f"rows of all runs are {'identical' if same else 'DIFFERENT'}")
    named = findings(list(runs[0].rows.values()))
    for sentence in named:
        print(f"  {sentence}")
    right = len(named) == len(_EXPECTED) and all(any(each.startswith(text) for each in named) for text in _EXPECTED)
    print(f"findings are {'those that were put in, and no other' if right else 'NOT those that were put in'}")
    _print_costs(paths[0], options)
    return int(not (same and right))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=6.0, help="length of each recording")
    parser.add_argument("--out", type=Path, default=Path("out/bench-fleet"))
    return parser


def _recordings(folder: Path, count: int, duration_s: float) -> list[Path]:
    """The recordings; those of an earlier run where all are there."""
    existing = sorted(folder.glob("*.mcap"))
    return existing if len(existing) == count else write_fleet(folder, count, duration_s)


def _ways(paths: list[Path], out: Path) -> Iterator[tuple[str, Callable[[], Results]]]:
    stamp = f"{os.getpid()}"

    def tasks(name: str) -> list[FileTask]:
        return tasks_of(paths, ("report", NO_PAGES), out / f"{stamp}-{name}")

    yield "processes, 1 worker", lambda: run(tasks("one"), work, 1)
    yield "processes, 2 workers", lambda: run(tasks("two"), work, 2)
    yield "Dask, 2 workers, one killed half-way", lambda: _on_a_cluster(tasks("dask"))


def _on_a_cluster(tasks: list[FileTask]) -> Results:
    with local_cluster(2) as cluster:
        for number, entry in enumerate(run_on_cluster(tasks, work, cluster.address), 1):
            yield entry
            if number == len(tasks) // 2:
                os.kill(cluster.workers[0].pid, signal.SIGKILL)


def _timed(name: str, results: Callable[[], Results]) -> FleetRun:
    """Run all, and count the processor time of the processes that did it."""
    used_s, began_s = _children_s(), time.monotonic()
    rows: dict[str, Row] = {task.name: row for task, row in results()}
    return FleetRun(name, dict(sorted(rows.items())), _children_s() - used_s, time.monotonic() - began_s)


def _children_s() -> float:
    """Processor time of all processes that ended and were waited for, s."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _print_costs(short: Path, options: argparse.Namespace) -> None:
    (long,) = _recordings(options.out / f"logs-1-{_LONG_S:g}", 1, _LONG_S)
    size_mb = long.stat().st_size / 1e6 * _FLIGHT_S / _LONG_S
    print(f"on paper: {_FLIGHTS:,} flights of {_FLIGHT_S / 60:g} min, {size_mb:.0f} MB each without images:")
    for name, words in (("table alone", ("report", NO_PAGES)), ("with a page each", ("report",))):
        short_s, long_s = (_work_s(path, words, options.out) for path in (short, long))
        per_s = (long_s - short_s) / (_LONG_S - options.seconds)
        flight_s = short_s + per_s * (_FLIGHT_S - options.seconds)
        total_h = _FLIGHTS * flight_s / 3600.0
        print(
            f"  {name:17s} {short_s:.2f} s of processor time for {options.seconds:g} s of flight, {1e3 * per_s:.0f} ms "
            f"each second more: {flight_s:.0f} s a flight, {total_h:.0f} h of one core, {total_h / 64:.1f} h of 64"
        )


def _work_s(path: Path, words: tuple[str, ...], out: Path) -> float:
    """Processor time of one file in this process, the lesser of two."""
    times = []
    for _ in range(2):
        (task,) = tasks_of([path], words, out / "single")
        began_s = time.process_time()
        work(task)
        times.append(time.process_time() - began_s)
    return min(times)


if __name__ == "__main__":
    raise SystemExit(main())
