"""Trigger without a device: stamps the instant and starts nothing (free-running cameras, benches)."""

from __future__ import annotations

import time

from companion.records import Shot, TriggerPlan


class NullTrigger:
    """Implements :class:`companion.ports.Trigger` without a device."""

    def fire(self, plan: TriggerPlan) -> Shot:
        """Say when it would have fired."""
        return Shot(plan.plan_id, plan.command_host_ns, time.monotonic_ns())

    def close(self) -> None:
        """Nothing to release."""
