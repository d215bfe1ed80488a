"""The picture between the features: a faint obstacle before a strong background, wherever the bend has rolled it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.adapters.recordings.mcap.ros1_codec import pack, unpack
from companion.core.stereo.filling import filled, levelled
from companion.core.stereo.geometry import MountedCamera, Pose, Rig
from companion.core.stereo.matching import match_pair
from companion.core.stereo.ranging import correct
from companion.core.stereo.rotation import log_rotation
from companion.core.stereo.search import trim_search
from companion.core.stereo.vision import VisionState, vision_step
from companion.params.settings import Settings
from companion.records import ClockName, Frame, FramePair, MatchSet, ParameterChange, Side
from sitl_tests.unit.stereo_cases import bend, forward, match_set, nadir, raw_pixels, wall_ahead
from sitl_tests.unit.stereo_scene import TexturedPlane

SETTINGS = Settings()
AIRFRAME = forward()
RIG = Rig.from_airframe(AIRFRAME)
SEARCH = trim_search(RIG, AIRFRAME, SETTINGS)
SLOPES, LIFT_M = (0.033, 0.027), 0.0149  # a gust: 18.6 mrad of roll beyond the trim that is expected
NEAR_M, FAR_M, FAINT = 15.0, 60.0, 0.3
NEAR = TexturedPlane.facing((1.0, 0.0, 0.0), NEAR_M, 800.0, seed=1)
FAR = TexturedPlane.facing((1.0, 0.0, 0.0), FAR_M, 800.0, seed=2)


def _photograph(camera: MountedCamera, pose: Pose, seed: int) -> np.ndarray:
    """A faint board to the left of the flight's axis, before a background of strong texture."""
    width, height = camera.lens.size_px
    columns, rows = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = camera.rays(pose, np.column_stack([columns.ravel(), rows.ravel()]))
    near, far = (
        pose.position_body_m + rays * ((plane.distance_m - pose.position_body_m[0]) / rays[:, 0])[:, None]
        for plane in (NEAR, FAR)
    )
    grey = 128.0 + 40.0 * np.where(near[:, 1] < 0.0, FAINT * NEAR.shade(near), FAR.shade(far))
    grey += np.random.default_rng(seed).standard_normal(grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8).reshape(height, width)


def _poses() -> tuple[Pose, Pose]:
    return RIG.pose(Side.LEFT, SLOPES[0], LIFT_M), RIG.pose(Side.RIGHT, SLOPES[1], LIFT_M)


@pytest.fixture(scope="module")
def pair() -> FramePair:
    images = [_photograph(RIG.camera(side), _poses()[side], side) for side in Side]
    left, right = (Frame(side, 0, ClockName.HOST, 0, 2_000_000, 0, -1, images[side]) for side in Side)
    return FramePair(5, left, right)


@pytest.fixture(scope="module")
def features(pair: FramePair) -> MatchSet:
    return match_pair(pair, RIG, SEARCH, 0)


@pytest.fixture(scope="module")
def picture(pair: FramePair, features: MatchSet) -> MatchSet:
    return filled(features, pair, RIG, SEARCH)


def test_a_faint_obstacle_that_no_feature_shows_is_in_the_picture(features: MatchSet, picture: MatchSet) -> None:
    """The strongest corners all lie on the background; the board fills the sectors from the left up to straight on."""
    bent = bend(SLOPES, (LIFT_M, 0.0), slope_sigma_rad=0.0001)
    without, with_it = (correct(m, bent, bent, RIG, AIRFRAME, SETTINGS).sectors for m in (features, picture))
    assert without is not None
    assert with_it is not None
    left = [69, 70, 71]  # 5 to 15 degrees to the left
    assert not np.any(without.known[left] & (without.distance_m[left] < 0.5 * FAR_M))
    assert with_it.known[left].all()
    bearing = np.deg2rad(5.0 * (72 - np.array(left)))
    flat = NEAR_M / np.cos(bearing)
    assert np.all(np.abs(with_it.distance_m[left] - flat) < 0.05 * flat)  # a sector is 5 degrees wide
    assert not with_it.known[36]  # nobody looks back


