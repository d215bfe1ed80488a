"""Moving rectification and dense disparity: rows agree for every pose, ranges are right, raw pairs lead back."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.stereo.dense import DenseMatcher, Disparity, _rectified_pairs, metric_pairs, raw_pairs
from companion.core.stereo.geometry import Rig
from companion.core.stereo.ranging import correct
from companion.core.stereo.rectification import Rectification, rectification, rectify, rectify_pair, rest_rectification
from companion.params.settings import Settings
from companion.records import Bytes, Floats, Side
from sitl_tests.unit.stereo_cases import bend, forward, ground_below, match_set, nadir, wall_ahead
from sitl_tests.unit.stereo_scene import TexturedPlane, photograph

LENS = (-0.2, 0.05, 0.001, -0.001, 0.0)
SETTINGS = Settings()
SIGMA_PX = 0.35  # of a disparity (filling.py)
slopes = st.tuples(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06))


def matched(left: Bytes, right: Bytes, rig: Rig, frame: Rectification) -> Disparity:
    return Disparity(frame, DenseMatcher(0, 64).match_rectified(*rectify_pair(frame, rig, left, right)), SIGMA_PX)


def points(dense: Disparity, step_px: int) -> tuple[Floats, Floats]:
    """Points (n, 3) of a grid, body axes, and the one-sigma of their distances (n,), m."""
    frame = dense.frame
    left, right = _rectified_pairs(dense, step_px)
    ahead = left[:, 0] > right[:, 0]
    pixels, disparity = left[ahead], (left - right)[ahead, 0]
    depth = frame.focal_px * frame.baseline_m / disparity
    rays = np.column_stack([(pixels - frame.matrix[:2, 2]) / frame.focal_px, np.ones(len(pixels))])
    at: Floats = frame.left.position_body_m + (rays * depth[:, np.newaxis]) @ frame.rectified_from_body
    stretch = np.linalg.norm(rays, axis=1)
    sigma_px = dense.sigma_px * 2.0**dense.level
    return at, stretch * depth**2 / (frame.focal_px * frame.baseline_m) * sigma_px


@pytest.mark.slow
@given(slopes, st.floats(-0.03, 0.03), st.sampled_from(["nadir", "forward"]))
@settings(max_examples=40, deadline=None)
def test_rectified_rows_agree_and_disparity_gives_depth(slope: tuple[float, float], twist: float, look: str) -> None:
    airframe = nadir(distortion=LENS) if look == "nadir" else forward(distortion=LENS)
    scene = ground_below(30.0, 30, 1) if look == "nadir" else wall_ahead(30.0, 30, 1)
    rig = Rig.from_airframe(airframe)
    left, right = rig.pose(Side.LEFT, slope[0], 0.01, twist), rig.pose(Side.RIGHT, slope[1], -0.02, -twist)
    frame = rectification(rig, left, right)
    seen_left = frame.to_rectified(rig.left, left, rig.project(Side.LEFT, left, scene))
    seen_right = frame.to_rectified(rig.right, right, rig.project(Side.RIGHT, right, scene))
    np.testing.assert_allclose(seen_left[:, 1], seen_right[:, 1], atol=1e-6)
    depth = (scene - left.position_body_m) @ frame.rectified_from_body[2]
    np.testing.assert_allclose(seen_left[:, 0] - seen_right[:, 0], frame.focal_px * frame.baseline_m / depth, atol=1e-6)
    back = frame.to_raw(rig.left, left, seen_left)
    np.testing.assert_allclose(back, rig.project(Side.LEFT, left, scene), atol=1e-6)


def test_the_rigid_rectification_is_opencvs() -> None:
    """Against cv2.stereoRectify for a rig at rest with a small calibrated rotation of one camera."""
    airframe = nadir(distortion=LENS)
    assert airframe.right_camera is not None
    right_camera = dataclasses.replace(airframe.right_camera, rotation_rad=(0.01, -0.02, 0.015))
    rig = Rig.from_airframe(dataclasses.replace(airframe, right_camera=right_camera))
    left, right = rig.left.rest, rig.right.rest
    rotation = right.camera_from_body @ left.camera_from_body.T
    translation = -right.camera_from_body @ (right.position_body_m - left.position_body_m)
    theirs = cv2.stereoRectify(
        rig.left.lens.matrix,
        np.array(LENS),
        rig.right.lens.matrix,
        np.array(LENS),
        (640, 480),
        rotation,
        translation[:, None],
    )[0]
    ours = rest_rectification(rig).rectified_from_camera(left)
    # both turn the baseline onto x; what they choose for the turn about it is half the relative rotation each
    np.testing.assert_allclose(ours[0], theirs[0], atol=1e-9)
    np.testing.assert_allclose(ours, theirs, atol=2e-4)


@pytest.mark.slow
def test_resampled_images_of_a_bent_pair_have_equal_rows() -> None:
    airframe = forward(distortion=LENS)
    rig = Rig.from_airframe(airframe)
    left, right = rig.pose(Side.LEFT, 0.03, 0.0149), rig.pose(Side.RIGHT, 0.02, 0.0149)
    plane = TexturedPlane.facing((1, 0, 0), 30.0, 800.0, seed=3, waves=40)
    images = photograph(plane, rig.left, left), photograph(plane, rig.right, right)
    shift = round(800.0 * 1.98 / 30.0 * 16) / 16
    moving, rigid = rectification(rig, left, right), rest_rectification(rig)
    correlations = []
    for frame in (moving, rigid):
        flat_left = rectify(frame, rig.left, frame.left, images[0])[60:420, 120:560].astype(float)
        flat_right = rectify(frame, rig.right, frame.right, images[1]).astype(np.float32)
        moved = np.float32([[1, 0, shift], [0, 1, 0]])
        flat_right = cv2.warpAffine(flat_right, moved, (640, 480))[60:420, 120:560].astype(float)
        correlations.append(np.corrcoef(flat_left.ravel(), flat_right.ravel())[0, 1])
    assert correlations[0] > 0.97
    assert correlations[1] < 0.5  # 50 mrad of roll is 12 px at the rows away from the middle


@pytest.mark.slow
@pytest.mark.parametrize("range_m", [28.0, 60.0])
def test_dense_ranges_follow_the_bend(range_m: float) -> None:
    airframe = nadir(distortion=LENS)
    rig = Rig.from_airframe(airframe)
    left, right = rig.pose(Side.LEFT, 0.0222, 0.0149), rig.pose(Side.RIGHT, 0.0186, 0.0149)
    plane = TexturedPlane.facing((0, 0, 1), range_m, 800.0, seed=4, waves=60)
    images = (
        photograph(plane, rig.left, left, noise_grey=1.5),
        photograph(plane, rig.right, right, noise_grey=1.5, seed=9),
    )
    frame = rectification(rig, left, right)
    dense = matched(*images, rig, frame)
    assert np.isfinite(dense.disparity_px[:, 100:560]).mean() > 0.8
    at, sigma_m = points(dense, 8)
    errors = (at[:, 2] - range_m) / sigma_m
    assert abs(np.median(at[:, 2]) - range_m) < np.median(sigma_m)
    assert np.mean(np.abs(errors) < 3.0) > 0.95

    pairs = metric_pairs(dense, *images, rig, 16)
    bent = bend((0.0222, 0.0186), (0.0149, 0.0))
    matches = dataclasses.replace(match_set(pairs.left_px, pairs.right_px), sigma_px=pairs.sigma_px)
    answer = correct(matches, bent, bent, rig, airframe, SETTINGS).range
    assert len(pairs) > 200
    assert answer.range_m == pytest.approx(range_m, rel=0.001)


def test_without_texture_there_is_no_disparity() -> None:
    airframe = nadir()
    rig = Rig.from_airframe(airframe)
    blank = np.full((480, 640), 120, np.uint8)
    dense = matched(blank, blank, rig, rest_rectification(rig))
    at, sigma_m = points(dense, 8)
    assert len(at) == len(sigma_m) == len(raw_pairs(dense, rig, 8)[0])
    assert np.isfinite(dense.disparity_px).mean() < 0.02
