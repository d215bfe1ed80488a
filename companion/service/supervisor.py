"""Start the processes of the service, restart the one that dies, stop them all cleanly.

A process that never ran for a minute is set up wrongly: after a few tries the service gives up, with its message on the
screen. One that has run (a camera that came loose in flight) is tried again for as long as the service lives, in
growing pauses, while the others go on and the heartbeat tells.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import SpawnProcess
from typing import Any

from companion.lifetime import die_with_parent
from companion.ports import Clock

_STOP_S = 1.2
_LAST_STOP_S = 2.0
_TERMINATED_S = 0.4
_MOST_RESTARTS = 5
_SECOND_NS = 1_000_000_000
_STEADY_NS = 60 * _SECOND_NS
_LONGEST_PAUSE_NS = 30 * _SECOND_NS

SPAWN = multiprocessing.get_context("spawn")


@dataclass(slots=True)
class Worker:
    """One process: how to start it, and how often it had to be started again since it last ran for a minute.

    ``optional`` is one that the others can do without, ``last`` one that ends after the others, whose records it takes.
    """

    name: str
    target: Callable[..., None]
    arguments: tuple[Any, ...]
    optional: bool = False
    last: bool = False
    process: SpawnProcess | None = None
    restarts: int = 0
    proven: bool = False
    started_ns: int = 0
    again_ns: int | None = None

    def start(self, now_ns: int) -> None:
        """Start a fresh process."""
        self.started_ns, self.again_ns = now_ns, None
        self.process = SPAWN.Process(
            target=_bound, args=(self.target, *self.arguments), name=f"spanwise-{self.name}", daemon=False
        )
        self.process.start()

    def alive(self) -> bool:
        """Whether the process runs."""
        return self.process is not None and self.process.is_alive()

    @property
    def given_up(self) -> bool:
        """Whether it is not tried again."""
        return not self.proven and self.restarts >= _MOST_RESTARTS

    def pause_ns(self) -> int:
        """How long to wait for the next try: the first comes at once, then 1, 2, 4 ... 30 s."""
        return min(_SECOND_NS << min(self.restarts - 1, 5), _LONGEST_PAUSE_NS) if self.restarts else 0


def _bound(target: Callable[..., None], *arguments: Any) -> None:
    """Be a worker that does not outlive the supervisor."""
    die_with_parent()
    target(*arguments)


class Supervisor:
    """Owns the workers and the stop flag. Use as a context manager."""

    def __init__(self, clock: Clock) -> None:
        self.stop_flag = SPAWN.Event()
        self._clock = clock
        self._workers: list[Worker] = []

    def add(
        self, name: str, target: Callable[..., None], *arguments: Any, optional: bool = False, last: bool = False
    ) -> None:
        """Register a worker (see :class:`Worker`); its target gets the arguments and the stop flag."""
        self._workers.append(Worker(name, target, (*arguments, self.stop_flag), optional, last))

    def __enter__(self) -> Supervisor:
        for worker in self._workers:
            worker.start(self._clock.now_ns())
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def tend(self) -> list[str]:
        """Restart what has died; give a sentence for each. Call it about once a second."""
        now_ns = self._clock.now_ns()
        sentences = []
        for worker in self._workers:
            if worker.alive():
                if now_ns - worker.started_ns >= _STEADY_NS:
                    worker.proven, worker.restarts = True, 0
            elif not worker.given_up:
                sentences += _revived(worker, now_ns)
        return sentences

    def failed(self) -> list[str]:
        """Workers that died for good and without whom there is no service."""
        return [
            worker.name for worker in self._workers if worker.given_up and not worker.alive() and not worker.optional
        ]

    def stop(self) -> None:
        """Ask all to end, and end those that do not; all is over within 3 s."""
        self.stop_flag.set()
        began_ns = self._clock.now_ns()
        for last, allowed_s in ((False, _STOP_S), (True, _LAST_STOP_S)):
            processes = [w.process for w in self._workers if w.last is last and w.process is not None]
            self._await(processes, began_ns, allowed_s)
            for process in processes:
                if process.is_alive():
                    process.terminate()
            self._await(processes, began_ns, allowed_s + _TERMINATED_S)
            for process in processes:
                if process.is_alive():
                    process.kill()

    def _await(self, processes: list[SpawnProcess], began_ns: int, allowed_s: float) -> None:
        for process in processes:
            process.join(max(0.0, allowed_s - (self._clock.now_ns() - began_ns) * 1e-9))


def _revived(worker: Worker, now_ns: int) -> list[str]:
    """Start a dead worker when its pause is over; a sentence when it is found dead."""
    said = []
    if worker.again_ns is None:
        pause_ns = worker.pause_ns()
        worker.again_ns = now_ns + pause_ns
        worker.restarts += 1
        code = worker.process.exitcode if worker.process else None
        when = f"again in {pause_ns // _SECOND_NS} s" if pause_ns else "started again"
        said.append(f"process {worker.name} ended ({code}); {when} (try {worker.restarts})")
    if now_ns >= worker.again_ns:
        worker.start(now_ns)
    return said
