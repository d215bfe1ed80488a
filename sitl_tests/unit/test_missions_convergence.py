"""The convergence offset from known distances: closed forms, and the signs held to the cameras' own geometry."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.stereo.geometry import Rig
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.records import Side
from mission_scripts.common.airframe_advice import advise, baseline_m
from mission_scripts.common.convergence import Group, Offset, estimate, group

BASE_M = 1.98


def read(known_m: float, toe_rad: float, scale: float = 1.0) -> float:
    """Published range at a distance: 1/Z' = (1/Z + theta/B)/scale."""
    return scale / (1.0 / known_m + toe_rad / BASE_M)


def groups(toe_rad: float, scale: float, distances_m: tuple[float, ...]) -> list[Group]:
    return [Group(z, 0.05, read(z, toe_rad, scale), 0.01 * z, 400) for z in distances_m]


@given(toe=st.floats(-0.01, 0.01), near=st.floats(10.0, 40.0), ratio=st.floats(1.5, 4.0))
def test_an_offset_alone_is_found_and_no_scale_is_invented(toe: float, near: float, ratio: float) -> None:
    offset = estimate(groups(toe, 1.0, (near, near * ratio)), BASE_M)
    assert offset.toe_rad == pytest.approx(toe, abs=1e-9)
    assert offset.scale == pytest.approx(1.0, abs=1e-6)
    assert not offset.scale_matters


@given(toe=st.floats(-0.005, 0.005), scale=st.sampled_from([0.9, 0.95, 1.06, 1.12]))
def test_a_scale_is_told_apart_from_an_offset_at_several_distances(toe: float, scale: float) -> None:
    offset = estimate(groups(toe, scale, (20.0, 40.0, 80.0)), BASE_M)
    assert offset.scale_matters
    assert offset.scale == pytest.approx(scale, rel=1e-6)
    assert offset.toe_rad * offset.scale == pytest.approx(toe, abs=1e-9)


def test_one_distance_says_nothing_of_the_scale() -> None:
    offset = estimate(groups(0.004, 1.0, (60.0, 70.0)), BASE_M)
    assert math.isinf(offset.scale_sigma)
    assert not offset.scale_matters
    assert offset.toe_rad == pytest.approx(0.004, rel=1e-6)


def test_the_paper_s_board_reads_short_when_the_axes_diverge() -> None:
    """4.478 mrad turn 60 m into 52.8 m."""
    offset = estimate([Group(60.0, 0.1, 52.83, 0.1, 100)], 1.98)
    assert offset.toe_rad * 1e3 == pytest.approx(4.478, abs=0.02)


def test_the_sigma_is_that_of_the_errors() -> None:
    """Over many trials the errors of the estimate have the sigma that it states."""
    rng = np.random.default_rng(3)
    toe, ratios = 0.003, []
    for _ in range(400):
        entries = []
        for z in (30.0, 60.0, 90.0):
            known_m = z + rng.normal(0.0, 0.2)  # the distance that is believed
            samples = read(z, toe) + rng.normal(0.0, 0.006 * z, 60)
            entries.append(group([(known_m, 0.2)] * 60, samples.tolist()))
        offset = estimate(entries, BASE_M)
        ratios.append((offset.toe_rad - toe) / offset.sigma_rad)
    # medians lose a quarter against means; a rms over 400 trials is known to 3.5 %
    assert 0.85 < float(np.std(ratios)) < 1.3


def test_a_group_takes_no_notice_of_a_few_strays() -> None:
    references = [(50.0, 0.1)] * 40
    board = group(references, [50.5] * 36 + [20.0, 180.0, 25.0, 190.0])
    assert board.read_m == pytest.approx(50.5)


# ------------------------------------------------------------------------------------------ what to write


def misread(belief: Airframe, truth: Airframe, distance_m: float, slope_rad: float) -> float:
    """Distance that the believed rig makes of a point straight ahead, seen by the true one."""
    true, believed = Rig.from_airframe(truth), Rig.from_airframe(belief)
    axis = np.array([0.0, 0.0, 1.0]) if belief.orientation == 25 else np.array([1.0, 0.0, 0.0])
    rays, places = [], []
    for side, lift_m in ((Side.LEFT, 0.0), (Side.RIGHT, 0.0)):
        true_pose, pose = true.pose(side, slope_rad, lift_m), believed.pose(side, 0.0, 0.0)
        ray = pose[0].T @ (true_pose[0] @ (axis * distance_m - true_pose[1]))
        rays.append(ray / (ray @ axis))
        places.append(pose[1])
    apart = (places[1] - places[0])[1]
    return float(apart / (rays[0][1] - rays[1][1]))