def test_what_fills_the_picture_is_as_right_as_it_says(picture: MatchSet) -> None:
    filled_rows = slice(len(picture.sigma_px) - picture.filled, None)
    assert picture.filled > 15
    left, right = _poses()
    rays = RIG.left.rays(left, picture.left_px[filled_rows])
    candidates = []
    for distance_m in (NEAR_M, FAR_M):
        points = left.position_body_m + rays * ((distance_m - left.position_body_m[0]) / rays[:, 0])[:, None]
        candidates.append(picture.right_px[filled_rows] - RIG.project(Side.RIGHT, right, points))
    error_px = np.where(np.abs(candidates[0][:, :1]) < np.abs(candidates[1][:, :1]), *candidates)[:, 0]
    over = error_px / picture.sigma_px[filled_rows]
    inner = np.abs(over) < 5.0  # patches across the board's edge are of neither surface
    assert inner.mean() > 0.93
    assert 0.6 < np.sqrt(np.mean(over[inner] ** 2)) < 1.4


def test_range_and_rotation_are_taken_from_features_alone(features: MatchSet, picture: MatchSet) -> None:
    bent = bend(SLOPES, (LIFT_M, 0.0), slope_sigma_rad=0.0001)
    feature_range, other = (correct(m, bent, bent, RIG, AIRFRAME, SETTINGS).range for m in (features, picture))
    assert feature_range == other
    assert np.array_equal(picture.features().left_px, features.left_px)
    assert picture.features().filled == 0


def test_features_level_the_rows_though_one_in_ten_is_wrong() -> None:
    """Exact matches of a wall under more bend than is expected, some of them moved by several pixels."""
    points = wall_ahead(40.0, 120, 3)
    left_px, right_px = raw_pixels(RIG, points, SLOPES, (LIFT_M, LIFT_M))
    right_px[::10] += 6.0
    turned = levelled(match_set(left_px, right_px), RIG, SEARCH)
    assert turned is not None
    true, estimated = (right.camera_from_body @ left.camera_from_body.T for left, right in (_poses(), turned))
    off = log_rotation(estimated @ true.T)
    assert np.abs(off[[0, 2]]).max() < 2e-4  # pitch and roll; yaw shows along the rows
    assert levelled(match_set(left_px[:11], right_px[:11]), RIG, SEARCH) is None


def test_without_features_nothing_is_filled(pair: FramePair) -> None:
    few = match_set(np.full((5, 2), 100.0), np.full((5, 2), 90.0))
    assert filled(few, pair, RIG, SEARCH) is few


def test_where_features_are_everywhere_nothing_is_left_to_fill(pair: FramePair) -> None:
    everywhere = np.stack(np.meshgrid(np.arange(10.0, 630.0, 15.0), np.arange(10.0, 470.0, 15.0)), axis=-1).reshape(
        -1, 2
    )
    crowded = match_set(everywhere, everywhere - (40.0, 0.0))
    assert filled(crowded, pair, RIG, SEARCH).filled == 0


def test_a_forward_pair_fills_its_picture_unless_it_is_told_not_to(pair: FramePair) -> None:
    state = VisionState.create(AIRFRAME, SETTINGS)

    def count() -> int:
        state.shown = None  # the same images again
        frames = [dataclasses.replace(f, mid_exposure_ns=state.pairer.next_id * 10**8) for f in (pair.left, pair.right)]
        match_sets = [r for frame in frames for r in vision_step(state, frame, 0) if isinstance(r, MatchSet)]
        return match_sets[0].filled

    assert count() > 15
    vision_step(state, ParameterChange("RNG_DENSE", 0.0, 0), 0)
    assert count() == 0
    below = VisionState.create(nadir(), SETTINGS)
    assert below.match(pair, 0).filled == 0


def test_a_recording_keeps_what_is_filled_and_one_of_before_has_nothing(picture: MatchSet) -> None:
    data = pack(picture)  # at its end the number of what is filled (8 bytes) and an empty flow (a count of 4)
    assert unpack(MatchSet, data).filled == picture.filled
    before = unpack(MatchSet, data[:-12])
    assert before.filled == 0
    assert np.array_equal(before.left_px, picture.left_px)
