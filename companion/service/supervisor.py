"""Start the processes of the service, restart the one that dies, stop them all cleanly.

A process that never ran for a minute is set up wrongly: after a few tries the service gives up, with its message on the
screen. One that has run (a camera that came loose in flight) is tried again for as long as the service lives, in
growing pauses, while the others go on and the heartbeat tells.

A worker may have a spare: a second process of it that has loaded everything and waits. It takes over as
soon as the first is found dead, and the next spare is made once the new one has settled.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import select
import socket
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from typing import Any

from companion.lifetime import StopFlag, die_with_parent
from companion.ports import Clock

_STOP_S = 1.2  # chosen: with the next two, all is over within 3 s
_LAST_STOP_S = 2.0  # chosen: the recorder has time for what the others leave
_TERMINATED_S = 0.4  # chosen: a process that hears SIGTERM ends within it
_KILLED_S = 0.2  # nothing outlives SIGKILL, but the kernel takes a moment (choice)
_MOST_RESTARTS = 5  # of a process that never came to work (choice)
_SECOND_NS = 1_000_000_000  # by definition
_STEADY_NS = 60 * _SECOND_NS  # chosen: a process that was set up wrongly does not live for a minute
_LONGEST_PAUSE_NS = 30 * _SECOND_NS  # chosen: a camera that was plugged in again is found half a minute later

_SETTLED_NS = 5 * _SECOND_NS  # chosen: the new process has the machine to itself while it starts
_LOOK_S = 0.2  # chosen: how late a waiting process sees that it is to end

SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True)
class StandbyGate:
    """Where a process of a worker with a spare waits until it is needed. Survives the death of either side."""

    end: socket.socket
    spare: bool = False

    def wait_for_turn(self, stop: StopFlag) -> bool:
        """Say that all is prepared, and wait; False where the service ends before."""
        self.end.send(b"ready")
        while not select.select([self.end], [], [], _LOOK_S)[0]:
            if stop.is_set():
                return False
        return bool(self.end.recv(8))


@dataclass(slots=True)
class _StandbyProcess:
    """A process that waits for its turn, and the supervisor's end of the line to it."""

    process: SpawnProcess
    line: socket.socket


@dataclass(slots=True)
class Worker:
    """One process: how to start it, and how often it had to be started again since it last ran for a minute.

    ``optional`` is one that the others can do without, ``last`` one that ends after the others, whose records it takes.
    With ``standby`` the target gets a :class:`StandbyGate` before the stop flag.
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
    standby: bool = False
    spare: _StandbyProcess | None = None
    line: socket.socket | None = None  # to the process, if it had to wait for its turn
    settled_ns: int | None = None

    def start(self, now_ns: int) -> None:
        """Start a fresh process, or let the spare take over."""
        self.started_ns, self.again_ns, self.settled_ns = now_ns, None, None
        if not self.standby:
            self.process = self._spawned(*self.arguments)
            return
        spare = self.spare if self.spare is not None and self.spare.process.is_alive() else self._waiting(spare=False)
        if self.line is not None:
            self.line.close()
        self.process, self.line, self.spare = spare.process, spare.line, None
        with contextlib.suppress(OSError):  # it has just died: the next look finds it so
            self.line.send(b"go")

    def prepare(self, now_ns: int) -> None:
        """Have a spare ready, once the process itself is and has settled: both would want the same processor."""
        if not self.standby or self.line is None or (self.spare is not None and self.spare.process.is_alive()):
            return
        if self.settled_ns is None:
            with contextlib.suppress(OSError):
                self.settled_ns = now_ns + _SETTLED_NS if self.line.recv(8) else None
        elif now_ns >= self.settled_ns:
            self.settled_ns = now_ns + _STEADY_NS  # a spare that dies is not made anew at once
            self.spare = self._waiting(spare=True)

    def processes(self) -> list[SpawnProcess]:
        """All that were started and not replaced."""
        processes = [self.process, None if self.spare is None else self.spare.process]
        return [process for process in processes if process is not None]

    def _waiting(self, *, spare: bool) -> _StandbyProcess:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        *arguments, stop = self.arguments
        process = self._spawned(*arguments, StandbyGate(theirs, spare), stop)
        theirs.close()
        return _StandbyProcess(process, ours)

    def _spawned(self, *arguments: Any) -> SpawnProcess:
        process = SPAWN.Process(
            target=_bound, args=(self.target, *arguments), name=f"spanwise-{self.name}", daemon=False
        )
        process.start()
        return process

    def alive(self) -> bool:
        """Whether the process runs."""
        return self.process is not None and self.process.is_alive()

    @property
    def abandoned(self) -> bool:
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
        self.stop_flag = StopFlag()
        self._clock = clock
        self._workers: list[Worker] = []

    def add(
        self,
        name: str,
        target: Callable[..., None],
        *arguments: Any,
        optional: bool = False,
        last: bool = False,
        standby: bool = False,
    ) -> None:
        """Register a worker (see :class:`Worker`); its target gets the arguments and the stop flag."""
        self._workers.append(Worker(name, target, (*arguments, self.stop_flag), optional, last, standby=standby))

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
                worker.prepare(now_ns)
            elif not worker.abandoned:
                sentences += _revived(worker, now_ns)
        return sentences

    def rest(self, seconds: float) -> None:
        """Wait, but no longer than all processes live."""
        wait([worker.process.sentinel for worker in self._workers if worker.process and worker.alive()], seconds)

    def failed(self) -> list[str]:
        """Workers that died for good and without whom there is no service."""
        return [
            worker.name for worker in self._workers if worker.abandoned and not worker.alive() and not worker.optional
        ]

    def stop(self) -> None:
        """Ask all to end, and end those that do not; all is over within 3 s."""
        self.stop_flag.set()
        began_ns = self._clock.now_ns()
        for last, allowed_s in ((False, _STOP_S), (True, _LAST_STOP_S)):
            processes = [process for w in self._workers if w.last is last for process in w.processes()]
            self._await(processes, began_ns, allowed_s)
            for process in processes:
                if process.is_alive():
                    process.terminate()
            self._await(processes, began_ns, allowed_s + _TERMINATED_S)
            for process in processes:
                if process.is_alive():
                    process.kill()
                    process.join(_KILLED_S)

    def _await(self, processes: list[SpawnProcess], began_ns: int, allowed_s: float) -> None:
        for process in processes:
            process.join(max(0.0, allowed_s - (self._clock.now_ns() - began_ns) * 1e-9))


def _revived(worker: Worker, now_ns: int) -> list[str]:
    """Start a dead worker when its pause is over; a sentence when it is found dead."""
    said = []
    if worker.again_ns is None:
        waits = worker.spare is not None and worker.spare.process.is_alive()
        pause_ns = 0 if waits else worker.pause_ns()
        worker.again_ns = now_ns + pause_ns
        worker.restarts += 1
        code = worker.process.exitcode if worker.process else None
        if worker.abandoned:
            return [f"process {worker.name} ended ({code}); given up after {worker.restarts - 1} tries"]
        when = f"again in {pause_ns // _SECOND_NS} s" if pause_ns else "spare takes over" if waits else "started again"
        said.append(f"process {worker.name} ended ({code}); {when} (try {worker.restarts})")
    if now_ns >= worker.again_ns:
        worker.start(now_ns)
    return said
