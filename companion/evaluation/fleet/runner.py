"""One task a file in processes of their own; each leaves a part file, and a further run makes only what is missing.

A task that fails leaves its reason and nothing else. A worker that dies (no memory, killed) costs the task it had,
which is given to another one once more. The results do not depend on the number of workers.
"""

from __future__ import annotations

import dataclasses
import hashlib
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
from typing import Any

from companion.errors import SpanwiseError

_TRIES = 2  # of a task whose worker died


@dataclass(frozen=True, slots=True)
class FileTask:
    """Work on one file: what to do (words, as on a command line), and where its results go."""

    path: Path
    words: tuple[str, ...]
    folder: Path

    @property
    def key(self) -> str:
        """Name of the part: of the file's place, size and time, and of the words; another file of this name differs."""
        state = self.path.stat() if self.path.exists() else None
        identity: list[object] = [str(self.path.resolve()), list(self.words)]
        identity += [] if state is None else [state.st_size, state.st_mtime_ns]
        digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()
        return f"{self.path.stem}-{digest[:12]}"

    @property
    def result_file(self) -> Path:
        """Where the result lies when it is made."""
        return self.folder / "parts" / f"{self.key}.json"


Row = dict[str, Any]
Work = Callable[[FileTask], Row]


def stored(task: FileTask) -> Row | None:
    """Result of an earlier run; None where there is none, or it failed."""
    try:
        row = json.loads(task.result_file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return row if isinstance(row, dict) and not row.get("failed") else None


def run(tasks: Sequence[FileTask], work: Work, workers: int) -> Iterator[tuple[FileTask, Row]]:
    """Give each task's result as it is made, those of an earlier run first.

    ``work`` is a function at the top of a module, called in a worker.
    """
    missing: deque[tuple[FileTask, int]] = deque()
    for task in tasks:
        row = stored(task)
        if row is None:
            missing.append((task, 1))
        else:
            yield task, row
    if missing:
        missing[0][0].result_file.parent.mkdir(parents=True, exist_ok=True)
        yield from _made(missing, work, min(workers, len(missing)))


@dataclass(slots=True)
class _FileWorker:
    """A process, the line to it, and the task that it has."""

    process: BaseProcess
    line: Connection
    task: FileTask | None = None
    tries: int = 0


def _made(missing: deque[tuple[FileTask, int]], work: Work, count: int) -> Iterator[tuple[FileTask, Row]]:
    pool = [_start(work) for _ in range(count)]
    try:
        while missing or any(worker.task is not None for worker in pool):
            for worker in pool:
                if worker.task is None and missing:
                    worker.task, worker.tries = missing.popleft()
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
                    keep(task, row)
                yield task, row
    finally:
        for worker in pool:
            worker.line.close()
            worker.process.terminate()
            worker.process.join()


def _start(work: Work) -> _FileWorker:
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=_serve, args=(theirs, work), name="spanwise-fleet", daemon=True)
    process.start()
    theirs.close()
    return _FileWorker(process, ours)


def _serve(line: Connection, work: Work) -> None:
    """Work off tasks until the line is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        while True:
            task = line.recv()
            try:
                row = work(task)
            except SpanwiseError as error:
                row = failure(task, str(error))
            except Exception as error:  # whatever it is: the other files are worked on
                row = failure(task, f"{type(error).__name__}: {error}")
            keep(task, row)
            line.send(row)
    except (EOFError, OSError):
        return


def failure(task: FileTask, reason: str) -> Row:
    """Row of a file of which nothing came."""
    return {"file": str(task.path), "failed": reason}


def keep(task: FileTask, row: Row) -> None:
    """Write the part, whole or not at all."""
    beside = task.result_file.with_suffix(f".{os.getpid()}")
    beside.write_text(json.dumps(row), encoding="utf-8")
    beside.replace(task.result_file)


def tasks_of(paths: Sequence[Path], words: tuple[str, ...], folder: Path) -> list[FileTask]:
    """Tasks of the files, each once, in the order of their names."""
    unique = {path.resolve(): path for path in paths}
    blank = FileTask(Path(), words, folder)
    return [dataclasses.replace(blank, path=path) for _, path in sorted(unique.items())]
