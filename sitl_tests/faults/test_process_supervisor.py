"""The supervisor: gives up what never ran, never gives up what did, and pauses between its tries."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from companion.lifetime import StopFlag, WatchedStopFlag
from companion.service import supervisor
from companion.service.supervisor import StandbyGate, Supervisor
from sitl_tests.loop.ground_stations import S, TurnedClock


class Process:
    """Stands in for an operating system's process; the test decides whether it lives."""

    def __init__(self, args: tuple[Any, ...] = (), **_: Any) -> None:
        self.exitcode: int | None = None
        self.stop: WatchedStopFlag = args[-1]
        self.killed = 0
        turns = [argument for argument in args if isinstance(argument, StandbyGate)]
        self.end = turns[0].end.dup() if turns else None  # as it is in another process

    def released(self) -> bool:
        """Whether its turn has come."""
        assert self.end is not None
        self.end.setblocking(False)
        try:
            return self.end.recv(8) == b"go"
        except BlockingIOError:
            return False

    def start(self) -> None:
        """It runs."""

    def is_alive(self) -> bool:
        return self.exitcode is None

    def kill(self) -> None:
        """It is gone at the next look."""
        self.killed += 1
        self.exitcode = -9

    def join(self, _: float) -> None:
        """It obeys."""

    terminate = start


