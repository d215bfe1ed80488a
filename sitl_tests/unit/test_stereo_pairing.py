"""Pairing by exposure time: no loss, duplicate, delay or reordering may join frames of different shots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.stereo.pairing import FramePairer
from companion.records import ClockName, Frame, Reject, Side

IMAGE = np.zeros((2, 2), dtype=np.uint8)


def _frame(side: Side, shot: int, skew_ns: int = 0) -> Frame:
    return Frame(side, shot, ClockName.HOST, shot * 100_000_000 + skew_ns, 2_000_000, 0, -1, IMAGE)


@pytest.mark.slow
@settings(deadline=None)
@given(
    lost=st.sets(st.tuples(st.integers(0, 19), st.sampled_from(list(Side)))),
    lag=st.integers(0, 3),
    skews=st.lists(st.integers(-3_000_000, 3_000_000), min_size=20, max_size=20),
)
def test_lost_and_late_frames_never_shift_the_pairing(lost: set[tuple[int, Side]], lag: int, skews: list[int]) -> None:
    arrivals = [(shot, Side.LEFT, shot) for shot in range(20)] + [(shot + lag, Side.RIGHT, shot) for shot in range(20)]
    pairer, pairs, lonely = FramePairer(), [], []
    for _, side, shot in sorted(arrivals):
        if (shot, side) not in lost:
            made, dropped = pairer.add(_frame(side, shot, skews[shot] if side is Side.RIGHT else 0))
            pairs += made
            lonely += dropped
    complete = {shot for shot in range(20) if not {(shot, Side.LEFT), (shot, Side.RIGHT)} & lost}
    assert all(pair.left.sequence == pair.right.sequence for pair in pairs)
    assert {pair.left.sequence for pair in pairs} == complete
    assert all(drop.reason is Reject.UNPAIRED for drop in lonely)


def test_an_extra_frame_finds_no_partner() -> None:
    pairer = FramePairer()
    pairer.add(_frame(Side.LEFT, 1))
    pairer.add(_frame(Side.LEFT, 1, 40_000_000))
    pairs, _ = pairer.add(_frame(Side.RIGHT, 1, 200_000))
    assert [(pair.left.mid_exposure_ns, pair.right.sequence) for pair in pairs] == [(100_000_000, 1)]


def test_a_repeated_stale_frame_is_refused() -> None:
    pairer = FramePairer()
    pairer.add(_frame(Side.LEFT, 2))
    _, dropped = pairer.add(_frame(Side.LEFT, 1))
    assert [drop.reason for drop in dropped] == [Reject.UNPAIRED]


def test_a_pair_that_comes_again_is_no_second_pair() -> None:
    pairer = FramePairer()
    made = [pairer.add(_frame(side, 2)) for side in (Side.LEFT, Side.RIGHT, Side.LEFT, Side.RIGHT)]
    assert [len(pairs) for pairs, _ in made] == [0, 1, 0, 0]
    assert [[drop.reason for drop in dropped] for _, dropped in made[2:]] == [[Reject.UNPAIRED], [Reject.UNPAIRED]]


def test_cameras_whose_clock_began_anew_are_paired_again() -> None:
    pairer = FramePairer()
    pairer.add(_timed(Side.LEFT, 1, 60_000, -1))
    made = [pairer.add(_timed(side, 1, 100, -1)) for side in Side]
    assert [len(pairs) for pairs, _ in made] == [0, 1]
    assert [drop.at_host_ns for _, dropped in made for drop in dropped] == [60_000_000_000]


@pytest.mark.parametrize("leap_ns", [150_000_000, 1_900_000_000])
def test_one_stamp_that_leaps_ahead_costs_two_pairs(leap_ns: int) -> None:
    pairer, paired = FramePairer(), []
    for shot in range(1, 31):
        for side in Side:
            leaps = side is Side.LEFT and shot == 5
            made, _ = pairer.add(_frame(side, shot, leap_ns if leaps else 0))
            paired += [(pair.left.sequence, pair.right.sequence) for pair in made]
    assert all(first == second for first, second in paired)
    assert {first for first, _ in paired} >= {shot for shot in range(1, 31) if shot not in (5, 6)}


@st.composite
def _streams(draw: st.DrawFn) -> tuple[list[tuple[int, Frame]], set[int]]:
    """Frames of two cameras as they arrive, and the shots of which both are there.

    Shots are 40 to 200 ms apart; a shot's frames differ by up to 6 ms of skew. Frames get lost, arrive late by up to
    three shots, come twice (the stale copy of a shot before), and extra ones appear far from any shot.
    """
    gaps = draw(st.lists(st.integers(40, 200), min_size=4, max_size=14))
    shots = np.cumsum([1000, *gaps]).tolist()
    numbered = draw(st.booleans())
    arrivals: list[tuple[float, int, Frame]] = []
    delivered: list[set[int]] = [set(), set()]
    for side in Side:
        lag = draw(st.integers(0, 300))
        for number, at_ms in enumerate(shots):
            skew_ms = draw(st.integers(-3, 3))
            if draw(st.integers(0, 9)) == 0:
                continue
            delivered[side].add(number)
            frame = _timed(side, number, at_ms + skew_ms, number if numbered else -1)
            arrivals.append((at_ms + 10 + lag, side, frame))
            if draw(st.integers(0, 9)) == 0:
                arrivals.append((at_ms + 11 + lag, side, frame))
            if draw(st.integers(0, 9)) == 0:
                arrivals.append((at_ms + 30 + lag, side, _timed(side, 1000 + number, at_ms + 20, -1)))
    arrivals.sort(key=lambda entry: (entry[0], entry[1]))
    return [(side, frame) for _, side, frame in arrivals], delivered[0] & delivered[1]


def _timed(side: Side, sequence: int, at_ms: int, plan_id: int) -> Frame:
    return Frame(side, sequence, ClockName.HOST, at_ms * 1_000_000, 2_000_000, 0, plan_id, IMAGE)


@pytest.mark.slow
@settings(deadline=None)
@given(_streams())
def test_stale_missing_and_extra_frames_never_shift_the_pairing(
    streams: tuple[list[tuple[int, Frame]], set[int]],
) -> None:
    arrivals, complete = streams
    pairer, pairs, lonely = FramePairer(), [], []
    for _, frame in arrivals:
        made, dropped = pairer.add(frame)
        pairs += made
        lonely += dropped
    shots = [(pair.left.sequence, pair.right.sequence) for pair in pairs if pair.left.sequence < 1000]
    assert all(left == right for left, right in shots)
    assert {left for left, _ in shots} == complete
    assert [pair.pair_id for pair in pairs] == list(range(len(pairs)))
    # no frame is used twice
    for side in Side:
        used = [(pair.left, pair.right)[side].mid_exposure_ns for pair in pairs]
        assert len(set(used)) == len(used)


@settings(deadline=None)
@given(st.integers(0, 7), st.integers(0, 7))
def test_frames_that_name_different_plans_are_no_pair_however_near(left_ms: int, right_ms: int) -> None:
    pairer = FramePairer()
    assert pairer.add(_timed(Side.LEFT, 1, 100 + left_ms, 4)) == ([], [])
    pairs, _ = pairer.add(_timed(Side.RIGHT, 1, 100 + right_ms, 5))
    assert pairs == []
    pairs, _ = pairer.add(_timed(Side.RIGHT, 2, 108 + left_ms, -1))
    assert [(pair.left.sequence, pair.right.sequence) for pair in pairs] == [(1, 2)]
