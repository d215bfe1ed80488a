"""Outcomes of the plans: every plan has one end, and it is the one that really came."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.doctor.evidence import Evidence, FindingLevel
from companion.doctor.wing import check_cameras
from companion.evaluation.plan_outcomes import FAILED, FIRED, LATE, REPLACED, UNANSWERED, WITHDRAWN, PlanOutcomes
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Firing, Reject, Rejected, Shot, TriggerPlan

MS = 1_000_000


def plan(
    number: int, at_ms: int, reject: Reject | None = None, firing: Firing = Firing.PEAK, ahead_ms: int = 100
) -> TriggerPlan:
    """A plan of a command at ``at_ms``, made ``ahead_ms`` before it."""
    at_ns = at_ms * MS
    return TriggerPlan(number, firing, at_ns, at_ns, 0, 0.0, at_ns + 10 * MS, at_ns - ahead_ms * MS, reject)


ENDS = (FIRED, REPLACED, UNANSWERED, LATE, FAILED, WITHDRAWN, "refused after the shot", "skipped")


@given(st.lists(st.sampled_from(ENDS), max_size=80), st.integers(1, 4))
def test_each_plan_is_counted_once_under_what_happened_to_it(ends: list[str], versions: int) -> None:
    outcomes, expected = PlanOutcomes(), Counter[str]()
    ahead_ms = 100
    for turn, end in enumerate(ends):
        number, at_ms = 5000 + turn, 1000 + 300 * turn
        for _ in range(versions):
            outcomes.take(plan(number, at_ms, ahead_ms=ahead_ms))
        ahead_ms = 350 if end == REPLACED else 100  # the next plan is made before or after this one's command
        if end in (FIRED, "refused after the shot"):
            outcomes.take(Shot(number, at_ms * MS, at_ms * MS))
        if end == WITHDRAWN:
            outcomes.take(plan(number, at_ms, None, Firing.SKIP))
        if end == "skipped":
            outcomes.take(plan(number, at_ms, Reject.PEAK_UNCERTAIN, Firing.SKIP))
        if end == LATE:
            outcomes.take(Rejected(Reject.PLAN_EXPIRED, f"plan {number}", (at_ms + 11) * MS))
        if end in (FAILED, "refused after the shot"):
            outcomes.take(Rejected(Reject.DEVICE_FAILED, "no camera", (at_ms + 4) * MS))
            end = FAILED
        expected[f"skipped: {Reject.PEAK_UNCERTAIN}" if end == "skipped" else end] += 1
    at_ms = 1000 + 300 * len(ends)
    outcomes.take(plan(9999, at_ms, ahead_ms=ahead_ms))  # one that waits is not counted yet
    assert outcomes.counts() == expected


def test_a_shot_stays_a_shot_although_its_plan_was_refined_too_late() -> None:
    outcomes = PlanOutcomes()
    for record in (plan(1, 500), Shot(1, 500 * MS, 500 * MS), plan(1, 503), plan(2, 800)):
        outcomes.take(record)
    assert outcomes.counts() == {FIRED: 1}


@pytest.mark.parametrize(
    ("reason", "count", "level", "said"),
    [
        (Reject.PLAN_EXPIRED, 2, FindingLevel.OK, "2 came too late"),
        (Reject.PLAN_EXPIRED, 9, FindingLevel.FIX, "real-time priority"),
        (Reject.DEVICE_FAILED, 9, FindingLevel.FIX, "is a camera set up"),
    ],
)
def test_the_doctor_says_how_many_shots_were_not_made_and_why(
    reason: Reject, count: int, level: FindingLevel, said: str
) -> None:
    evidence = Evidence(load_airframe("nadir-2m"), Settings(), live=False)
    for number in range(100):
        evidence.plan_outcomes.take(plan(number, 300 * number))
        if number < count:
            evidence.plan_outcomes.take(Rejected(reason, f"plan {number}", (300 * number + 11) * MS))
        else:
            evidence.plan_outcomes.take(Shot(number, 300 * number * MS, 300 * number * MS))
    (finding,) = check_cameras(evidence)
    assert (finding.subject, finding.level) == ("shots", level)
    assert said in finding.text
    assert f"{100 - count} {FIRED}" in finding.text


@pytest.mark.parametrize(("silent", "level"), [(2, FindingLevel.OK), (30, FindingLevel.FIX)])
def test_the_doctor_tells_a_trigger_that_does_not_answer(silent: int, level: FindingLevel) -> None:
    evidence = Evidence(load_airframe("nadir-2m"), Settings(), live=False)
    for number in range(101):
        evidence.plan_outcomes.take(plan(number, 300 * number))
        if silent <= number < 100:
            evidence.plan_outcomes.take(Shot(number, 300 * number * MS, 300 * number * MS))
    (finding,) = check_cameras(evidence)
    assert (finding.subject, finding.level) == ("shots", level)
    assert f"{silent} {UNANSWERED}" in finding.text
