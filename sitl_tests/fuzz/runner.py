"""Runs cases in a child with a time and a memory limit; whatever is no data and no refusal is a finding."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import time
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from sitl_tests.fuzz.target import Ending, Target

MEMORY_LIMIT_BYTES = 1 << 30
_PATIENCE_S = 60.0
_PATIENCE_LIMITS = 20  # of a target's time limit: a busy machine is no finding
_ALARM_PERIOD_S = 0.5  # again and again: one that is raised within compiled code comes out as a SystemError
_LOADING_S = 1200.0  # compiled loops where no cache is, on a machine with other work


class TooSlow(BaseException):
    """The time limit; no Exception, so that no reader takes it for damage."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A case that ended in neither data nor a refusal."""

    target: str
    seed: int
    number: int
    problem: str


@dataclass(slots=True)
class Result:
    """Outcome of a target's cases; ``slowest_s`` is the most processor time of one case."""

    target: str
    cases: int = 0
    slowest_s: float = 0.0
    endings: Counter[str] = field(default_factory=Counter)
    counts: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _CaseReport:
    """Word of the child on a case."""

    number: int
    ending: str = ""
    problem: str = ""
    took_s: float = 0.0
    counts: Counter[str] = field(default_factory=Counter)
    alive: bool = True


def make_case(target: Target, seed: int, number: int) -> bytes:
    """The input of a case; the same for the same target, seed and number."""
    return target.case(np.random.default_rng([seed, zlib.crc32(target.name.encode()), number]))


def fuzz(
    make: Callable[[], Target],
    seed: int,
    *,
    cases: int | None = None,
    seconds: float | None = None,
    folder: Path | None = None,
    most_findings: int = 20,
) -> Result:
    """Run a target's cases until the count, the time or the patience with findings is over.

    Raises RuntimeError for a target that does not get warm.

    Parameters
    ----------
    make : callable
        Gives the target; it is called in the child too, so it must be picklable.
    seconds : float, optional
        Counted from when the target was first warm.
    folder : Path, optional
        Where inputs of findings are kept, with what they led to.
    """
    target = make()
    result = Result(target.name)
    began: float | None = None
    next_case = 0

    def going() -> bool:
        short = cases is None or next_case < cases
        early = seconds is None or began is None or time.monotonic() - began < seconds
        return short and early and len(result.findings) < most_findings

    while going():
        child = _Child(make, seed, next_case, max(_PATIENCE_S, _PATIENCE_LIMITS * target.limit_s))
        try:
            child.load()
            began = began or time.monotonic()
            while going():
                report = child.next_case()
                next_case = report.number + 1
                result.cases += 1
                result.slowest_s = max(result.slowest_s, report.took_s)
                result.counts += report.counts
                if report.problem:
                    finding = Finding(target.name, seed, report.number, report.problem)
                    result.findings.append(finding)
                    if folder is not None:
                        _keep(folder, finding, make_case(target, seed, report.number))
                    if not report.alive:
                        break
                else:
                    result.endings[report.ending] += 1
        finally:
            child.end()
    return result


class _Child:
    """The process that runs the cases, as its parent sees it."""

    def __init__(self, make: Callable[[], Target], seed: int, first: int, patience_s: float) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._ours, theirs = spawn.Pipe()
        self._process = spawn.Process(target=_run_cases, args=(make, seed, first, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self._number, self._patience_s = first, patience_s

    def load(self) -> None:
        """Wait until it is warm."""
        try:
            if self._ours.poll(_LOADING_S):
                self._ours.recv()
                return
        except (EOFError, ConnectionResetError):
            self._process.join(_PATIENCE_S)
        raise RuntimeError(f"the target does not start: code {self._process.exitcode}")

    def next_case(self) -> _CaseReport:
        """Run a single case and say how it ended."""
        number = self._number
        self._number += 1
        try:
            self._ours.send(True)
            if self._ours.poll(self._patience_s):
                report: _CaseReport = self._ours.recv()
                return report
            problem = f"no end after {self._patience_s:.0f} s, not even by an alarm"
            return _CaseReport(number, problem=problem, took_s=self._patience_s, alive=False)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self._process.join(_PATIENCE_S)
            return _CaseReport(number, problem=f"the process ended with code {self._process.exitcode}", alive=False)

    def end(self) -> None:
        """Stop it, wherever it is."""
        self._ours.close()
        self._process.kill()
        self._process.join()


def _run_cases(make: Callable[[], Target], seed: int, first: int, pipe: Connection) -> None:
    """The child's life: one case for every word from the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")
    target = make()
    target.warm()
    _be_quiet()
    _limit_memory()
    number = first
    try:
        pipe.send(True)
        while pipe.recv():
            pipe.send(run_case(target, make_case(target, seed, number), number))
            number += 1
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass


def run_case(target: Target, data: bytes, number: int = 0) -> _CaseReport:
    """Run one input under the target's time limit, and put what it raises into words."""
    target.counts = Counter()
    ending, problem, began = "", "", time.process_time()
    alarm = _Alarm(target.limit_s)
    alarm.set()
    try:
        ending = str(target.run(data))
    except (Exception, TooSlow):
        problem = traceback.format_exc(limit=-8)
    finally:
        alarm.stop()
    if alarm.rang and TooSlow.__name__ not in problem:
        problem = f"{problem}\n{TooSlow.__name__}: more than {target.limit_s:g} s, and the alarm was swallowed"
    return _CaseReport(number, ending, problem, time.process_time() - began, target.counts)


class _Alarm:
    """Raises TooSlow after so much processor time: a busy machine is no finding.

    Attributes
    ----------
    rang : bool
        Whether it was raised; what was running may have made something else of it.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self.rang = False

    def set(self) -> None:
        """Begin to count."""
        signal.signal(signal.SIGPROF, self._ring)
        signal.setitimer(signal.ITIMER_PROF, self._limit_s, _ALARM_PERIOD_S)

    def stop(self) -> None:
        """Ring no more."""
        signal.signal(signal.SIGPROF, signal.SIG_IGN)
        signal.setitimer(signal.ITIMER_PROF, 0.0)

    def _ring(self, number: int, frame: object) -> None:
        self.rang = True
        raise TooSlow(f"more than {self._limit_s:g} s")


def _be_quiet() -> None:
    """Silence the libraries: their words on damaged files belong to nobody."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)


def _limit_memory() -> None:
    """Allow so much address space beyond what is in use now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + MEMORY_LIMIT_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _keep(folder: Path, finding: Finding, data: bytes) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    stem = f"{finding.target}-{finding.seed}-{finding.number}"
    (folder / f"{stem}.bin").write_bytes(data)
    (folder / f"{stem}.txt").write_text(finding.problem, encoding="utf-8", errors="backslashreplace")


def table(results: list[Result]) -> str:
    """The counts, a line for each target."""
    lines = [f"{'target':12s}{'cases':>9s}{'data':>9s}{'refusals':>10s}{'findings':>10s}{'slowest, s':>12s}"]
    for entry in results:
        data, refusals = entry.endings[Ending.DATA], entry.endings[Ending.REFUSAL]
        lines.append(
            f"{entry.target:12s}{entry.cases:9d}{data:9d}{refusals:10d}{len(entry.findings):10d}{entry.slowest_s:12.2f}"
        )
    for entry in results:
        lines += [f"{entry.target}: {count} {what}" for what, count in sorted(entry.counts.items())]
    return "\n".join(lines)
