"""Pairing by exposure time: no loss, duplicate, delay or reordering may join frames of different shots."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.core.stereo.pairing import FramePairer
from companion.records import ClockName, Frame, Reject, Side

IMAGE = np.zeros((2, 2), dtype=np.uint8)


def _frame(side: Side, shot: int, skew_ns: int = 0) -> Frame:
    return Frame(side, shot, ClockName.HOST, shot * 100_000_000 + skew_ns, 2_000_000, 0, -1, IMAGE)


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