def test_more_trim_bend_than_believed_is_found_by_a_pair_that_looks_down() -> None:
    airframe = load_airframe("nadir-2m")
    extra_m = 0.0015
    slope = airframe.wing.symmetric.slope_factor_radpm.value * extra_m
    entries = [Group(z, 0.02, misread(airframe, airframe, z, slope), 0.1, 100) for z in (20.0, 60.0)]
    assert entries[1].read_m < 60.0, "up-bend diverges a pair that looks down, and it reads short"
    advice = advise(airframe, estimate(entries, baseline_m(airframe)))
    written = advice.values["wing.trim_bend_m"]["value"]  # type: ignore[index]
    assert written == pytest.approx(airframe.wing.trim_bend_m.value + extra_m, rel=0.02)


def test_a_camera_pair_ahead_that_is_turned_apart_is_written_back_as_it_is() -> None:
    belief = load_airframe("forward-2m")
    left, right = belief.left_camera, belief.right_camera
    assert left is not None
    assert right is not None
    truth = dataclasses.replace(
        belief,
        left_camera=dataclasses.replace(left, rotation_rad=(0.0, -0.002, 0.0)),
        right_camera=dataclasses.replace(right, rotation_rad=(0.0, 0.002, 0.0)),
    )
    entries = [Group(z, 0.02, misread(belief, truth, z, 0.0), 0.1, 100) for z in (20.0, 60.0)]
    advice = advise(belief, estimate(entries, baseline_m(belief)))
    for side, sign in (("left", -1), ("right", 1)):
        turned = advice.values[f"{side}_camera.rotation_rad"]
        assert turned == pytest.approx([0.0, sign * 0.002, 0.0], abs=2e-5)


def test_nothing_is_changed_without_proof() -> None:
    airframe = load_airframe("nadir-2m")
    advice = advise(airframe, Offset(0.0004, 0.0003, 1.0, math.inf, 1.0))
    assert not advice.values
    assert "change nothing" in advice.lines[0]


def test_an_airframe_without_cameras_has_no_baseline() -> None:
    with pytest.raises(ValueError, match="no camera pair"):
        baseline_m(load_airframe("sitl-plane"))
    assert baseline_m(load_airframe("nadir-2m")) == pytest.approx(BASE_M)


def test_a_wrong_trim_sigma_never_comes_out_negative() -> None:
    airframe = dataclasses.replace(load_airframe("nadir-2m"))
    wing = dataclasses.replace(airframe.wing, trim_bend_m=Uncertain(0.02, 0.001))
    advice = advise(dataclasses.replace(airframe, wing=wing), Offset(-0.01, 0.001, 1.0, math.inf, 1.0))
    written = advice.values["wing.trim_bend_m"]
    assert written["value"] == pytest.approx(0.02 - 0.01 / 2.78, abs=1e-4)  # type: ignore[index]
    assert written["sigma"] > 0  # type: ignore[index]


def test_errors_that_a_run_shares_do_not_shrink_with_its_groups() -> None:
    """0.3 mrad of slow error and 0.2 m of known distance, common to 16 groups of one run."""
    rng = np.random.default_rng(4)
    ratios = []
    for _ in range(400):
        slow_rad, off_m, entries = rng.normal(0.0, 0.0003), rng.normal(0.0, 0.2), []
        for z in np.linspace(60.0, 360.0, 16):
            samples = read(z, slow_rad) + rng.normal(0.0, 0.004 * z, 10)
            entries.append(group([(z + off_m, 0.2)] * 10, samples.tolist()))
        offset = estimate(entries, BASE_M, 0.0003, one_run=True)
        ratios.append(offset.toe_rad / offset.sigma_rad)
        assert offset.sigma_rad > 0.0003
    assert 0.85 < float(np.std(ratios)) < 1.3


def test_a_camera_that_shows_less_of_the_tips_slope_needs_more_trim_for_the_same_toe() -> None:
    outboard = load_airframe("nadir-2m")
    cameras = [dataclasses.replace(camera, slope_gain=0.8) for camera in outboard.camera_pair]
    inboard = dataclasses.replace(outboard, left_camera=cameras[0], right_camera=cameras[1])
    offset = Offset(0.002, 0.0002, 1.0, math.inf, 1.0)
    moved = [
        advise(each, offset).values["wing.trim_bend_m"]["value"] - each.wing.trim_bend_m.value  # type: ignore[index]
        for each in (outboard, inboard)
    ]
    assert moved[1] == pytest.approx(moved[0] / 0.8)
