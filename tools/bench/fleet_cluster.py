"""A Dask cluster on this machine, for the fleet's bench and test: scheduler and workers in processes of their own."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_START_S = 60.0  # a crowded machine imports Dask in ten
_STOP_S = 10.0
_POLL_S = 0.05
_QUIET = subprocess.DEVNULL


@dataclass(frozen=True, slots=True)
class LocalCluster:
    """Address of the scheduler, and the workers' processes."""

    address: str
    workers: list[subprocess.Popen[bytes]]


@contextlib.contextmanager
def local_cluster(count: int, deaths: int = 3) -> Iterator[LocalCluster]:
    """Start a scheduler and ``count`` workers of one thread each on loopback; end them afterwards.

    The scheduler condemns a task when more than ``deaths`` workers died with it (three is Dask's default).
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as ends:
        place = Path(folder) / "scheduler.json"
        ends.enter_context(_process("dask_scheduler", "--host", "127.0.0.1", "--port", "0", place=place, deaths=deaths))
        address = _address(place)
        options = ("--nthreads", "1", "--no-nanny", "--local-directory", folder, "--death-timeout", f"{_START_S:g}")
        workers = [ends.enter_context(_process("dask_worker", *options, place=place)) for _ in range(count)]
        yield LocalCluster(address, workers)


@contextlib.contextmanager
def _process(program: str, *options: str, place: Path, deaths: int = 0) -> Iterator[subprocess.Popen[bytes]]:
    words = [sys.executable, "-m", f"distributed.cli.{program}", "--scheduler-file", str(place), "--no-dashboard"]
    surroundings = os.environ | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(deaths)}
    with subprocess.Popen([*words, *options], env=surroundings, stdout=_QUIET, stderr=_QUIET) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()


def _address(place: Path) -> str:
    """Address that the scheduler writes when it listens."""
    until_s = time.monotonic() + _START_S
    while time.monotonic() < until_s:
        try:
            return str(json.loads(place.read_text(encoding="utf-8"))["address"])
        except (OSError, ValueError):
            time.sleep(_POLL_S)
    raise TimeoutError(f"no Dask scheduler listened within {_START_S:g} s")
