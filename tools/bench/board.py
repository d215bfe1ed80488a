"""Planned against actual edges of the trigger board, its firmware built for this machine, over a pseudo-terminal.

The firmware (``tools/trigger_board``) keeps a clock of its own, 20 ppm fast, and logs every edge in host time. Shots
are fired through :class:`companion.adapters.triggers.process.TriggerProcess`, as the service does it. On a PC the
board is a process, given real-time priority where that is allowed; a microcontroller has no scheduler at all.
"""

from __future__ import annotations

import argparse
import functools
import os
import pty
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from companion.adapters.triggers.process import TriggerProcess
from companion.adapters.triggers.serial_board import BAUD, SerialBoardTrigger, lead_ns
from companion.records import Firing, Floats, Rejected, Shot, TriggerPlan

SOURCE = Path(__file__).resolve().parents[1] / "trigger_board"
SKEW_PPM = 20.0
SHOTS = 300
_AHEAD_NS = 20_000_000
_ANSWER_S = 1.0
_PRIORITY = 60


class Board:
    """A running board: its serial port, and the true instants of its edges."""

    def __init__(self, program: Path, edges: Path) -> None:
        master, self._slave = pty.openpty()
        self._edges, self.port = edges, os.ttyname(self._slave)
        with edges.open("wb") as file:
            self.process = subprocess.Popen([str(program), str(master), str(SKEW_PPM)], stdout=file, pass_fds=[master])
        os.close(master)
        self.fifo = _undisturbed(self.process.pid)

    def edges_ns(self) -> np.ndarray:
        """Host time of every edge so far."""
        return np.array([int(line) for line in self._edges.read_text().split()])

    def close(self) -> None:
        """End the board."""
        self.process.kill()
        self.process.wait()
        os.close(self._slave)


def _undisturbed(pid: int) -> bool:
    """A microcontroller has its processor for itself; a process that plays one needs real-time priority."""
    try:
        os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except OSError:
        return False
    return True


def build(out: Path) -> Path:
    """Compile the firmware; the program's path."""
    subprocess.run(["make", "-s", "-C", str(SOURCE), f"OUT={out}"], check=True, timeout=60)
    return out / "trigger_board"


@contextmanager
def running() -> Iterator[Board]:
    """Build and run a board in a folder that is forgotten afterwards."""
    with tempfile.TemporaryDirectory(prefix="board-") as folder:
        board = Board(build(Path(folder)), Path(folder) / "edges")
        try:
            yield board
        finally:
            board.close()


def run(shots: int = SHOTS) -> list[dict[str, object]]:
    """Rows with median, p99 and most, microseconds: edge after plan, and the board's report against the true edge."""
    with running() as board:
        planned, reported_ns, refused = _fired(board, shots)
        fifo = board.fifo
        true = board.edges_ns()
    if len(true) != len(planned):
        raise RuntimeError(f"{len(planned)} shots were reported, {len(true)} edges were made")
    return [
        _row("edge after the planned instant", true - np.array(planned), refused, fifo),
        _row("reported edge, off the true one", np.abs(np.array(reported_ns) - true), refused, fifo),
    ]


def _fired(board: Board, shots: int) -> tuple[list[int], list[int], int]:
    rng = np.random.default_rng(1)
    planned: list[int] = []
    reported_ns: list[int] = []
    refused = 0
    with TriggerProcess(functools.partial(SerialBoardTrigger, board.port)) as process:
        process.wait_ready()
        for number in range(shots):
            command_ns = time.monotonic_ns() + _AHEAD_NS + int(rng.integers(0, 8_000_000))
            process.send(
                TriggerPlan(number, Firing.TIMER, command_ns, command_ns, 0, 0.0, command_ns + 10**9, command_ns)
            )
            report = _report(process)
            if isinstance(report, Shot):
                planned.append(command_ns + lead_ns(BAUD))
                reported_ns.append(report.fired_host_ns)
            else:
                refused += 1
    return planned, reported_ns, refused


def _report(process: TriggerProcess) -> Shot | Rejected | None:
    until = time.monotonic() + _ANSWER_S
    while time.monotonic() < until:
        reports = process.poll()
        if reports:
            return reports[-1]
        select.select([process], [], [], 0.1)
    return None


def _row(name: str, late_ns: Floats, refused: int, fifo: bool) -> dict[str, object]:
    median, p99 = np.percentile(late_ns, [50, 99]) * 1e-3
    return {
        "name": name,
        "shots": len(late_ns),
        "refused": refused,
        "fifo": fifo,
        "median_us": float(median),
        "p99_us": float(p99),
        "most_us": float(late_ns.max() * 1e-3),
    }


def main(arguments: list[str] | None = None) -> int:
    """Print the table; there is no target, for it is the machine's scheduler that is measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shots", type=int, default=SHOTS)
    options, _ = parser.parse_known_args(arguments)
    if shutil.which("cc") is None:
        print("no C compiler here: the firmware cannot be built")
        return 0
    rows = run(options.shots)
    for row in rows:
        print(
            f"{row['name']:32s} median {row['median_us']:8.1f} us   p99 {row['p99_us']:8.1f} us   "
            f"most {row['most_us']:8.1f} us   {row['shots']} shots, {row['refused']} refused as too late"
        )
    if not rows[0]["fifo"]:
        print("no real-time priority here: the board shares its processor with everybody")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
