"""Start the processes of the service, restart the one that dies, stop them all cleanly."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import SpawnProcess
from typing import Any

_STOP_S = 5.0
_MOST_RESTARTS = 5

SPAWN = multiprocessing.get_context("spawn")


@dataclass(slots=True)
class Worker:
    """One process: how to start it, and how often it had to be started again."""

    name: str
    target: Callable[..., None]
    arguments: tuple[Any, ...]
    process: SpawnProcess | None = None
    restarts: int = 0

    def start(self) -> None:
        """Start a fresh process."""
        self.process = SPAWN.Process(
            target=self.target, args=self.arguments, name=f"spanwise-{self.name}", daemon=False
        )
        self.process.start()

    def alive(self) -> bool:
        """Whether the process runs."""
        return self.process is not None and self.process.is_alive()


class Supervisor:
    """Owns the workers and the stop flag. Use as a context manager."""

    def __init__(self) -> None:
        self.stop_flag = SPAWN.Event()
        self._workers: list[Worker] = []

    def add(self, name: str, target: Callable[..., None], *arguments: Any) -> None:
        """Register a worker; its target gets the arguments and the stop flag."""
        self._workers.append(Worker(name, target, (*arguments, self.stop_flag)))

    def __enter__(self) -> Supervisor:
        for worker in self._workers:
            worker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def tend(self) -> list[str]:
        """Restart what has died; give a sentence for each. Call it about once a second."""
        sentences = []
        for worker in self._workers:
            if worker.alive() or worker.restarts >= _MOST_RESTARTS:
                continue
            code = worker.process.exitcode if worker.process else None
            worker.restarts += 1
            sentences.append(f"process {worker.name} ended ({code}); restart {worker.restarts} of {_MOST_RESTARTS}")
            worker.start()
        return sentences

    def failed(self) -> list[str]:
        """Workers that died for good."""
        return [worker.name for worker in self._workers if not worker.alive() and worker.restarts >= _MOST_RESTARTS]

    def stop(self) -> None:
        """Ask all to end, wait, and end those that do not."""
        self.stop_flag.set()
        for worker in self._workers:
            if worker.process is not None:
                worker.process.join(_STOP_S)
                if worker.process.is_alive():
                    worker.process.terminate()
                    worker.process.join(1.0)
