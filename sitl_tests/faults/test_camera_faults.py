"""A small part of ``python -m sitl_tests.faults.camera_faults``: no wrong range, and trust within a second again."""

from __future__ import annotations

import pytest

from sitl_tests.faults.camera_faults import FAULTS, View, fly

_FAR = View(range_m=60.0, relief_m=1.5, matches=150, sigma_px=0.1, blunders=0.05)
_BY_NAME = {fault.name: fault for fault in FAULTS}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("airframe", "name"),
    [
        ("nadir-2m", "a camera knocked by 2 mrad"),
        pytest.param("forward-2m", "a camera knocked by 5 mrad", marks=pytest.mark.long),
        pytest.param("nadir-2m", "none", marks=pytest.mark.long),
        pytest.param("forward-2m", "none", marks=pytest.mark.long),
        pytest.param("forward-2m", "a camera knocked by 2 mrad", marks=pytest.mark.long),
        pytest.param("nadir-2m", "a camera knocked by 5 mrad", marks=pytest.mark.long),
    ],
)
def test_a_knocked_camera_publishes_nothing_wrong_and_is_soon_trusted_again(airframe: str, name: str) -> None:
    outcome = fly(airframe, _BY_NAME[name], 7)
    assert outcome.wrong == 0
    assert outcome.again_s < 1.0
    assert outcome.trusted > 0.9 * outcome.judged > 50


@pytest.mark.long
def test_a_knock_in_toe_alone_is_found_by_a_pair_that_looks_ahead() -> None:
    """A yaw of 1.2 mrad granted to what obstacles feign hid it: ranges of this flight were 3 m off, at 22 sigma."""
    outcome = fly("forward-2m", _BY_NAME["a camera knocked by 2 mrad of toe alone"], 2)
    assert outcome.wrong == outcome.far_off == 0
    assert outcome.again_s < 1.0
    assert outcome.trusted > 0.9 * outcome.judged > 50


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [pytest.param("a fifth of the stamps 15 ms late", marks=pytest.mark.long), "a fifth of the left stamps 15 ms late"],
)
def test_late_stamps_publish_nothing_wrong(name: str) -> None:
    outcome = fly("nadir-2m", _BY_NAME[name], 4, View())
    assert outcome.late > 10
    assert outcome.wrong == 0
    assert outcome.trusted > 0.5 * outcome.judged


@pytest.mark.long
def test_left_stamps_late_in_a_row_teach_a_forward_pair_no_offset() -> None:
    """Without regard to the learned latency, 27 ranges of this flight were trusted and wrong."""
    outcome = fly("forward-2m", _BY_NAME["a fifth of the left stamps 15 ms late"], 2, _FAR)
    assert outcome.wrong == 0
    assert outcome.trusted > 0.6 * outcome.judged > 50
