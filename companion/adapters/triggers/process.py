"""The trigger process: fires the line at the planned instant, whatever the rest of the service is busy with.

A thread that shares the interpreter with busy Python fires milliseconds late; a process of its own with a real-time
priority fires within microseconds. A planner that is late or busy does not delay the shot.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import socket
from collections.abc import Callable
from multiprocessing.context import SpawnProcess

from companion.adapters.triggers.firing import FiringLoop
from companion.adapters.triggers.realtime import become_realtime
from companion.adapters.triggers.wire import LARGEST, Realtime, Report, pack_plan, unpack_report
from companion.errors import DeviceError
from companion.lifetime import die_with_parent
from companion.ports import Trigger
from companion.records import Rejected, Shot, TriggerPlan

_SPAWN = multiprocessing.get_context("spawn")
_START_S = 20.0  # chosen: a busy small computer imports slowly
_STOP_S = 2.0  # chosen: a process that ends takes milliseconds; a stuck one holds the end up no longer


def line_pair() -> tuple[socket.socket, socket.socket]:
    """Make the two ends between service and trigger process; neither blocks, and messages keep their borders."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
    return ends


def serve_trigger(
    factory: Callable[[], Trigger],
    end: socket.socket,
    stopped: Callable[[], bool] = lambda: False,
    *,
    fifo: bool = True,
) -> None:
    """Entry point of the trigger process, for a supervisor or :class:`TriggerProcess`.

    ``factory`` opens the trigger line in this process, whose end of :func:`line_pair` is ``end``: it ends when the
    other one is closed, when the parent dies, or when ``stopped``, asked every tenth of a second, says so. ``fifo``
    asks for a real-time priority.
    """
    die_with_parent(watch=False)  # the loop looks itself: no thread beside one that spins
    parent = os.getppid()
    trigger = factory()
    try:
        loop = FiringLoop(trigger, end, lambda: stopped() or os.getppid() != parent)
        loop.report(become_realtime(fifo))
        loop.run()
    finally:
        trigger.close()


class TriggerLink:
    """The service's end: hands over plans, collects shots; never blocks."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self.dropped = 0
        self._warnings: list[str] = []

    def fileno(self) -> int:
        """For ``select``."""
        return self._end.fileno()

    def send(self, plan: TriggerPlan) -> None:
        """Hand over the newest plan; counted as dropped while the trigger process is dead or does not read."""
        try:
            self._end.send(pack_plan(plan))
        except OSError:
            self.dropped += 1

    def poll(self) -> list[Shot | Rejected]:
        """Give what was fired or refused since the last call."""
        return [report for report in self._reports() if not isinstance(report, Realtime)]

    def warnings(self) -> list[str]:
        """Warnings for the operator since the last call: that the process was refused a real-time priority."""
        taken, self._warnings = self._warnings, []
        return taken

    def _reports(self) -> list[Report]:
        reports: list[Report] = []
        with contextlib.suppress(OSError):
            while message := self._end.recv(LARGEST):
                report = unpack_report(message)
                if isinstance(report, Realtime) and not (report.fifo and report.memory_locked):
                    self._warnings.append(report.sentence())
                if report is not None:
                    reports.append(report)
        return reports

    def close(self) -> None:
        """Close the end; a trigger process on the other one ends."""
        self._end.close()


class TriggerProcess(TriggerLink):
    """A trigger process with its link, for a service (or bench) that has no supervisor. Use as a context manager.

    ``factory`` is picklable and opens the trigger line inside the process. ``fifo`` asks for a real-time priority;
    :meth:`wait_ready` says whether it was granted.
    """

    def __init__(self, factory: Callable[[], Trigger], *, fifo: bool = True) -> None:
        ours, theirs = line_pair()
        super().__init__(ours)
        self._process: SpawnProcess = _SPAWN.Process(
            target=serve_trigger, args=(factory, theirs), kwargs={"fifo": fifo}, name="spanwise-trigger", daemon=True
        )
        self._process.start()
        theirs.close()

    def wait_ready(self) -> Realtime:
        """Wait until the line is open and say what the operating system granted.

        Raises
        ------
        DeviceError
            The process died, or did not start in time.
        """
        self._end.settimeout(_START_S)
        try:
            message = self._end.recv(LARGEST)
        except OSError as error:
            raise DeviceError(f"the trigger process did not start within {_START_S:g} s: {error}") from error
        finally:
            self._end.setblocking(False)
        report = unpack_report(message)
        if not isinstance(report, Realtime):
            raise DeviceError("the trigger process ended before its line was open")
        return report

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """Id of the process."""
        return self._process.pid

    def close(self) -> None:
        """End the process; shots that have not been polled are lost."""
        super().close()
        self._process.join(_STOP_S)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(_STOP_S)

    def __enter__(self) -> TriggerProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
