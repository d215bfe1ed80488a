"""The vision process beside matching: live range limits, and frames chosen where nobody triggers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.stereo.geometry import Rig
from companion.core.stereo.vision import FrameChoice, VisionState, vision_step
from companion.params.settings import Settings
from companion.records import (
    ClockName,
    Firing,
    Frame,
    FramePair,
    MatchSet,
    ParameterChange,
    Reject,
    Rejected,
    Side,
    TriggerPlan,
)
from sitl_tests.unit.stereo_cases import nadir
from sitl_tests.unit.stereo_scene import TexturedPlane, photograph

MS = 1_000_000
RANGE_M = 8.0
BLANK = np.zeros((2, 2), dtype=np.uint8)


def _frames(shot: int) -> list[Frame]:
    """Textured ground at 8 m, seen in trim, with the noise of this shot."""
    airframe = nadir()
    rig, wing = Rig.from_airframe(airframe), airframe.wing
    slope = wing.symmetric.slope_factor_radpm.value * wing.trim_bend_m.value
    plane = TexturedPlane.facing((0.0, 0.0, 1.0), RANGE_M, 800.0, seed=2)
    poses = [rig.pose(side, slope, wing.trim_bend_m.value) for side in Side]
    images = [photograph(plane, rig.camera(side), poses[side], noise_grey=2.0, seed=2 * shot + side) for side in Side]
    return [Frame(side, shot, ClockName.HOST, shot * 100 * MS, 2 * MS, 0, shot, images[side]) for side in Side]


def _matches(state: VisionState, frames: list[Frame]) -> int:
    records = [record for frame in frames for record in vision_step(state, frame, 0)]
    assert len(records) == 1
    assert isinstance(records[0], MatchSet)
    return len(records[0].sigma_px)


@pytest.mark.slow
def test_live_range_limits_reach_the_search() -> None:
    """Nothing at 8 m is found while RNG_MIN is 30 m; a ground station lowers it, and the next pair has it."""
    state = VisionState.create(nadir(), dataclasses.replace(Settings(), min_range_m=30.0))
    few = _matches(state, _frames(1))
    assert vision_step(state, ParameterChange("RNG_MIN", 4.0, 0), 0) == []
    many = _matches(state, _frames(2))
    assert many > 50
    assert few < 0.1 * many
    vision_step(state, ParameterChange("RNG_MAX", 5.0, 0), 0)
    assert _matches(state, _frames(3)) < 0.1 * many


def _plan(plan_id: int, t_ns: int, firing: Firing = Firing.PEAK) -> TriggerPlan:
    return TriggerPlan(plan_id, firing, t_ns - 8 * MS, t_ns, 0, 0.1, t_ns, t_ns - 60 * MS, None)


def _pair(number: int, t_ns: int) -> FramePair:
    left, right = (Frame(side, number, ClockName.HOST, t_ns, 2 * MS, 0, -1, BLANK) for side in Side)
    return FramePair(number, left, right)


@settings(deadline=None)
@given(
    period_ms=st.integers(10, 50),
    wanted=st.lists(st.integers(200, 2800), min_size=1, max_size=12, unique=True),
    phase_ms=st.integers(0, 49),
)
def test_of_free_running_cameras_each_plan_gets_the_nearest_pair(
    period_ms: int, wanted: list[int], phase_ms: int
) -> None:
    period_ns = period_ms * MS + 1  # no pair is exactly midway between two instants
    plans = sorted({t // 100: t * MS for t in wanted}.values())
    plans = [t for k, t in enumerate(plans) if k == 0 or t - plans[k - 1] > 2 * period_ns]
    choice, waiting, taken = FrameChoice(), list(enumerate(plans)), []
    for k in range(3000 // period_ms):
        t_ns = phase_ms * MS + k * period_ns
        while waiting and waiting[0][1] - 60 * MS <= t_ns:
            choice.plan(_plan(*waiting.pop(0)))
        if choice.takes(_pair(k, t_ns)):
            taken.append(t_ns)
    last_ns = t_ns
    assert len(taken) == len([t for t in plans if t <= last_ns])
    assert all(abs(a - b) <= period_ns / 2 for a, b in zip(taken, plans, strict=False))


def test_a_plan_that_was_replaced_or_skipped_takes_no_pair() -> None:
    choice = FrameChoice()
    choice.takes(_pair(0, 0))
    choice.plan(_plan(1, 100 * MS))
    choice.plan(_plan(2, 80 * MS))
    choice.plan(_plan(3, 60 * MS, Firing.SKIP))
    assert [k for k in range(1, 10) if choice.takes(_pair(k, 20 * MS * k))] == []


def test_a_plan_that_is_put_off_again_and_again_takes_one_pair() -> None:
    choice = FrameChoice()
    for late_ms in (0, 5, 10, 15):
        choice.plan(_plan(1, (100 + late_ms) * MS))
    choice.takes(_pair(0, 0))
    assert [k for k in range(1, 12) if choice.takes(_pair(k, 20 * MS * k))] == [6]
    choice.plan(_plan(2, 300 * MS))
    choice.plan(_plan(2, 304 * MS, Firing.SKIP))
    assert [k for k in range(12, 20) if choice.takes(_pair(k, 20 * MS * k))] == []


@pytest.mark.slow
def test_triggered_cameras_are_matched_whatever_is_planned() -> None:
    state = VisionState.create(nadir(), Settings())
    vision_step(state, _plan(1, 10**12), 0)
    assert _matches(state, _frames(1)) > 50
    free = VisionState.create(nadir(), Settings(), free_running=True)
    assert [record for frame in _frames(2) for record in vision_step(free, frame, 0)] == []


def test_a_gap_in_the_numbers_of_one_camera_is_told_with_how_many_images_it_lacks() -> None:
    free = VisionState.create(nadir(), Settings(), free_running=True)

    def losses(side: Side, number: int) -> list[tuple[str, int]]:
        frame = Frame(side, number, ClockName.HOST, number * MS, MS, 0, -1, BLANK)
        answers = vision_step(free, frame, 0)
        return [
            (answer.what, answer.count) for answer in answers if getattr(answer, "reason", None) is Reject.FRAME_LOST
        ]

    assert losses(Side.LEFT, 7) == []  # nobody knows what came before the first
    assert losses(Side.LEFT, 8) == []
    assert losses(Side.RIGHT, 11) == []
    assert losses(Side.LEFT, 12) == [("left frames", 3)]
    assert losses(Side.LEFT, 11) == []  # a late one
    assert losses(Side.LEFT, 13) == []
    assert losses(Side.LEFT, 2) == []  # a camera that begins anew
    assert losses(Side.LEFT, 4) == [("left frames", 1)]


def test_a_lonely_frame_is_told_while_frames_are_chosen_too() -> None:
    free = VisionState.create(nadir(), Settings(), free_running=True)
    vision_step(free, Frame(Side.LEFT, 1, ClockName.HOST, 5 * MS, MS, 0, -1, BLANK), 0)
    records = vision_step(free, Frame(Side.LEFT, 0, ClockName.HOST, MS, MS, 0, -1, BLANK), 0)
    assert [getattr(record, "reason", None) for record in records] == [Reject.UNPAIRED]


def _patterned(side: Side, shot: int, seed: int | None) -> Frame:
    """A frame of noise of its own, or of one grey."""
    image = np.full((480, 640), 7, dtype=np.uint8)
    if seed is not None:
        image = np.random.default_rng(seed).integers(0, 255, image.shape, dtype=np.uint8)
    return Frame(side, shot, ClockName.HOST, shot * 100 * MS, MS, 0, -1, image)


def _said(state: VisionState, seeds: list[tuple[int | None, int | None]]) -> list[Reject | None]:
    records: list[MatchSet | Rejected] = []
    for shot, seed in enumerate(seeds):
        if state.choice is not None and shot > 0:
            vision_step(state, _plan(shot, shot * 100 * MS), 0)
        for side in Side:
            records += vision_step(state, _patterned(side, shot, seed[side]), 77)
    assert all(record.at_host_ns == 77 for record in records if isinstance(record, Rejected))
    return [record.reason if isinstance(record, Rejected) else None for record in records]


@pytest.mark.parametrize("held", list(Side))
def test_a_camera_that_sends_its_last_image_again_gives_no_matches(held: Side) -> None:
    """Its stamps go on, so that nothing but the images tells that the range is one of long ago."""
    seeds = [(1, 2), (3, 4), (3, 6), (3, 8), (9, 10)]
    shown = [pair if held is Side.LEFT else pair[::-1] for pair in seeds]
    verdicts: list[Reject | None] = [None, None, Reject.FROZEN, Reject.FROZEN, None]
    assert _said(VisionState.create(nadir(), Settings()), shown) == verdicts
    assert _said(VisionState.create(nadir(), Settings(), free_running=True), shown) == verdicts[1:]


def test_covered_lenses_are_not_frozen() -> None:
    """They show nothing, and that is what is said of them: too few matches."""
    assert _said(VisionState.create(nadir(), Settings()), [(None, None)] * 3) == [None] * 3
