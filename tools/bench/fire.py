"""Planned against actual fire time, with every core busy: the trigger process, and what a thread would do instead."""

from __future__ import annotations

import multiprocessing
import os
import select
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from companion.adapters.clocks import MonotonicClock
from companion.adapters.triggers.none import NullTrigger
from companion.adapters.triggers.process import TriggerProcess
from companion.records import Firing, Shot, TriggerPlan

SHOTS = 1000
TARGET_P99_US = 50.0
_LEAD_NS = 8_000_000
_EXPIRY_NS = 1_000_000_000
_SPAWN = multiprocessing.get_context("spawn")


def run(shots: int = SHOTS) -> list[dict[str, object]]:
    """Give a row per way of firing: name, whether real-time was granted, microseconds late at p50, p99 and most."""
    with _every_core_busy():
        return [
            _row("trigger process, SCHED_FIFO", *_process(shots, fifo=True)),
            _row("trigger process, no real-time", *_process(shots, fifo=False)),
            _row("thread timer in a busy process", *_thread(shots)),
        ]


def main(arguments: list[str] | None = None) -> int:
    del arguments
    rows = run()
    for row in rows:
        granted = "" if row["fifo"] else "  (no real-time priority)"
        print(
            f"{row['name']:32s} p50 {row['p50_us']:9.1f} us   p99 {row['p99_us']:9.1f} us   "
            f"most {row['most_us']:9.1f} us   {row['shots']} shots{granted}"
        )
    best = rows[0]
    if not best["fifo"]:
        print("no target: this machine does not allow SCHED_FIFO")
        return 0
    print(f"target: p99 <= {TARGET_P99_US:g} us with SCHED_FIFO")
    return int(float(str(best["p99_us"])) > TARGET_P99_US)


def _row(name: str, fifo: bool, late_ns: list[int]) -> dict[str, object]:
    late_us = np.array(late_ns) / 1e3
    p50, p99 = np.percentile(late_us, [50, 99])
    return {
        "name": name,
        "fifo": fifo,
        "shots": len(late_ns),
        "p50_us": float(p50),
        "p99_us": float(p99),
        "most_us": float(late_us.max()),
    }


def _process(shots: int, fifo: bool) -> tuple[bool, list[int]]:
    late: list[int] = []
    rng = np.random.default_rng(1)
    with TriggerProcess(NullTrigger, fifo=fifo) as process:
        granted = process.wait_ready().fifo
        for number in range(shots):
            command_ns = time.monotonic_ns() + _LEAD_NS + int(rng.integers(0, 4_000_000))
            process.send(_plan(number, command_ns))
            while not (reports := process.poll()):
                select.select([process], [], [], 1.0)
            late += [report.fired_host_ns - report.planned_host_ns for report in reports if isinstance(report, Shot)]
    return granted, late


def _plan(number: int, command_ns: int) -> TriggerPlan:
    return TriggerPlan(number, Firing.TIMER, command_ns, command_ns, 0, 0.0, command_ns + _EXPIRY_NS, command_ns)


def _thread(shots: int) -> tuple[bool, list[int]]:
    """Fire from a thread beside Python that computes, as a service without a trigger process would."""
    late: list[int] = []
    done = threading.Event()

    def timer() -> None:
        rng, clock = np.random.default_rng(1), MonotonicClock()
        for _ in range(shots):
            target_ns = time.monotonic_ns() + _LEAD_NS + int(rng.integers(0, 4_000_000))
            clock.sleep_until(target_ns)
            late.append(time.monotonic_ns() - target_ns)
        done.set()

    threading.Thread(target=timer, daemon=True).start()
    while not done.is_set():
        sum(range(2000))  # what the interpreter is busy with
    return False, late


@contextmanager
def _every_core_busy() -> Iterator[None]:
    load = [_SPAWN.Process(target=_spin, daemon=True) for _ in range(os.cpu_count() or 1)]
    for process in load:
        process.start()
    time.sleep(1.0)
    try:
        yield
    finally:
        for process in load:
            process.terminate()
            process.join()


def _spin() -> None:
    while True:
        sum(range(2000))


if __name__ == "__main__":
    sys.exit(main())