class Tended:
    """One worker of a supervisor, on a clock that is turned by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, standby: bool = False) -> None:
        monkeypatch.setattr(supervisor.SPAWN, "Process", Process)
        self.clock = TurnedClock()
        self.supervisor = Supervisor(self.clock)
        self.supervisor.add("vision", print, standby=standby)
        self.supervisor.__enter__()
        (self.worker,) = self.supervisor._workers

    def die(self) -> None:
        assert self.worker.process is not None
        self.worker.process.exitcode = 1

    def tended(self, seconds: float, *, doomed: bool = False) -> list[tuple[float, str]]:
        """Tend four times a second; a doomed worker dies as soon as it is looked at."""
        began, said = self.clock.now, []
        while self.clock.now - began < seconds * S:
            self.clock.now += S // 4
            if doomed:
                self.die()
            said += [((self.clock.now - began) / S, sentence) for sentence in self.supervisor.tend()]
        return said


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> Tended:
    return Tended(monkeypatch)


def test_a_single_death_is_mended_at_once(alone: Tended) -> None:
    alone.tended(1.0)
    alone.die()
    assert [sentence for _, sentence in alone.tended(0.25)] == ["process vision ended (1); started again (try 1)"]
    assert alone.worker.alive()
    assert alone.tended(5.0) == []
    assert alone.supervisor.failed() == []


def test_what_never_ran_is_given_up_after_a_few_tries(alone: Tended) -> None:
    said = alone.tended(60.0, doomed=True)
    assert len(said) == 5
    assert said[-1][1] == "process vision ended (1); given up after 4 tries", "what is not tried is not announced"
    assert alone.supervisor.failed() == ["vision"]
    pauses = [after - before for (before, _), (after, _) in itertools.pairwise(said)]
    assert pauses == sorted(pauses), "each pause is longer"
    assert alone.tended(60.0, doomed=True) == []


def test_what_has_run_is_never_given_up_and_comes_back(alone: Tended) -> None:
    alone.tended(61.0)
    said = alone.tended(600.0, doomed=True)
    assert len(said) > 15
    assert max(after - before for (before, _), (after, _) in itertools.pairwise(said)) <= 31.0
    assert alone.supervisor.failed() == []
    alone.tended(31.0)
    assert alone.worker.alive(), "the camera is plugged in again"
    alone.tended(61.0)
    alone.die()
    assert "started again" in alone.tended(0.25)[0][1], "all is forgiven after a steady minute"


def test_what_hangs_is_killed_and_started_again(alone: Tended) -> None:
    """A call into a driver that never comes back; before the first turn a device may take its time to open."""
    first: Any = alone.worker.process
    assert alone.tended(120.0) == []
    for _ in range(30):
        assert not first.stop.is_set()
        assert alone.tended(1.0) == []
    said = alone.tended(25.0)
    assert [sentence for _, sentence in said] == [
        "process vision hangs; killed", "process vision ended (-9); started again (try 1)",
    ]  # fmt: skip
    assert 19.0 < said[0][0] <= 21.0
    assert first.killed == 1
    assert alone.worker.process is not first


def test_a_machine_that_stopped_is_no_process_that_hangs(alone: Tended) -> None:
    first: Any = alone.worker.process
    first.stop.is_set()
    alone.tended(1.0)
    alone.clock.now += 600 * S
    assert alone.tended(1.0) == []
    first.stop.is_set()
    assert alone.tended(15.0) == []


def test_a_spare_that_waits_gives_no_sign_of_life() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    stop = WatchedStopFlag(StopFlag())
    with ours, theirs:
        waiting = threading.Thread(target=StandbyGate(theirs, spare=True).wait_for_turn, args=(stop,))
        waiting.start()
        time.sleep(0.5)
        ours.send(b"go")
        waiting.join()
    assert stop.looks == 0
    assert not stop.is_set()
    assert stop.looks == 1


@pytest.fixture
def spared(monkeypatch: pytest.MonkeyPatch) -> Iterator[Tended]:
    tended = Tended(monkeypatch, standby=True)
    yield tended
    for process in tended.worker.processes():
        process.end.close()  # type: ignore[attr-defined]


def prepared(process: Any) -> None:
    process.end.send(b"ready")


def test_a_spare_is_made_when_the_first_has_settled_and_takes_over_at_once(spared: Tended) -> None:
    worker = spared.worker
    first: Any = worker.process
    assert first.released(), "the first has nothing to wait for"
    spared.tended(30.0)
    assert worker.spare is None, "while the first compiles, nobody else does"
    prepared(first)
    spared.tended(6.0)
    assert worker.spare is not None
    spare: Any = worker.spare.process
    prepared(spare)
    assert not spare.released()
    spared.die()
    assert [sentence for _, sentence in spared.tended(0.25)] == ["process vision ended (1); spare takes over (try 1)"]
    assert worker.process is spare
    assert spare.released()
    assert worker.spare is None
    spared.tended(6.0)
    assert worker.spare is not None, "and the next is made"
    prepared(worker.spare.process)
    spared.die()
    assert "spare takes over" in spared.tended(0.25)[0][1], "without the pause that a second start would wait"
    first.end.close()


def test_a_spare_that_dies_is_made_again_a_minute_later_and_missed_by_nobody(spared: Tended) -> None:
    worker = spared.worker
    first: Any = worker.process
    prepared(first)
    spared.tended(6.0)
    assert worker.spare is not None
    lost: Any = worker.spare.process
    lost.exitcode = 1
    assert spared.tended(50.0) == []
    assert worker.spare.process is lost
    spared.tended(15.0)
    assert worker.spare.process is not lost
    worker.spare.process.exitcode = 1  # type: ignore[misc]
    spared.die()
    assert "started again" in spared.tended(0.25)[0][1]
    assert worker.process.released()  # type: ignore[union-attr]
    lost.end.close()
    first.end.close()


def look_for_ever(stop: StopFlag, end: socket.socket) -> None:
    end.send(b"ready")
    while not stop.is_set():
        pass


def test_a_process_that_is_frozen_or_killed_while_it_looks_at_the_stop_flag_holds_up_nobody() -> None:
    stop = Supervisor(TurnedClock()).stop_flag
    ours, theirs = socket.socketpair()
    process = supervisor.SPAWN.Process(target=look_for_ever, args=(stop, theirs))
    process.start()
    try:
        ours.recv(8)
        assert process.pid is not None
        for pause_ms in range(20):
            os.kill(process.pid, signal.SIGSTOP)
            time.sleep(0.001 * pause_ms)
            look = threading.Thread(target=stop.is_set, daemon=True)
            look.start()
            look.join(2.0)
            assert not look.is_alive(), "a frozen process has its lock"
            os.kill(process.pid, signal.SIGCONT)
            time.sleep(0.001)
    finally:
        process.kill()
        process.join()
        ours.close()
        theirs.close()
    stop.set()
    assert stop.is_set()


def test_a_process_that_waits_for_its_turn_ends_with_the_service() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    stop = WatchedStopFlag(StopFlag())
    threading.Timer(0.1, stop.set).start()
    assert not StandbyGate(theirs).wait_for_turn(stop)
    assert ours.recv(8) == b"ready"
    ours.send(b"go")
    assert StandbyGate(theirs).wait_for_turn(stop)
    ours.close()
    theirs.close()
