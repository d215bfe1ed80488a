"""The loop of the trigger process: newest plan wins, absolute monotonic target, sleep short of it, spin the rest."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable

from companion.adapters.triggers.wire import LARGEST, Report, pack_report, unpack_plan
from companion.errors import DeviceError, described
from companion.ports import Trigger
from companion.records import Firing, Reject, Rejected, Shot, TriggerPlan

SPIN_NS = 300_000
"""A sleeping process wakes late by up to some 200 us even when real-time; the rest is spun (choice)."""
_IDLE_S = 0.1  # chosen: how late the trigger process sees that it is to end
_HEARD_NS = 100_000_000  # chosen: a report that is 40 ms late and a planner's turn of 40 ms; then the shot is known
_MEMORY_NS = 2_000_000_000  # chosen: a plan is not fired twice; one is forgotten long after its instant


class WaitingPlan:
    """Pending plan, and the rules by which it is replaced and fired; independent of any clock.

    A plan replaces the one that waits; a SKIP plan withdraws it. An id that was fired within two seconds is not fired
    again, nor one that was planned before the last command: it came too late to replace that shot's plan. What refines
    it is not fired either, until the planner must have heard of that shot. A plan past its expiry is reported as
    ``PLAN_EXPIRED``, a line that fails as ``DEVICE_FAILED``.
    """

    def __init__(self) -> None:
        self.plan: TriggerPlan | None = None
        self._fired_ns: dict[int, int] = {}
        self._last_ns = 0
        self._late_id: int | None = None

    def take(self, plan: TriggerPlan) -> None:
        """Replace the waiting plan by a newer one, if the rules allow it."""
        if plan.plan_id in self._fired_ns:
            return
        if plan.planned_host_ns <= self._last_ns:
            self._late_id = plan.plan_id
        elif plan.plan_id != self._late_id or plan.planned_host_ns > self._last_ns + _HEARD_NS:
            self.plan = None if plan.firing is Firing.SKIP else plan

    def fire(self, trigger: Trigger, now_host_ns: int) -> Shot | Rejected:
        """Fire the pending plan; return the shot, or the refusal."""
        plan, self.plan = self.plan, None
        assert plan is not None
        if now_host_ns > plan.expires_host_ns:
            return Rejected(Reject.PLAN_EXPIRED, f"plan {plan.plan_id}", now_host_ns)
        try:
            shot = trigger.fire(plan)
        except (DeviceError, OSError) as error:
            return Rejected(Reject.DEVICE_FAILED, str(error), now_host_ns)
        except Exception as error:  # whatever a library raises: the next plan is served
            return Rejected(Reject.DEVICE_FAILED, f"{type(error).__name__}: {described(error)}", now_host_ns)
        self._fired_ns = {old: at for old, at in self._fired_ns.items() if at > now_host_ns - _MEMORY_NS}
        self._fired_ns[plan.plan_id] = now_host_ns
        # not the edge's instant, nor that of a late call: from the command on the planner plans the next shot
        self._last_ns = plan.command_host_ns
        return shot


class FiringLoop:
    """One trigger line and the plan that waits for it (:class:`WaitingPlan`), on the monotonic clock.

    A message that is no plan is reported as ``CRC``; no error ends the loop.
    """

    def __init__(self, trigger: Trigger, end: socket.socket, stopped: Callable[[], bool]) -> None:
        self._trigger = trigger
        self._end = end
        self._stopped = stopped
        self._waiting = WaitingPlan()

    def run(self) -> None:
        """Serve until told to stop, or until the other end is closed."""
        while not self._stopped():
            plan = self._waiting.plan
            spare_ns = _IDLE_S * 1e9 if plan is None else plan.command_host_ns - SPIN_NS - time.monotonic_ns()
            if spare_ns > 0:
                if not self._listen(min(spare_ns * 1e-9, _IDLE_S)):
                    return
            elif plan is not None:
                self._serve(plan)
                if not self._listen(0.0):
                    return

    def report(self, report: Report) -> None:
        """Tell the service; a service that does not read loses reports, not shots."""
        with contextlib.suppress(OSError):
            self._end.send(pack_report(report))

    def _listen(self, timeout_s: float) -> bool:
        """Take every message that has arrived; False when the other end is gone."""
        readable, _, _ = select.select([self._end], [], [], timeout_s)
        while readable:
            try:
                message = self._end.recv(LARGEST)
            except BlockingIOError:
                return True
            except OSError:
                return False
            if not message:
                return False
            self._take(message)
        return True

    def _take(self, message: bytes) -> None:
        plan = unpack_plan(message)
        if plan is None:
            self.report(Rejected(Reject.CRC, "message to the trigger process", time.monotonic_ns()))
        else:
            self._waiting.take(plan)

    def _serve(self, plan: TriggerPlan) -> None:
        while (now_ns := time.monotonic_ns()) < plan.command_host_ns:
            pass
        self.report(self._waiting.fire(self._trigger, now_ns))
