"""The trigger process, live: every plan once, the newest wins, nothing that arrives stops it, and it ends when told."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.triggers.none import NullTrigger
from companion.adapters.triggers.process import TriggerProcess
from companion.errors import DeviceError
from companion.records import Firing, Reject, Rejected, Shot, TriggerPlan

pytestmark = [pytest.mark.realtime, pytest.mark.xdist_group("realtime")]
MS = 1_000_000


class OddsFail:
    """A line that fails at odd plans."""

    def fire(self, plan: TriggerPlan) -> Shot:
        if plan.plan_id % 2:
            raise DeviceError("line stuck")
        return Shot(plan.plan_id, plan.command_host_ns, time.monotonic_ns())

    def close(self) -> None:
        pass


class CannotOpen:
    def __init__(self) -> None:
        raise DeviceError("no such line")


def plan(plan_id: int, ahead_ns: int, firing: Firing = Firing.PEAK, life_ns: int = 500 * MS) -> TriggerPlan:
    now = time.monotonic_ns()
    command = now + ahead_ns
    return TriggerPlan(plan_id, firing, command, command + 9 * MS, 0, 0.1, command + life_ns, now)


def reports(process: TriggerProcess, seconds: float, enough: int | None = None) -> list[Shot | Rejected]:
    received: list[Shot | Rejected] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end and (enough is None or len(received) < enough):
        received += process.poll()
        time.sleep(0.002)
    return received


@pytest.fixture(scope="module")
def shared() -> Iterator[TriggerProcess]:
    with TriggerProcess(NullTrigger) as process:
        process.wait_ready()
        yield process


@pytest.fixture
def process(shared: TriggerProcess) -> TriggerProcess:
    shared.poll()
    return shared


def test_a_plan_is_fired_once_and_never_early(process: TriggerProcess) -> None:
    sent = plan(100, 15 * MS)
    process.send(sent)
    process.send(sent)
    received = reports(process, 0.3)
    process.send(sent)  # long fired
    received += reports(process, 0.2)
    assert [shot.plan_id for shot in received if isinstance(shot, Shot)] == [100]
    (shot,) = received
    assert isinstance(shot, Shot)
    assert shot.planned_host_ns == sent.command_host_ns
    assert shot.fired_host_ns >= shot.planned_host_ns


def test_the_newest_plan_wins_whatever_its_time(process: TriggerProcess) -> None:
    process.send(plan(200, 60 * MS))
    refined = plan(200, 30 * MS)
    process.send(refined)
    process.send(plan(201, 200 * MS))
    later = plan(201, 80 * MS)
    process.send(later)
    received = reports(process, 0.4)
    assert [(shot.plan_id, shot.planned_host_ns) for shot in received if isinstance(shot, Shot)] == [
        (201, later.command_host_ns)
    ]


def test_a_plan_that_came_too_late_to_replace_the_last_shots_is_not_fired(process: TriggerProcess) -> None:
    """Planned before that shot was fired, in its stead; nor is what refines it."""
    first, instead = plan(250, 15 * MS), plan(251, 120 * MS)
    process.send(first)
    received = reports(process, 0.05)
    process.send(instead)
    process.send(plan(251, 60 * MS))
    process.send(plan(252, 90 * MS))
    received += reports(process, 0.25)
    assert [shot.plan_id for shot in received if isinstance(shot, Shot)] == [250, 252]


def test_a_skip_withdraws_what_waits(process: TriggerProcess) -> None:
    process.send(plan(300, 60 * MS))
    process.send(plan(300, 60 * MS, Firing.SKIP))
    assert reports(process, 0.2) == []


def test_an_expired_plan_is_reported_and_not_fired(process: TriggerProcess) -> None:
    process.send(plan(400, -50 * MS, life_ns=10 * MS))
    (rejected,) = reports(process, 30.0, enough=1)
    assert isinstance(rejected, Rejected)
    assert rejected.reason is Reject.PLAN_EXPIRED
    assert "400" in rejected.what


def test_a_late_but_living_plan_is_fired_at_once(process: TriggerProcess) -> None:
    process.send(plan(410, -5 * MS))
    (shot,) = reports(process, 30.0, enough=1)
    assert isinstance(shot, Shot)
    assert shot.plan_id == 410


def test_garbage_does_not_stop_it(process: TriggerProcess) -> None:
    process.send(plan(500, 100 * MS))
    rng = np.random.default_rng(0)
    raw = socket.socket(fileno=os.dup(process.fileno()))
    for size in (1, 2, 17, 70, 300, 511, 4000):
        raw.send(rng.bytes(size))
    raw.close()
    received = reports(process, 0.4)
    assert [report.reason for report in received if isinstance(report, Rejected)] == [Reject.CRC] * 7
    assert [report.plan_id for report in received if isinstance(report, Shot)] == [500]


def test_most_shots_are_within_a_fifth_of_a_millisecond_of_the_plan(process: TriggerProcess) -> None:
    """Half of them, that is: the bench has the figures, a shared machine only tells a spin from a sleep."""
    late = []
    for i in range(40):
        process.send(plan(600 + i, 6 * MS))
        late += [shot.fired_host_ns - shot.planned_host_ns for shot in reports(process, 30.0, enough=1)]
    assert len(late) == 40
    assert min(late) >= 0
    assert np.median(late) < 0.2 * MS


def test_a_line_that_fails_is_reported_and_the_next_plan_is_served() -> None:
    with TriggerProcess(OddsFail) as process:
        process.wait_ready()
        received = []
        for i in range(4):
            process.send(plan(i, 5 * MS))
            received += reports(process, 30.0, enough=1)
    assert [type(report) for report in received] == [Shot, Rejected, Shot, Rejected]
    assert isinstance(received[1], Rejected)
    assert received[1].reason is Reject.DEVICE_FAILED
    assert "line stuck" in received[1].what


def test_a_line_that_cannot_be_opened_is_an_error() -> None:
    process = TriggerProcess(CannotOpen)  # type: ignore[arg-type]
    with pytest.raises(DeviceError, match="ended before its line was open"):
        process.wait_ready()
    process.close()
    assert not process.alive


def test_a_dead_process_drops_plans_and_blocks_nobody() -> None:
    with TriggerProcess(NullTrigger, fifo=False) as process:
        assert not process.wait_ready().fifo
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
        end = time.monotonic() + 30.0
        while process.alive and time.monotonic() < end:
            time.sleep(0.01)
        assert not process.alive
        process.send(plan(1, 5 * MS))
        assert process.dropped == 1
        assert process.poll() == []


def test_closing_ends_it_soon() -> None:
    process = TriggerProcess(NullTrigger)
    process.wait_ready()
    began = time.monotonic()
    process.close()
    assert not process.alive
    assert time.monotonic() - began < 10.0


_PARENT = """
import sys, time
from companion.adapters.triggers.none import NullTrigger
from companion.adapters.triggers.process import TriggerProcess
if __name__ == "__main__":
    process = TriggerProcess(NullTrigger)
    process.wait_ready()
    print(process.pid, flush=True)
    time.sleep(60)
"""


def test_it_ends_when_the_parent_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(_PARENT)
    root = str(Path(__file__).resolve().parents[2])
    environment = {**os.environ, "PYTHONPATH": root}
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    end = time.monotonic() + 30.0
    while _runs(child) and time.monotonic() < end:
        time.sleep(0.02)
    assert not _runs(child)


def _runs(pid: int) -> bool:
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rsplit(")", 1)[1].split()[0] != "Z"
