"""One task a part file, in processes of their own; a further run makes only what is missing.

A task that fails leaves its reason and nothing else. A worker that dies (no memory, killed) costs the task it had,
which is given to another one once more. The results do not depend on the number of workers.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from companion.errors import SpanwiseError

_TRIES = 2  # chosen: of a task whose worker died: once may be memory, twice is the task
Row = dict[str, Any]


class Task(Protocol):
    """Work that leaves a part file: a picklable value."""

    @property
    def name(self) -> str:
        """Subject of the task, as its row and its reason of failure name it."""

    @property
    def result_file(self) -> Path:
        """Where the row lies once it is made."""


T = TypeVar("T", bound=Task)


def stored(task: Task) -> Row | None:
    """Result of an earlier run; None where there is none, or it failed."""
    try:
        row = json.loads(task.result_file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return row if isinstance(row, dict) and not row.get("failed") else None


def split_stored(tasks: Sequence[T]) -> tuple[list[tuple[T, Row]], list[T]]:
    """Tasks with a result of an earlier run, each with its row, and those without."""
    rows = [(task, stored(task)) for task in tasks]
    return [(task, row) for task, row in rows if row is not None], [task for task, row in rows if row is None]


def run(tasks: Sequence[T], work: Callable[[T], Row], workers: int) -> Iterator[tuple[T, Row]]:
    """Give each task's result as it is made, those of an earlier run first.

    ``work`` is a function at the top of a module, called in a worker.
    """
    earlier, missing = split_stored(tasks)
    yield from earlier
    if missing:
        yield from _made(deque((task, 1) for task in missing), work, min(workers, len(missing)))


def attempt(task: T, work: Callable[[T], Row]) -> Row:
    """Do one task here and write its part; an exception, of the writing too, becomes the row's reason of failure."""
    try:
        row = work(task)
    except SpanwiseError as error:
        row = failure(task, str(error))
    except Exception as error:  # whatever it is: the other tasks are worked on
        row = failure(task, f"{type(error).__name__}: {error}")
    try:
        write_part(task, row)
    except OSError as error:
        return failure(task, f"its part could not be written: {error.strerror}")
    return row


def failure(task: Task, reason: str) -> Row:
    """Row of a task of which nothing came."""
    return {"file": task.name, "failed": reason}


def write_part(task: Task, row: Row) -> None:
    """Write the part, all of it or nothing."""
    task.result_file.parent.mkdir(parents=True, exist_ok=True)
    beside = task.result_file.with_suffix(f".{os.getpid()}")
    beside.write_text(json.dumps(row), encoding="utf-8")
    beside.replace(task.result_file)


@dataclass(slots=True)
class _TaskWorker(Generic[T]):
    """A process, the line to it, and the task that it has."""

    process: BaseProcess
    line: Connection
    task: T | None = None
    tries: int = 0


def _made(missing: deque[tuple[T, int]], work: Callable[[T], Row], count: int) -> Iterator[tuple[T, Row]]:
    # workers are what is parallel: threads of linear algebra beside other work wait longer than they compute
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    pool: list[_TaskWorker[T]] = [_start(work) for _ in range(count)]
    try:
        while missing or any(worker.task is not None for worker in pool):
            for worker in pool:
                if worker.task is None and missing:
                    worker.task, worker.tries = missing.popleft()
                    with contextlib.suppress(OSError):  # it has ended meanwhile: its line says so below
                        worker.line.send(worker.task)
            for ready in wait([worker.line for worker in pool if worker.task is not None]):
                place = next(i for i, worker in enumerate(pool) if worker.line is ready)
                worker = pool[place]
                task = worker.task
                assert task is not None
                try:
                    row = worker.line.recv()
                    worker.task = None
                except (EOFError, OSError):
                    worker.process.join()
                    pool[place] = _start(work)
                    if worker.tries < _TRIES:
                        missing.append((task, worker.tries + 1))
                        continue
                    row = failure(task, f"its worker ended ({worker.process.exitcode}), {_TRIES} times")
                    with contextlib.suppress(OSError):  # a failure is tried again by a further run anyway
                        write_part(task, row)
                yield task, row
    finally:
        for worker in pool:
            worker.line.close()
            worker.process.terminate()
            worker.process.join()


def _start(work: Callable[[T], Row]) -> _TaskWorker[T]:
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=_serve, args=(theirs, work), name="spanwise-fleet", daemon=True)
    process.start()
    theirs.close()
    return _TaskWorker(process, ours)


def _serve(line: Connection, work: Callable[[Any], Row]) -> None:
    """Work off tasks until the line is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        while True:
            line.send(attempt(line.recv(), work))
    except (EOFError, OSError):
        return
