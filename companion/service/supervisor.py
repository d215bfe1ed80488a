"""Start the processes of the service, restart the one that dies, stop them all cleanly.

A process that never ran for a minute is set up wrongly: after a few tries the service gives up, with its message on the
screen. One that has run (a camera that came loose in flight) is tried again for as long as the service lives, in
growing pauses, while the others go on and the heartbeat tells. One that hangs (a driver's call that never comes back)
is killed: each looks at the stop flag in every turn of its loop, and the looks are counted.

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

from companion.lifetime import StopFlag, WatchedStopFlag, die_with_parent
from companion.ports import Clock

_STOP_S = 1.2  # chosen: with the next two, all is over within 3 s
_LAST_STOP_S = 2.0  # chosen: the recorder has time for what the others leave
_TERMINATED_S = 0.4  # chosen: a process that hears SIGTERM ends within it
_KILLED_S = 0.2  # nothing outlives SIGKILL, but the kernel takes a moment (choice)
_MOST_RESTARTS = 5  # of a process that never came to work (choice)
_SECOND_NS = 1_000_000_000  # by definition
_STEADY_NS = 60 * _SECOND_NS  # chosen: a process that was set up wrongly does not live for a minute
_HUNG_NS = 20 * _SECOND_NS  # chosen: a pair of images that is matched on a busy small computer takes a second or two
_SILENT_LOOKS = 10  # in a row, so that a machine that was stopped is not taken for a process that hangs (choice)
_LONGEST_PAUSE_NS = 30 * _SECOND_NS  # chosen: a camera that was plugged in again is found half a minute later

_SETTLED_NS = 5 * _SECOND_NS  # chosen: the new process has the machine to itself while it starts
_LOOK_S = 0.2  # chosen: how late a waiting process sees that it is to end

SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True)
class StandbyGate:
    """Where a process of a worker with a spare waits until it is needed. Survives the death of either side."""

    end: socket.socket
    spare: bool = False

    def wait_for_turn(self, stop: WatchedStopFlag) -> bool:
        """Say that all is prepared, and wait; False where the service ends before."""
        self.end.send(b"ready")
        while not select.select([self.end], [], [], _LOOK_S)[0]:
            if stop.is_set_while_idle():
                return False
        return bool(self.end.recv(8))


@dataclass(slots=True)
class _StandbyProcess:
    """A process that waits for its turn, and the supervisor's end of the line to it."""

    process: SpawnProcess
    line: socket.socket
    stop: WatchedStopFlag


@dataclass(slots=True)
class Worker:
    """One process: how to start it, and how often it had to be started again since it last ran for a minute.

    ``optional`` is one that the others can do without, ``last`` one that ends after the others, whose records it takes;
    it may wait for a disk, and is never taken to hang.
    With ``standby`` the target gets a :class:`StandbyGate` before the stop flag. ``thread_beside`` says that a thread
    beside the worker's own may watch over the parent; one that spins at a real-time priority looks itself.
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
    thread_beside: bool = True
    spare: _StandbyProcess | None = None
    line: socket.socket | None = None  # to the process, if it had to wait for its turn
    settled_ns: int | None = None
    stop: WatchedStopFlag | None = None
    looks: int = 0
    looked_ns: int = 0
    silent_looks: int = 0

    def start(self, now_ns: int) -> None:
        """Start a fresh process, or let the spare take over."""
        self.started_ns, self.again_ns, self.settled_ns = now_ns, None, None
        if not self.standby:
            self.process, self.stop = self._spawned(*self.arguments)
            return
        spare = self.spare if self.spare is not None and self.spare.process.is_alive() else self._waiting(spare=False)
        if self.line is not None:
            self.line.close()
        self.process, self.line, self.stop, self.spare = spare.process, spare.line, spare.stop, None
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
        process, watched = self._spawned(*arguments, StandbyGate(theirs, spare), stop)
        theirs.close()
        return _StandbyProcess(process, ours, watched)

    def _spawned(self, *arguments: Any) -> tuple[SpawnProcess, WatchedStopFlag]:
        *others, stop = arguments
        watched = WatchedStopFlag(stop)
        process = SPAWN.Process(
            target=_bound,
            args=(self.target, self.thread_beside, *others, watched),
            name=f"spanwise-{self.name}",
            daemon=False,
        )
        process.start()
        return process, watched

    def hangs(self, now_ns: int) -> bool:
        """Whether the process has not looked at its stop flag for long; asked about once a second."""
        looks = 0 if self.stop is None else self.stop.looks
        if looks != self.looks or not looks or self.last:
            self.looks, self.looked_ns, self.silent_looks = looks, now_ns, 0
        self.silent_looks += 1
        return self.silent_looks > _SILENT_LOOKS and now_ns - self.looked_ns >= _HUNG_NS

    def kill(self, now_ns: int) -> None:
        """End a process that hangs; it is found dead at the next look, or asked anew whether it hangs."""
        self.looked_ns = now_ns
        if self.process is not None:
            self.process.kill()

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


def _bound(target: Callable[..., None], watch: bool, *arguments: Any) -> None:
    """Be a worker that does not outlive the supervisor."""
    die_with_parent(watch=watch)
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
        thread_beside: bool = True,
    ) -> None:
        """Register a worker (see :class:`Worker`); its target gets the arguments and the stop flag."""
        self._workers.append(
            Worker(
                name, target, (*arguments, self.stop_flag), optional, last, standby=standby, thread_beside=thread_beside
            )
        )

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
                if worker.hangs(now_ns):
                    worker.kill(now_ns)
                    sentences.append(f"process {worker.name} hangs; killed")
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
