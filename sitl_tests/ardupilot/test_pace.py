"""The judge of a run's pace, on made-up stamps: what is the machine's is skipped, what is the code's is not."""

from __future__ import annotations

import numpy as np
import pytest

from companion.records import Ints
from sitl_tests.ardupilot.pace import Pace, measured, skip_if_busy
from sitl_tests.ardupilot.rail import RATE_HZ

SECOND_NS = 1_000_000_000
START_NS = 7 * SECOND_NS
FLOWN_S = 40
FROM_NS, TO_NS = START_NS + 5 * SECOND_NS, START_NS + FLOWN_S * SECOND_NS


def frames() -> Ints:
    """On time but for the scheduler's tenths of a millisecond."""
    jitter = np.abs(np.random.default_rng(1).normal(0.0, 2e5, FLOWN_S * RATE_HZ)).astype(np.int64)
    due = START_NS + np.arange(FLOWN_S * RATE_HZ) * SECOND_NS // RATE_HZ
    return np.maximum.accumulate(due + jitter)


def ticks(apart_ms: int = 10) -> Ints:
    return np.arange(START_NS, TO_NS + SECOND_NS, apart_ms * 1_000_000)


def stalled(stamps: Ints, at_s: float, for_s: float) -> Ints:
    """Nobody runs for a while; what was due meanwhile comes at once afterwards."""
    at_ns, ends_ns = START_NS + round(at_s * 1e9), START_NS + round((at_s + for_s) * 1e9)
    return np.where((stamps > at_ns) & (stamps < ends_ns), ends_ns, stamps)


def pace(sent: Ints, ticked: Ints) -> Pace:
    return measured(sent, ticked, FROM_NS, TO_NS, 1.5)


def test_a_run_on_a_quiet_machine_is_judged() -> None:
    assert pace(frames(), ticks()).can_be_judged


def test_stalls_before_the_flight_do_not_count() -> None:
    assert pace(stalled(frames(), 1.0, 2.0), stalled(ticks(), 1.0, 2.0)).can_be_judged


def test_a_few_short_stalls_are_what_every_machine_has() -> None:
    sent = frames()
    for at_s in range(6, 40, 3):
        sent = stalled(sent, at_s, 0.018)
    assert pace(sent, ticks()).can_be_judged


def test_frames_that_are_late_one_time_in_ten_are_the_machines() -> None:
    sent = frames()
    for at_s in np.arange(6.0, 39.0, 0.5):
        sent = stalled(sent, float(at_s), 0.06)
    run_pace = pace(sent, ticks())
    assert not run_pace.can_be_judged
    assert run_pace.frames == pytest.approx(1.0 - 66 * 0.05 / 35, abs=0.01)


def test_a_physics_that_falls_behind_for_good_is_the_machines() -> None:
    sent = frames()
    slow = START_NS + np.round((sent - START_NS) * 1.02).astype(np.int64)
    assert not pace(slow, ticks()).can_be_judged


def test_a_service_that_is_kept_from_its_turns_is_the_machines() -> None:
    run_pace = pace(frames(), ticks(30))
    assert not run_pace.can_be_judged
    assert run_pace.ticks == pytest.approx(0.0, abs=0.01)


def test_half_a_second_without_a_turn_makes_the_rangefinder_dead_and_is_the_machines() -> None:
    assert pace(frames(), stalled(ticks(), 20.0, 0.4)).can_be_judged
    assert not pace(frames(), stalled(ticks(), 20.0, 0.6)).can_be_judged


def test_no_frame_at_all_cannot_be_judged() -> None:
    assert not pace(frames()[: 2 * RATE_HZ], ticks()).can_be_judged


def test_a_skipped_test_says_the_figures_and_the_load() -> None:
    with pytest.raises(pytest.skip.Exception, match=r"ticks on time in 0 %.*longest stall 30 ms.*load \d"):
        skip_if_busy(frames().tolist(), ticks(30).tolist(), FROM_NS, TO_NS)
    skip_if_busy(frames().tolist(), ticks().tolist(), FROM_NS, TO_NS)
