"""Which plan the trigger process fires, where the line goes up some milliseconds after the command."""

from __future__ import annotations

import pytest

from companion.adapters.triggers.firing import WaitingPlan
from companion.records import Firing, Shot, TriggerPlan

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
