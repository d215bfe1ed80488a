"""Stamps that are off the latency which a camera keeps otherwise: the pair is not believed, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.pipeline import PipelineState, start, step
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, MatchSet, Reject, Shot

MS = 1_000_000
S = 1_000_000_000
PERIOD_NS, LATENCY_NS, JITTER_NS = 120 * MS, 9 * MS, 50_000
LATE_NS = 15 * MS


class Shots:
    """A pipeline that fires and sees, one pair after the other."""

    def __init__(self) -> None:
        self.state: PipelineState = start(load_airframe("nadir-2m"), Settings())
        self.random = np.random.default_rng(3)
        self.number = 0

    def see(self, left_ns: int, right_ns: int, *, fire: bool = True) -> Reject | None:
        """Why the stamps of a pair are not believed, which are later by so much than its exposures."""
        self.number += 1
        fired_ns = S + self.number * PERIOD_NS
        if fire:
            self.state, _ = step(self.state, Shot(self.number, fired_ns, fired_ns))
        jitter_ns = (JITTER_NS * self.random.standard_normal(2)).astype(np.int64)
        stamps_ns = fired_ns + LATENCY_NS + jitter_ns + np.array([left_ns, right_ns])
        none = np.zeros((0, 2))
        clocks, done_ns = (ClockName.HOST, ClockName.HOST), fired_ns + 60 * MS
        pair = MatchSet(
            self.number, self.number if fire else -1, clocks, stamps_ns, 2 * MS, 0, none, none, np.zeros(0), done_ns
        )
        self.state, _ = step(self.state, pair)
        assert self.state.correction is not None
        return self.state.correction.pending[-1].stamps


@pytest.fixture
def settled() -> Shots:
    shots = Shots()
    assert [shots.see(0, 0) for _ in range(40)] == [None] * 40
    return shots


@pytest.mark.parametrize("late_ns", [LATE_NS, 2 * MS, -2 * MS, -LATE_NS])
@pytest.mark.parametrize("sides", [(1, 0), (0, 1), (1, 1)])
def test_a_pair_with_a_stamp_off_the_learned_latency_is_not_believed(
    settled: Shots, late_ns: int, sides: tuple[int, int]
) -> None:
    """Earlier by 15 ms is before the command."""
    assert settled.see(sides[0] * late_ns, sides[1] * late_ns) is Reject.STAMP_OUTLIER
    assert settled.see(0, 0) is None


def test_a_fifth_of_late_stamps_costs_that_fifth() -> None:
    """Chance gives five late ones in a row once in 3000 pairs; they would be taken for a new latency."""
    shots, random = Shots(), np.random.default_rng(1)
    late = random.random(300) < 0.2
    refused = np.array([shots.see(LATE_NS if wrong else 0, 0) is not None for wrong in late])
    assert not refused[~late].any()
    assert refused[40:][late[40:]].all()


def test_a_latency_that_changes_for_good_is_believed_after_five_pairs(settled: Shots) -> None:
    verdicts = [settled.see(LATE_NS, LATE_NS) for _ in range(12)]
    assert verdicts == [Reject.STAMP_OUTLIER] * 5 + [None] * 7


def test_without_a_shot_nothing_is_said_of_stamps(settled: Shots) -> None:
    settled.number += 100
    assert [settled.see(int(late_ns), 0, fire=False) for late_ns in 20 * MS * np.arange(5)] == [None] * 5


def test_cameras_that_run_freely_beside_shots_are_believed() -> None:
    """Their exposures fall anywhere between two shots."""
    shots, random = Shots(), np.random.default_rng(2)
    anywhere = random.integers(0, 100, (200, 2)) * MS
    verdicts = [shots.see(int(left_ns), int(right_ns)) for left_ns, right_ns in anywhere]
    assert verdicts.count(None) > 190
