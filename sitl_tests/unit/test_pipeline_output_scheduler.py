"""The last gate before a range goes out, and what goes out in its place: closed forms in time and in metres."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.output_scheduler import OutputScheduler
from companion.core.pipeline import start
from companion.core.pipeline_status import motion_text, status
from companion.core.stereo.consistency_gate import RangeGate
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    Axis,
    ClockName,
    ClockState,
    CorrectedRange,
    ModeEstimate,
    ModeState,
    NoRange,
    OutputRecord,
    Reject,
    ServiceStatus,
    Station,
    TimesyncReply,
    Validity,
)

MS = 1_000_000
S = 1_000_000_000
DOWN = 25


def measured(range_m: float, t_ns: int, sigma_m: float = 0.1, *, trusted: bool = True) -> CorrectedRange:
    return CorrectedRange(
        pair_id=1,
        plan_id=1,
        t_host_ns=t_ns,
        orientation=DOWN,
        range_m=range_m,
        sigma_m=sigma_m,
        toe_rad=0.04,
        toe_sigma_rad=0.0002,
        rigid_range_m=20.0,
        matches=50,
        trusted=trusted,
        reject=None if trusted else Reject.SIGMA_TOO_LARGE,
    )


def mode(validity: Validity) -> ModeState:
    still = ModeEstimate(5.0, 0.1, 0.03, 0.01, 0.0, 0.001, 0.0, 1.0, 5.0, 0.1, 0.0)
    return ModeState(10 * S, still, still, validity, np.zeros(2), np.full(2, 0.001), tuple(Station), (Axis.ALL,) * 3)


def verdicts(gate: RangeGate, ranges_m: list[float], climb_mps: float = 0.0, slack_mps: float = 0.0) -> list[bool]:
    """Judge ranges 100 ms apart, beginning at 1 s."""
    return [
        gate.judge(measured(range_m, S + k * 100 * MS), climb_mps, slack_mps).trusted
        for k, range_m in enumerate(ranges_m)
    ]


# ------------------------------------------------------------------------------------------ the gate


def test_three_that_agree_are_needed_before_one_is_trusted() -> None:
    assert verdicts(RangeGate(1.0), [40.0] * 5) == [False, False, True, True, True]


def test_an_outlier_is_refused_and_what_goes_on_from_before_it_is_trusted_at_once() -> None:
    said = verdicts(RangeGate(1.0), [40.0, 40.0, 40.0, 55.0, 40.0, 40.0, 40.0])
    assert said == [False, False, True, False, True, True, True]


def test_a_step_is_not_believed_for_agreeing_with_itself() -> None:
    """Three wrong ranges agree as well as three true ones do: the matches must have told the toe anew, or time pass."""
    gate = RangeGate(1.0)
    assert verdicts(gate, [40.0] * 3 + [55.0] * 20) == [False, False, True] + [False] * 20
    assert gate.jumped
    gate.reopened()
    assert not gate.jumped
    later = [gate.judge(measured(55.0, S + k * 100 * MS), 0.0, 0.0).trusted for k in range(23, 27)]
    assert later == [False, False, True, True]


def test_slack_that_grows_with_time_does_not_excuse_what_has_jumped() -> None:
    """6 m in 0.1 s are a jump at 50 m/s; 0.2 s later that much would be allowed, but it goes on from the jump."""
    assert verdicts(RangeGate(1.0), [40.0] * 3 + [46.0] * 4, slack_mps=50.0) == [False, False, True] + [False] * 4


def test_a_surface_that_stays_for_five_seconds_is_one() -> None:
    said = verdicts(RangeGate(1.0), [40.0] * 3 + [55.0] * 60)
    assert said.index(True, 3) == 53


@pytest.mark.parametrize(("lasting_m", "trusted"), [(0.0, True), (0.99, False)])
def test_what_two_ranges_share_is_no_reason_for_a_jump(lasting_m: float, trusted: bool) -> None:
    """3 m apart with a sigma of 1 m each; nearly all of it the same error in both leaves 0.2 m to differ by."""
    gate = RangeGate(1.0)
    for k in range(3):
        gate.judge(measured(40.0, S + k * 100 * MS, 1.0), 0.0, 0.0, lasting_m)
    assert gate.judge(measured(43.0, S + 300 * MS, 1.0), 0.0, 0.0, lasting_m).trusted is trusted


@given(
    sigma_m=st.floats(0.01, 2.0),
    last_sigma_m=st.floats(0.01, 2.0),
    slack_mps=st.floats(0.0, 20.0),
    step_ns=st.integers(1 * MS, 1_999 * MS),
    jump_ratio=st.floats(0.0, 2.0),
)
def test_the_allowed_jump_is_four_sigma_of_the_difference_and_the_slack(
    sigma_m: float, last_sigma_m: float, slack_mps: float, step_ns: int, jump_ratio: float
) -> None:
    allowed_m = 4.0 * (sigma_m**2 + last_sigma_m**2) ** 0.5 + slack_mps * step_ns * 1e-9
    if abs(jump_ratio - 1.0) < 1e-6:
        return
    gate = RangeGate(1.0)
    for k in range(3):
        gate.judge(measured(40.0, S + k, last_sigma_m), 0.0, slack_mps)
    answer = gate.judge(measured(40.0 + jump_ratio * allowed_m, S + 2 + step_ns, sigma_m), 0.0, slack_mps)
    assert answer.trusted == (jump_ratio < 1.0)
    assert answer.reject is (None if jump_ratio < 1.0 else Reject.INCONSISTENT)


@pytest.mark.parametrize("climb_mps", [-6.0, 6.0])
def test_a_climbing_aircraft_sees_the_ground_recede(climb_mps: float) -> None:
    """0.6 m between two ranges of sigma 0.01 m are a jump, unless the climb rate explains them."""
    receding = [40.0 + 0.1 * climb_mps * k for k in range(5)]
    downward, forward = RangeGate(1.0), RangeGate(0.0)
    ranges = [measured(range_m, S + k * 100 * MS, 0.01) for k, range_m in enumerate(receding)]
    assert [downward.judge(entry, climb_mps, 0.0).trusted for entry in ranges] == [False, False, True, True, True]
    assert not any(forward.judge(entry, climb_mps, 0.0).trusted for entry in ranges)


def test_two_seconds_of_silence_are_forgotten_and_time_never_goes_back() -> None:
    gate = RangeGate(1.0)
    verdicts(gate, [40.0] * 3)
    late = measured(40.0, S + 200 * MS + 2 * S)
    assert not gate.judge(late, 0.0, 0.0).trusted
    gate = RangeGate(1.0)
    verdicts(gate, [40.0] * 3)
    assert not gate.judge(measured(40.0, S), 0.0, 0.0).trusted


def test_what_was_refused_before_does_not_count_and_stays_as_it_is() -> None:
    gate = RangeGate(1.0)
    verdicts(gate, [40.0] * 3)
    refused = measured(90.0, S + 300 * MS, trusted=False)
    assert gate.judge(refused, 0.0, 0.0) is refused
    assert gate.judge(measured(40.0, S + 400 * MS), 0.0, 0.0).trusted, "the refused one is no predecessor"


# ------------------------------------------------------------------------------------------ publishing


def nothing() -> None:
    """No mode to describe."""


@given(st.lists(st.tuples(st.integers(1, 60), st.booleans(), st.booleans()), min_size=1, max_size=120))
def test_an_old_number_never_stands_longer_than_400_ms(turns: list[tuple[int, bool, bool]]) -> None:
    """Whatever comes when: at any tick more than 400 ms after the last trusted range, "no range" went out lately."""
    scheduler, settings = OutputScheduler(DOWN), Settings()
    now_ns = trusted_ns = 10 * S
    scheduler.tick(now_ns, [measured(40.0, now_ns)], nothing, None, settings)
    said_ns: int | None = None
    for wait_ms, comes, good in turns:
        now_ns += wait_ms * MS
        fresh: list[OutputRecord] = [measured(40.0, now_ns, trusted=good)] if comes else []
        outputs = scheduler.tick(now_ns, fresh, nothing, None, settings)
        if comes and good:
            trusted_ns, said_ns = now_ns, None
        if any(isinstance(output, NoRange) for output in outputs):
            said_ns = now_ns
            assert now_ns - trusted_ns > 400 * MS, "a fresh range is not contradicted"
        if now_ns - trusted_ns > 400 * MS:
            assert said_ns is not None
            assert now_ns - said_ns < 100 * MS, "and it is said again at the publishing rate"


def test_silence_is_filled_at_the_publishing_rate_with_the_last_reason() -> None:
    scheduler, settings = OutputScheduler(DOWN), Settings().replace("OUT_RATE", 5.0)
    good = Validity.TRACKING
    scheduler.tick(10 * S, [measured(40.0, 10 * S)], nothing, good, settings)
    scheduler.tick(10 * S + 10 * MS, [measured(40.0, 10 * S, trusted=False)], nothing, good, settings)
    said = [
        output
        for k in range(1, 201)
        for output in scheduler.tick(10 * S + k * 10 * MS, [], nothing, good, settings)
        if isinstance(output, NoRange)
    ]
    assert len(said) == 8, "1.6 s of silence at 5 Hz"
    assert {entry.reject for entry in said} == {Reject.SIGMA_TOO_LARGE}
    assert {entry.orientation for entry in said} == {DOWN}
    (entry,) = [e for e in scheduler.tick(13 * S, [], nothing, Validity.STALE, settings) if isinstance(e, NoRange)]
    assert entry.reject is Reject.STALE


@pytest.mark.parametrize(("rate_hz", "expected"), [(0.0, 0), (4.0, 8), (20.0, 40)])
def test_the_mode_goes_out_at_the_rate_for_graphs(rate_hz: float, expected: int) -> None:
    scheduler, settings = OutputScheduler(DOWN), Settings().replace("OUT_DEBUG", rate_hz)
    calm = functools.partial(mode, Validity.CALM)
    said = [o for k in range(200) for o in scheduler.tick(10 * S + k * 10 * MS, [], calm, Validity.CALM, settings)]
    assert sum(isinstance(output, ModeState) for output in said) == expected


def reasons(scheduler: OutputScheduler, validity: Validity, seconds: range) -> list[Reject]:
    """Why there was no range at these seconds, when nothing was measured."""
    outputs = [scheduler.tick(second * S, [], nothing, validity, Settings()) for second in seconds]
    return [output.reject for group in outputs for output in group if isinstance(output, NoRange)]


@pytest.mark.parametrize(("synced", "reason"), [(False, Reject.CLOCK_UNSYNCED), (True, Reject.NOT_SETTLED)])
def test_before_the_first_samples_a_clock_is_blamed_only_if_it_is_not_synced(synced: bool, reason: Reject) -> None:
    (output,) = OutputScheduler(DOWN).tick(10 * S, [], nothing, None, Settings(), synced=synced)
    assert isinstance(output, NoRange)
    assert output.reject is reason


def test_without_cameras_the_reason_for_no_range_is_not_the_tracker() -> None:
    scheduler = OutputScheduler(DOWN)
    assert reasons(scheduler, Validity.SETTLING, range(10, 12)) == [Reject.NOT_SETTLED] * 2
    assert reasons(scheduler, Validity.TRACKING, range(12, 15)) == [Reject.NO_PAIRS] * 3


@pytest.mark.parametrize("good", [True, False])
def test_what_was_said_of_a_range_long_ago_is_not_said_of_now(good: bool) -> None:
    scheduler = OutputScheduler(DOWN)
    scheduler.tick(10 * S, [measured(40.0, 10 * S, trusted=False)], nothing, Validity.TRACKING, Settings())
    scheduler.tick(11 * S, [measured(40.0, 11 * S, trusted=good)], nothing, Validity.TRACKING, Settings())
    assert reasons(scheduler, Validity.TRACKING, range(14, 16)) == [Reject.NO_PAIRS] * 2


@pytest.mark.parametrize(("rms_mm", "text"), [(4.0, "tracking"), (0.05, "swing within its uncertainty")])
def test_tracking_is_said_only_of_a_swing_that_stands_out_from_its_sigma(rms_mm: float, text: str) -> None:
    state = start(load_airframe("nadir-2m"), Settings())
    unsure = dataclasses.replace(mode(Validity.TRACKING).symmetric, rms_m=1e-3 * rms_mm, amplitude_sigma_m=2e-4)
    described = dataclasses.replace(mode(Validity.TRACKING), symmetric=unsure)
    state.validity = Validity.TRACKING
    state.tracker.describe = lambda: described  # type: ignore[method-assign]
    assert motion_text(state) == text


def test_a_pair_that_looks_ahead_takes_the_next_obstacle_for_no_knock() -> None:
    """Obstacles come and go: a jump is trusted after three that agree, and is no reason to learn the toe anew."""
    gate = RangeGate(0.0, lasting_surface=False)
    assert verdicts(gate, [80.0] * 3 + [30.0] * 4) == [False, False, True, False, False, True, True]
    assert not gate.jumped


def test_a_clock_that_fell_silent_is_told_as_lost() -> None:
    """At its last exchange it was synced for ever."""
    state = start(load_airframe("nadir-2m"), Settings())
    for k in range(60):
        sent_ns = (1000 + k) * S // 10
        for clock in ("boot", "node_left", "node_right"):
            state.clocks.exchange(TimesyncReply(ClockName(clock), sent_ns, sent_ns + 10**6, sent_ns + 2 * 10**6))
    state.validity = Validity.STALE
    for later_ns, synced in ((0, True), (60 * S, False)):
        records = status(state, sent_ns + 2 * 10**6 + later_ns)
        assert {entry.synced for entry in records if isinstance(entry, ClockState)} == {synced}
        (service,) = (entry for entry in records if isinstance(entry, ServiceStatus))
        assert service.reason.startswith("lost sync with boot") is not synced
