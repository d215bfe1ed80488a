"""The supervisor: gives up what never ran, never gives up what did, and pauses between its tries."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from companion.service import supervisor
from companion.service.supervisor import Supervisor
from sitl_tests.loop.ground_stations import S, TurnedClock


class Process:
    """Stands in for an operating system's process; the test decides whether it lives."""

    def __init__(self, **_: Any) -> None:
        self.exitcode: int | None = None

    def start(self) -> None:
        """It runs."""

    def is_alive(self) -> bool:
        return self.exitcode is None

    def join(self, _: float) -> None:
        """It obeys."""

    terminate = start


class Tended:
    """One worker of a supervisor, on a clock that is turned by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(supervisor.SPAWN, "Process", Process)
        self.clock = TurnedClock()
        self.supervisor = Supervisor(self.clock)
        self.supervisor.add("vision", print)
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
def one(monkeypatch: pytest.MonkeyPatch) -> Tended:
    return Tended(monkeypatch)


def test_a_single_death_is_mended_at_once(one: Tended) -> None:
    one.tended(1.0)
    one.die()
    assert [sentence for _, sentence in one.tended(0.25)] == ["process vision ended (1); started again (try 1)"]
    assert one.worker.alive()
    assert one.tended(5.0) == []
    assert one.supervisor.failed() == []


def test_what_never_ran_is_given_up_after_a_few_tries(one: Tended) -> None:
    said = one.tended(60.0, doomed=True)
    assert len(said) == 5
    assert one.supervisor.failed() == ["vision"]
    pauses = [after - before for (before, _), (after, _) in itertools.pairwise(said)]
    assert pauses == sorted(pauses), "each pause is longer"
    assert one.tended(60.0, doomed=True) == []


def test_what_has_run_is_never_given_up_and_comes_back(one: Tended) -> None:
    one.tended(61.0)
    said = one.tended(600.0, doomed=True)
    assert len(said) > 15
    assert max(after - before for (before, _), (after, _) in itertools.pairwise(said)) <= 31.0
    assert one.supervisor.failed() == []
    one.tended(31.0)
    assert one.worker.alive(), "the camera is plugged in again"
    one.tended(61.0)
    one.die()
    assert "started again" in one.tended(0.25)[0][1], "all is forgiven after a steady minute"
