"""A fixed number of hostile inputs of every kind; longer by ``make fuzz SECONDS=3600``."""

from __future__ import annotations

import contextlib
import functools
from collections import Counter

import numpy as np
import pytest

from companion.records import Notice, Reject, Rejected
from sitl_tests.fuzz import runner
from sitl_tests.fuzz.hostile import check_contained
from sitl_tests.fuzz.runner import TooSlow, fuzz, make_case
from sitl_tests.fuzz.target import LIMIT_S, Ending, Violation
from sitl_tests.fuzz.targets import NAMES, make_target

CASES = {"decoder": 50, "flight": 2, "tlog": 30, "mcap": 30, "images": 100, "replay": 6, "doctor": 6}
USUAL_CASES = 60


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_case_ends_in_data_or_in_one_sentence(name: str) -> None:
    result = fuzz(functools.partial(make_target, name), seed=20260101, cases=CASES.get(name, USUAL_CASES))
    assert not result.findings, result.findings[0].problem
    assert result.cases == CASES.get(name, USUAL_CASES)
    assert result.endings[Ending.DATA] > 0.01 * result.cases, "some damage leaves something to use"


class Trap:
    """Ends in every way that there is."""

    name = "trap"
    limit_s = LIMIT_S

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def warm(self) -> None:
        pass

    def case(self, rng: np.random.Generator) -> bytes:
        return rng.bytes(4)

    def run(self, data: bytes) -> Ending:
        return Ending.DATA


class Greedy(Trap):
    def run(self, data: bytes) -> Ending:
        _ = np.ones(runner.MEMORY_LIMIT_BYTES // 4)
        return Ending.DATA


class Endless(Trap):
    limit_s = 0.2

    def run(self, data: bytes) -> Ending:
        while True:
            pass


class Swallowing(Trap):
    """Makes something else of the alarm, as compiled code and what contains a defect do."""

    limit_s = 0.2

    def run(self, data: bytes) -> Ending:
        with contextlib.suppress(TooSlow):
            while True:
                pass
        return Ending.DATA


class Broken(Trap):
    def run(self, data: bytes) -> Ending:
        raise IndexError(data.hex())


@pytest.mark.slow
def test_an_exception_is_a_finding_and_its_case_can_be_made_again() -> None:
    result = fuzz(Broken, seed=3, cases=2)
    assert [finding.number for finding in result.findings] == [0, 1]
    assert make_case(Broken(), 3, 1).hex() in result.findings[1].problem


@pytest.mark.slow
def test_more_than_a_gigabyte_is_a_finding() -> None:
    (finding,) = fuzz(Greedy, seed=1, cases=1).findings
    assert "MemoryError" in finding.problem


@pytest.mark.slow
def test_an_alarm_that_is_swallowed_is_a_finding() -> None:
    """An alarm within a compiled loop is a SystemError, which the service contained."""
    (finding,) = fuzz(Swallowing, seed=1, cases=1).findings
    assert finding.problem.strip() == "TooSlow: more than 0.2 s, and the alarm was swallowed"


def test_a_contained_exception_is_a_finding() -> None:
    refused = Rejected(Reject.INTERNAL_ERROR, "MatchSet", 5, 3)
    check_contained([Rejected(Reject.STALE, "root", 5, 3), Notice(3, "tracker restarted", 5)])
    with pytest.raises(Violation, match=r"'MatchSet': 3.*IndexError: 7 \(ranging.py:5\)"):
        check_contained([refused, Notice(3, "internal error: MatchSet refused: IndexError: 7 (ranging.py:5)", 5)])


@pytest.mark.slow
def test_more_than_the_time_limit_is_a_finding() -> None:
    """Ten seconds where a target says nothing else, as for every reader."""
    (finding,) = fuzz(Endless, seed=1, cases=1).findings
    assert "TooSlow: more than 0.2 s" in finding.problem
    assert LIMIT_S == 10.0
