"""Notices that ranges fail to come, and says why: where the wing is tracked, the most frequent cause of late."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from companion.core.trigger.planner import Policy
from companion.params.settings import Settings
from companion.records import CorrectedRange, Firing, MatchSet, Record, Reject, Rejected, Shot, TriggerPlan

_PATIENCE_NS = 5_000_000_000  # longer than any usual gap between trusted ranges (choice)
_UNTRACKED_PATIENCE_NS = 30_000_000_000  # a start takes seconds, a lost tracker stays (choice)
_LONGEST_STEP_NS = 1_000_000_000  # a longer pause between ticks is not waiting (choice)
_REPEAT_NS = 20_000_000_000  # often enough for an operator, rare enough for a slow link (choice)
_AGE_NS = 5_000_000_000  # counts halve so often: causes of late weigh most (choice)
_SETTINGS = {
    Reject.NO_MATCHES: "RNG_MATCHES",
    Reject.OUT_OF_RANGE: "RNG_MIN, RNG_MAX",
    Reject.SIGMA_TOO_LARGE: "RNG_TRUST",
    Reject.BLUR_TOO_LARGE: "TRG_BLUR",
    Reject.PEAK_UNCERTAIN: "TRG_SIGMA",
}


NO_PAIRS = "shots bring no image pairs: trigger, cameras?"
"""Cause of silence, and reason of a CRITICAL status, where exposures bring no matches."""


TELLING = (CorrectedRange, TriggerPlan, Shot, MatchSet, Rejected)
"""Records that say something about why no range comes."""


@dataclass(slots=True)
class RangeSilence:
    """Adds up the time in which the tracker could have given ranges and none was trusted.

    Time without a usable tracker is added up apart, for it has its own words; neither is forgotten before a range is
    trusted, so that a tracker that comes and goes cannot hide the silence.
    """

    waited_ns: int = 0
    untracked_ns: int = 0
    _last_tick_ns: int | None = None
    _usable: bool = False
    _plan: TriggerPlan | None = None
    _aged_ns: int = 0
    _refused: Counter[str] = field(default_factory=Counter)  # pairs, by what became of them
    _skipped: Counter[str] = field(default_factory=Counter)  # plans, by why they were not fired
    _events: Counter[type] = field(default_factory=Counter)  # plans whose time had come, shots, pairs
    _said: str = ""
    _said_ns: int = 0

    def note(self, record: Record) -> None:
        """Look at an input or output of the pipeline."""
        if not isinstance(record, TELLING):
            return
        if isinstance(record, CorrectedRange) and record.trusted:
            self._begin_anew()
        elif not self._usable:
            return  # what is refused then is not why no range comes later
        elif isinstance(record, CorrectedRange) and record.reject is not None:
            self._refused[_named(record.reject)] += 1
        elif isinstance(record, TriggerPlan):
            self._note_plan(record)
        elif isinstance(record, Shot | MatchSet):
            self._events[type(record)] += 1
        elif isinstance(record, Rejected) and record.what.startswith(("pair ", "camera frames")):
            self._refused[_named(record.reason)] += record.count
        elif isinstance(record, Rejected) and record.reason is Reject.DEVICE_FAILED:
            self._skipped[f"{record.reason}: {record.what}"] += record.count

    def _note_plan(self, plan: TriggerPlan) -> None:
        """Count the plan before, if its command was due: one that gave way in time was neither fired nor skipped."""
        last, self._plan = self._plan, plan
        if last is None or last.plan_id == plan.plan_id or plan.planned_host_ns < last.command_host_ns:
            return
        if last.firing is not Firing.SKIP:
            self._events[TriggerPlan] += 1
        elif last.reject is not None:
            self._skipped[_named(last.reject)] += 1

    def tick(self, now_ns: int, *, usable: bool) -> None:
        """Count the time since the last tick; ``usable`` says that the tracker would let ranges pass."""
        passed_ns = 0 if self._last_tick_ns is None else min(now_ns - self._last_tick_ns, _LONGEST_STEP_NS)
        self._last_tick_ns, self._usable = now_ns, usable
        if usable:
            self.waited_ns += passed_ns
        else:
            self.untracked_ns += passed_ns
        if now_ns - self._aged_ns >= _AGE_NS:  # what was long ago explains nothing now
            self._aged_ns = now_ns
            for counts in (self._refused, self._skipped, self._events):
                _halve(counts)

    def reason(self, settings: Settings) -> str | None:
        """Why no range comes, once that has lasted for 5 s; None before."""
        if self.waited_ns < _PATIENCE_NS:
            return None
        return f"no range: {self._cause(settings)}"

    def due(self, health_reason: str, settings: Settings, now_ns: int) -> str | None:
        """The sentence for the operator, if one is due: a new one at once, the same again every 20 s.

        ``health_reason`` is what the health tells; of a tracker that is not usable it is said after 30 s.
        """
        reason = self.reason(settings)
        if reason != health_reason:
            reason = f"no range: {health_reason}" if self.untracked_ns >= _UNTRACKED_PATIENCE_NS else None
        if reason is None or (reason == self._said and now_ns - self._said_ns < _REPEAT_NS):
            return None
        self._said, self._said_ns = reason, now_ns
        return reason

    def _cause(self, settings: Settings) -> str:
        if self._refused:
            return _most(self._refused)
        if self._events[MatchSet]:
            return "image pairs wait for the smoother"
        if settings.trigger_policy == Policy.OFF:
            return "triggering is off (TRG_POLICY 2)"
        if self._events[Shot]:
            return NO_PAIRS
        if self._events[TriggerPlan] > sum(self._skipped.values()):
            return "nothing fires and no image pairs come: --trigger, --cameras?"
        if self._skipped:
            return f"no shot: {_most(self._skipped)}"
        return "no shot is planned"

    def _begin_anew(self) -> None:
        self.waited_ns, self.untracked_ns, self._said = 0, 0, ""
        for counts in (self._refused, self._skipped, self._events):
            counts.clear()


@dataclass(slots=True)
class Complaints:
    """Sentences for the operator, each told as it comes up, and again every 20 s as long as it holds."""

    _said_ns: dict[str, int] = field(default_factory=dict)

    def due(self, sentences: list[str], now_ns: int) -> list[str]:
        """Those of the sentences that hold now which are to be said."""
        due = [text for text in sentences if now_ns - self._said_ns.get(text, now_ns - _REPEAT_NS) >= _REPEAT_NS]
        self._said_ns = {text: now_ns if text in due else self._said_ns[text] for text in sentences}
        return due


def _named(reason: Reject) -> str:
    setting = _SETTINGS.get(reason)
    return f"{reason} ({setting})" if setting else str(reason)


def _halve(counts: Counter[Any]) -> None:
    for key, count in list(counts.items()):
        if count > 1:
            counts[key] = count // 2
        else:
            del counts[key]


def _most(counts: Counter[str]) -> str:
    ((text, _),) = counts.most_common(1)
    return text
