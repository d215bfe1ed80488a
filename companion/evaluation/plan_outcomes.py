"""Outcomes of the plans to fire: a shot that was planned and not made is counted under its reason."""

from __future__ import annotations

from collections import Counter, OrderedDict
from dataclasses import dataclass, field

from companion.records import Firing, Record, Reject, Rejected, Shot, TriggerPlan

FIRED = "fired"
REPLACED = "gave way to a better instant"
UNANSWERED = "not answered by the trigger"
LATE = "came too late to be fired"
FAILED = "refused by the trigger or the autopilot"
WITHDRAWN = "withdrawn"
SKIPPED = "skipped: "
_OPEN_PLANS = 32  # bound of memory: plans that may still be open
_ANSWER_NS = 1_000_000_000  # chosen: a failure is told by then, or belongs to no plan


@dataclass(slots=True)
class _Entry:
    plan: TriggerPlan
    outcome: str | None = None
    followed_host_ns: int = 0  # when the next plan was made

    def final_outcome(self) -> str:
        """Outcome once a newer plan has come."""
        if self.outcome is not None:
            return self.outcome
        if self.plan.firing is not Firing.SKIP:
            return UNANSWERED if self.followed_host_ns > self.plan.command_host_ns else REPLACED
        return WITHDRAWN if self.plan.reject is None else SKIPPED + str(self.plan.reject)


@dataclass(slots=True)
class PlanOutcomes:
    """Follows plans, shots and refusals in the order in which they were made; one plan is one ``plan_id``."""

    _entries: OrderedDict[int, _Entry] = field(default_factory=OrderedDict)
    _settled: Counter[str] = field(default_factory=Counter)

    def take(self, record: Record) -> None:
        """Look at a record of any kind."""
        if isinstance(record, TriggerPlan):
            self._refine(record)
        elif isinstance(record, Shot) and record.plan_id in self._entries:
            self._entries[record.plan_id].outcome = FIRED
        elif isinstance(record, Rejected) and record.reason is Reject.PLAN_EXPIRED:
            self._close(int(record.what.rpartition(" ")[2]), LATE)
        elif isinstance(record, Rejected) and record.reason is Reject.DEVICE_FAILED:
            self._close(self._commanded_before(record.at_host_ns), FAILED)

    def counts(self) -> dict[str, int]:
        """How many plans came to each end, fired first; a newest plan that still waits is left out."""
        total = self._settled.copy()
        for entry in list(self._entries.values())[:-1]:
            total[entry.final_outcome()] += 1
        if self._entries:
            newest = next(reversed(self._entries.values()))
            if newest.outcome is not None:
                total[newest.outcome] += 1
        order = sorted(
            total, key=lambda outcome: (outcome.startswith(SKIPPED), outcome != FIRED, -total[outcome], outcome)
        )
        return {outcome: total[outcome] for outcome in order}

    def _refine(self, plan: TriggerPlan) -> None:
        if self._entries and plan.plan_id not in self._entries:
            self._entries[next(reversed(self._entries))].followed_host_ns = plan.planned_host_ns
        self._entries.setdefault(plan.plan_id, _Entry(plan)).plan = plan
        while len(self._entries) > _OPEN_PLANS:
            _, oldest = self._entries.popitem(last=False)
            self._settled[oldest.final_outcome()] += 1

    def _close(self, plan_id: int | None, outcome: str) -> None:
        if plan_id is not None and plan_id in self._entries:
            self._entries[plan_id].outcome = outcome

    def _commanded_before(self, at_host_ns: int) -> int | None:
        """Newest plan whose command had just been given, for a failure that names none."""
        near = (i for i, e in self._entries.items() if 0 <= at_host_ns - e.plan.command_host_ns <= _ANSWER_NS)
        return max(near, default=None)
