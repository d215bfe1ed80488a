"""First words: what is waited for is said once, by its name, with its limit."""

from __future__ import annotations

import contextlib
import itertools
import sys
from pathlib import Path

import pytest

from companion.cli.terminal.run_loop import run_service
from companion.cli.terminal.status_view import View
from companion.cli.terminal.waiting import FIRST_REPEAT_S, LONGEST_REPEAT_S, RepeatPause, waiting_text
from companion.records import CorrectedRange, Health, Record, Reject, ServiceStatus

BOOT = ServiceStatus(1, Health.BOOT, "waiting for boot, node_left, node_right clock", {})
LOOK_S = 0.25


def lines(pause: RepeatPause, wording: str | None, from_s: float, to_s: float) -> list[float]:
    """Instants at which a line is printed by a loop that looks four times a second."""
    looks = itertools.takewhile(lambda at_s: at_s < to_s, itertools.count(from_s, LOOK_S))
    return [at_s for at_s in looks if pause.due(at_s, wording)]


def test_clocks_are_called_by_their_owners() -> None:
    said = waiting_text(BOOT, 7.0, None)
    assert said == "waiting for the autopilot's, the left node's and the right node's clocks (Ctrl-C ends it)"
    status = ServiceStatus(1, Health.BOOT, "waiting for node_left clock", {})
    assert waiting_text(status, 7.0, 25.0) == "waiting for the left node's clock (at most 25 s)"


def test_what_is_no_clock_is_said_as_it_is() -> None:
    samples = ServiceStatus(1, Health.BOOT, "waiting for inertial samples", {})
    assert waiting_text(samples, 7.0, None) == "waiting for inertial samples (Ctrl-C ends it)"


def test_before_any_process_speaks_the_start_is_named_with_its_usual_time() -> None:
    first, late = waiting_text(None, 0.5, None), waiting_text(None, 20.0, None)
    assert first is not None
    assert late is not None
    assert "starting" in first
    assert "busy" in late


@pytest.mark.parametrize("health", [each for each in Health if each is not Health.BOOT])
def test_at_work_nothing_is_waited_for(health: Health) -> None:
    assert waiting_text(ServiceStatus(1, health, "no range", {}), 30.0, None) is None


def test_ten_minutes_of_waiting_take_under_twenty_lines() -> None:
    printed = lines(RepeatPause(5.0), "waiting for inertial samples", 0.0, 600.0)
    assert printed[0] == 0.0
    assert len(printed) < 20
    pauses = [later - earlier for earlier, later in itertools.pairwise(printed)]
    assert all(FIRST_REPEAT_S <= pause <= LONGEST_REPEAT_S + LOOK_S for pause in pauses)
    assert pauses == sorted(pauses)


def test_a_change_is_said_at_once_and_begins_anew() -> None:
    pause = RepeatPause(5.0)
    lines(pause, "waiting for all", 0.0, 200.0)
    assert lines(pause, "waiting for the left node's clock", 200.0, 200.5) == [200.0]
    assert lines(pause, "waiting for the left node's clock", 200.5, 206.0) == [200.0 + FIRST_REPEAT_S]


def test_at_work_there_is_a_line_every_five_seconds() -> None:
    pause = RepeatPause(5.0)
    pause.due(0.0, "starting")
    assert lines(pause, None, 0.25, 31.0) == [5.0, 10.0, 15.0, 20.0, 25.0, 30.0]


def test_the_view_shows_what_is_waited_for_and_nothing_else() -> None:
    view = View("spanwise run", 60.0)
    assert "starting the processes" in view.line(0.1)
    view.take(BOOT)
    assert view.line(3.0).strip().startswith("3.0 s  state waiting for the autopilot's")
    assert "(at most 60 s)" in view.line(3.0)
    view.take(ServiceStatus(2, Health.STANDBY, "no mode is tracked", {}))
    assert view.line(9.0).strip() == "9.0 s  state standby: no mode is tracked"


def test_a_view_with_a_progress_of_its_own_waits_for_nobody() -> None:
    view = View("spanwise demo", progress="3 of 60 s")
    assert view.line(1.0) == "3 of 60 s  state starting"


def test_a_pair_without_a_range_shows_why_and_no_figures() -> None:
    view = View("spanwise demo", progress="3 of 60 s")
    view.take(CorrectedRange(1, 1, 1, 25, 0.0, 200.0, 0.0, 0.0, 0.0, 3, False, Reject.NO_MATCHES))
    assert "range none: too few matches | ranges 0 published" in view.line(1.0)
    assert "0.00" not in view.line(1.0)
    view.take(CorrectedRange(2, 2, 2, 25, 60.0, 9.0, 0.004, 0.001, 52.0, 30, False, Reject.SIGMA_TOO_LARGE))
    assert "range  60.00 ±9.00 m" in view.line(1.0)


class Unheard:
    """A service that runs for some looks, and says a sentence at each."""

    def __init__(self) -> None:
        self.looks = 0

    def shown(self) -> list[Record]:
        self.looks += 1
        return []

    def tend(self) -> list[str]:
        return ["process vision ended and is started again"]

    def failed(self) -> list[str]:
        return []

    def __enter__(self) -> object:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_an_error_output_that_cannot_be_written_ends_no_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    service = Unheard()
    with contextlib.suppress(OSError), Path("/dev/full").open("w") as full:  # closing it fails, too
        monkeypatch.setattr(sys, "stderr", full)
        run_service(service, View("spanwise run"), lambda: service.looks > 3, live=False, wait=lambda _: None)
        monkeypatch.undo()
    assert service.looks == 4
