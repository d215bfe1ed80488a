"""Which plan the trigger process fires, where the line goes up some milliseconds after the command."""

from __future__ import annotations

import pytest

from companion.adapters.triggers.firing import WaitingPlan
from companion.records import Firing, Reject, Rejected, Shot, TriggerPlan

MS = 1_000_000
LEAD_MS = 4


class Board:
    """A trigger board: it raises the line :data:`LEAD_MS` after the command."""

    def fire(self, plan: TriggerPlan) -> Shot:
        return Shot(plan.plan_id, plan.command_host_ns, plan.command_host_ns + LEAD_MS * MS)

    def close(self) -> None: ...


def made(plan_id: int, planned_ms: float, command_ms: float) -> TriggerPlan:
    planned_ns, command_ns = round(planned_ms * MS), round(command_ms * MS)
    return TriggerPlan(plan_id, Firing.PEAK, command_ns, command_ns, MS, 0.3, command_ns + 10 * MS, planned_ns)


@pytest.mark.parametrize("after_ms", [0.5, 3.0, 3.5, 40.0])
def test_a_plan_made_after_a_command_waits_and_is_refined(after_ms: float) -> None:
    """Also where it was made before the edge of that command: the planner opens the next plan 3 ms after it."""
    waiting = WaitingPlan()
    waiting.take(made(1, 60.0, 100.0))
    waiting.fire(Board(), 100 * MS)
    waiting.take(made(2, 100.0 + after_ms, 300.0))
    assert waiting.plan is not None
    waiting.take(refined := made(2, 150.0, 310.0))
    assert waiting.plan == refined


def test_a_plan_made_before_a_command_never_fires_after_it() -> None:
    """It came too late to replace the one that fired; nor does a later word on it."""
    waiting = WaitingPlan()
    waiting.take(made(1, 60.0, 100.0))
    waiting.fire(Board(), 100 * MS)
    waiting.take(made(2, 99.0, 104.0))
    waiting.take(made(2, 140.0, 300.0))
    waiting.take(made(1, 140.0, 300.0))
    assert waiting.plan is None


def test_a_plan_made_just_before_a_command_fires_once_the_shot_is_known_to_its_planner() -> None:
    """As the first of a standby that takes over: it knows nothing of the shot, and refines its plan until it fires."""
    waiting = WaitingPlan()
    waiting.take(made(1, 60.0, 100.0))
    waiting.fire(Board(), 100 * MS)
    for planned_ms in (99.0, 140.0, 180.0, 220.0):
        waiting.take(refined := made(2, planned_ms, 300.0))
    assert waiting.plan == refined


def test_a_plan_made_between_a_command_and_its_late_call_waits() -> None:
    """The planner opens the next plan 3 ms after the command, whatever the trigger process does meanwhile."""
    waiting = WaitingPlan()
    waiting.take(made(1, 60.0, 100.0))
    waiting.fire(Board(), 107 * MS)
    waiting.take(following := made(2, 104.0, 300.0))
    assert waiting.plan == following


class Strange(Board):
    """A driver that raises whatever its library does."""

    def fire(self, plan: TriggerPlan) -> Shot:
        raise ZeroDivisionError("no clock")


def test_whatever_a_driver_raises_is_reported() -> None:
    waiting = WaitingPlan()
    waiting.take(made(1, 60.0, 100.0))
    report = waiting.fire(Strange(), 100 * MS)
    assert isinstance(report, Rejected)
    assert report.reason is Reject.DEVICE_FAILED
    assert "ZeroDivisionError: no clock" in report.what
