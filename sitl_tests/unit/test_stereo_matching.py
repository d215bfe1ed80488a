"""Matching against exactly known image pairs: unbiased to hundredths of a pixel, honest sigma, no false matches."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from companion.core.stereo.geometry import Pose, Rig
from companion.core.stereo.matching import Matches, match, match_pair
from companion.core.stereo.refine import HALF_WINDOW, keys_taps, refine
from companion.core.stereo.search import Search, expected_search, trim_search
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, FramePair, Side
from sitl_tests.unit.stereo_scene import TexturedPlane, photograph

SETTINGS = Settings()
SLOPES = (0.0222, 0.0186)  # near the trim of nadir-2m, with 1.8 mrad of antisymmetric bend


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return load_airframe("nadir-2m")


@pytest.fixture(scope="module")
def rig(airframe: Airframe) -> Rig:
    return Rig.from_airframe(airframe)


def _poses(rig: Rig, slopes: tuple[float, float] = SLOPES) -> tuple[Pose, Pose]:
    return rig.pose(Side.LEFT, slopes[0], 0.0149), rig.pose(Side.RIGHT, slopes[1], 0.0149)


def _pair(
    rig: Rig, poses: tuple[Pose, Pose], plane: TexturedPlane, noise: float = 1.5
) -> tuple[np.ndarray, np.ndarray]:
    left = photograph(plane, rig.left, poses[0], noise_grey=noise, seed=11)
    return left, photograph(plane, rig.right, poses[1], noise_grey=noise, seed=12)


def _errors(rig: Rig, poses: tuple[Pose, Pose], plane: TexturedPlane, matches: Matches) -> np.ndarray:
    """Right pixels found minus right pixels of the plane's points that the left pixels show: (n, 2)."""
    rays = rig.left.rays(poses[0], matches.left_px)
    reach = (plane.distance_m - plane.normal @ poses[0].position_body_m) / (rays @ plane.normal)
    points = poses[0].position_body_m + rays * reach[:, None]
    return matches.right_px - rig.project(Side.RIGHT, poses[1], points)


@pytest.mark.slow
@pytest.mark.parametrize("range_m", [4.3, 12.0, 60.0, 190.0])
def test_matches_are_unbiased_and_their_sigma_is_honest(rig: Rig, airframe: Airframe, range_m: float) -> None:
    plane, poses = TexturedPlane.facing((0, 0, 1), range_m, 800.0, seed=int(range_m)), _poses(rig)
    matches = match(*_pair(rig, poses, plane), rig, trim_search(rig, airframe, SETTINGS))
    errors = _errors(rig, poses, plane, matches)
    assert len(matches) > 60
    assert np.abs(errors).max() < 0.15
    assert abs(errors[:, 0].mean()) < 0.006
    assert 0.6 < np.sqrt(np.mean((errors[:, 0] / matches.sigma_px) ** 2)) < 1.3


class _Facade(TexturedPlane):
    """Windows a metre and a half apart, three metres floor to floor, and hardly anything else."""

    def shade(self, points_m: np.ndarray) -> np.ndarray:
        """Brightness (n,) of points (n, 3): soft edges, and a tenth of the plane's own texture."""
        inside = [
            np.clip((0.3 - np.abs(np.mod(place_m / period_m, 1.0) - 0.5)) / 0.06, -1.0, 1.0)
            for place_m, period_m in zip((points_m @ self.axes().T).T, (3.0, 1.5), strict=True)
        ]
        return 0.1 * super().shade(points_m) - np.minimum(*inside)


@pytest.mark.parametrize("away_m", [80.0, 100.0, 105.0])
def test_windows_at_the_edge_of_an_image_match_no_window_beside(away_m: float) -> None:
    """The place that is as good lies outside of the right image, and one in it repeats it: false obstacles."""
    ahead = load_airframe("forward-2m")
    looking, facade = Rig.from_airframe(ahead), _Facade.facing((1, 0, 0), away_m, 800.0, seed=3, waves=30)
    poses = _poses(looking)
    matches = match(*_pair(looking, poses, facade), looking, trim_search(looking, ahead, SETTINGS))
    assert np.count_nonzero(np.abs(_errors(looking, poses, facade, matches)).max(axis=1, initial=0.0) > 2.0) == 0


@pytest.mark.slow
def test_no_pixel_locking_whatever_the_fraction_of_a_pixel(rig: Rig) -> None:
    """Disparities with fractions 0, 1/4, 1/2, 3/4 px: the mean error hardly follows them, unlike bilinear tracking."""
    poses, errors, bilinear = _poses(rig, (0.0, 0.0)), [], []
    for quarter in range(4):
        range_m = 800.0 * 1.98 / (40.0 + quarter / 4.0)
        plane = TexturedPlane.facing((0, 0, 1), range_m - 0.0149, 800.0, seed=5, waves=40)
        search = expected_search(rig, SETTINGS, (0.0, 0.0), (0.0149, 0.0149), 0.001)
        images = _pair(rig, poses, plane, noise=0.0)
        matches = match(*images, rig, search, most=80)
        errors.append(_errors(rig, poses, plane, matches)[:, 0].mean())
        bilinear.append(_errors(rig, poses, plane, _lucas_kanade(images, matches))[:, 0].mean())
    assert np.ptp(errors) < 0.01
    assert np.ptp(errors) < 0.4 * np.ptp(bilinear)


def test_one_bright_thing_does_not_hide_faint_ground(rig: Rig, airframe: Airframe) -> None:
    poses, rng = _poses(rig), np.random.default_rng(3)
    plane = TexturedPlane.facing((0, 0, 1), 40.0, 800.0, seed=7)
    clear = _pair(rig, poses, plane, noise=0.0)
    faint = [100.0 + 0.13 * (image - image.mean()) + rng.standard_normal(image.shape) for image in clear]
    counts = []
    for glint in (0.0, 140.0):
        faint[0][200:224, 300:324] += glint
        images = [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in faint]
        counts.append(len(match(images[0], images[1], rig, trim_search(rig, airframe, SETTINGS))))
    assert counts[0] > 60
    assert counts[1] > 0.8 * counts[0]


def _lucas_kanade(images: tuple[np.ndarray, np.ndarray], matches: Matches) -> Matches:
    """The same matches refined by OpenCV's bilinear tracker."""
    left = np.rint(matches.left_px).astype(np.float32)
    start = (left + matches.right_px - matches.left_px).astype(np.float32)
    flags, stop = cv2.OPTFLOW_USE_INITIAL_FLOW, (3, 30, 1e-3)
    tracked = cv2.calcOpticalFlowPyrLK(
        *images, left[:, None].copy(), start[:, None].copy(), winSize=(21, 21), maxLevel=0, flags=flags, criteria=stop
    )
    return Matches(left.astype(float), tracked[0][:, 0].astype(float), matches.sigma_px)


@pytest.mark.slow
def test_a_slanted_surface_does_not_bias(rig: Rig, airframe: Airframe) -> None:
    """Ground rolled by 35 degrees: disparity changes by 1.5 px across a patch of 21 px."""
    plane = TexturedPlane.facing((0.0, np.sin(0.6), np.cos(0.6)), 18.0, 800.0, seed=3)
    poses = _poses(rig)
    matches = match(*_pair(rig, poses, plane), rig, trim_search(rig, airframe, SETTINGS))
    errors = _errors(rig, poses, plane, matches)
    assert len(matches) > 60
    assert abs(errors[:, 0].mean()) < 0.01
    assert np.median(np.abs(errors[:, 0])) < 0.03


def _forward(
    airframe: Airframe, slopes: tuple[float, float], normal: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 2) of a forward pair's matches on a plane, and of the same by OpenCV's tracker of rigid patches."""
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    forward = dataclasses.replace(
        airframe,
        left_camera=dataclasses.replace(airframe.left_camera, axes=("y", "z", "x")),
        right_camera=dataclasses.replace(airframe.right_camera, axes=("y", "z", "x")),
    )
    rig = Rig.from_airframe(forward)
    poses = _poses(rig, slopes)
    plane = TexturedPlane.facing(normal, 40.0, 800.0, seed=2)
    images = _pair(rig, poses, plane)
    matches = match(*images, rig, trim_search(rig, forward, SETTINGS))
    assert len(matches) > 100
    rigid = _lucas_kanade(images, matches)
    return _errors(rig, poses, plane, matches), _errors(rig, poses, plane, rigid)


@pytest.mark.slow
def test_a_forward_pair_finds_its_matches_through_roll(airframe: Airframe) -> None:
    errors, _ = _forward(airframe, SLOPES, (1.0, 0.0, 0.0))
    assert np.abs(errors.mean(axis=0)).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("normal", [(1.0, 0.0, 0.0), (0.8, 0.0, 0.6), (0.8, 0.6, 0.0)])
def test_roll_and_slant_hardly_move_a_match_across_the_epipolar_line(
    airframe: Airframe, normal: tuple[float, ...]
) -> None:
    """Trim rolls one image by 41 mrad against the other: 0.4 px from the middle of a patch to its edge.

    Taken for rigid, a patch answers by a displacement that its texture chooses, and that returns in every pair.
    """
    errors, rigid = _forward(airframe, SLOPES, normal)
    assert np.std(errors[:, 1]) < 0.5 * np.std(rigid[:, 1])
    upright, _ = _forward(airframe, (0.0, 0.0), (1.0, 0.0, 0.0))
    assert normal[0] < 1.0 or np.std(errors[:, 1]) < 2.0 * np.std(upright[:, 1])


@pytest.mark.slow
def test_a_gust_s_roll_is_read_from_the_coarse_matches(airframe: Airframe) -> None:
    """A gust rolls by 24 mrad more than trim, which alone is expected."""
    errors, rigid = _forward(airframe, (0.0342, 0.0306), (1.0, 0.0, 0.0))
    assert np.std(errors[:, 1]) < 0.5 * np.std(rigid[:, 1])


@pytest.mark.slow
def test_looking_back_from_a_rolled_image_costs_no_matches(airframe: Airframe) -> None:
    """A pull-up's 100 mrad: the patch that looks back is rolled the other way, or three in four look wrong."""
    rolled, _ = _forward(airframe, (0.05, 0.05), (1.0, 0.0, 0.0))
    upright, _ = _forward(airframe, (0.0, 0.0), (1.0, 0.0, 0.0))
    assert len(rolled) > 0.95 * len(upright)


def _waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Brightness of a texture of waves of 6 to 40 px, anywhere; 25 rms, so that it stays within a byte."""
    random = np.random.default_rng(1)
    number, turn, phase = (random.uniform(low, high, 60) for low, high in ((0.15, 1.0), (0.0, 6.28), (0.0, 6.28)))
    parts = zip(number * np.cos(turn), number * np.sin(turn), phase, strict=True)
    return 128.0 + 4.5 * sum(np.cos(across * x + down * y + start) for across, down, start in parts)


@pytest.mark.parametrize("growth", [(0.0, 0.0), (0.0, 0.05), (0.03, 0.03)])
def test_disparity_that_grows_across_a_patch_moves_no_match_across_the_lines(growth: tuple[float, float]) -> None:
    """No noise, an exact picture: what is left is interpolation, rounding and the shape that the patch was given."""
    y, x = np.mgrid[0:240, 0:320].astype(float)
    left, moved = _waves(x, y), 12.3 + growth[1] * (y - 120.0)
    right = _waves((x + moved - growth[0] * 160.0) / (1.0 - growth[0]), y)
    corners = np.array([(column, row) for column in range(50, 280, 16) for row in range(30, 210, 16)])

    def true_px(seen_px: np.ndarray) -> np.ndarray:
        grown = (seen_px - (160.0, 120.0)) @ growth
        return seen_px - np.column_stack([12.3 + grown, np.zeros(len(seen_px))])

    images = [np.rint(image).astype(np.uint8) for image in (left, right)]
    refined = refine(*images, corners, true_px(corners) + 0.2, np.tile([1.0, 0.0], (len(corners), 1)))
    assert refined.good.mean() > 0.95
    error_px = (refined.right_px - true_px(refined.left_px))[refined.good]
    assert np.sqrt(np.mean(error_px**2, axis=0)).max() < 0.006  # what is stated as the floor of every match's sigma


@pytest.mark.slow
def test_lens_distortion_is_searched_and_matched_through(airframe: Airframe) -> None:
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    bent = dataclasses.replace(
        airframe,
        left_camera=dataclasses.replace(airframe.left_camera, distortion=(-0.25, 0.08, 0.001, -0.0005, 0.0)),
        right_camera=dataclasses.replace(airframe.right_camera, distortion=(-0.22, 0.06, -0.0004, 0.0008, 0.0)),
    )
    rig = Rig.from_airframe(bent)
    plane, poses = TexturedPlane.facing((0, 0, 1), 25.0, 800.0, seed=8), _poses(rig)
    matches = match(*_pair(rig, poses, plane), rig, trim_search(rig, bent, SETTINGS))
    errors = _errors(rig, poses, plane, matches)
    assert len(matches) > 80
    assert np.abs(errors.mean(axis=0)).max() < 0.01


@pytest.mark.slow
def test_exposure_differences_between_the_cameras_do_not_matter(rig: Rig, airframe: Airframe) -> None:
    plane, poses = TexturedPlane.facing((0, 0, 1), 50.0, 800.0, seed=4), _poses(rig)
    left, right = _pair(rig, poses, plane)
    darker = np.clip(np.rint(right * 0.7 + 10.0), 0, 255).astype(np.uint8)
    matches = match(left, darker, rig, trim_search(rig, airframe, SETTINGS))
    assert len(matches) > 100
    assert abs(_errors(rig, poses, plane, matches)[:, 0].mean()) < 0.006


def test_a_repeated_pattern_is_not_matched(rig: Rig, airframe: Airframe) -> None:
    """A grid of equal dots has many equal answers along the epipolar line; none may be given."""
    left = np.full((480, 640), 60, np.uint8)
    for row in range(20, 480, 24):
        for column in range(20, 640, 24):
            left[row - 3 : row + 4, column - 3 : column + 4] = 200
    matches = match(left, np.roll(left, -26, axis=1), rig, trim_search(rig, airframe, SETTINGS))
    assert len(matches) == 0


@pytest.mark.slow
def test_images_of_different_places_give_almost_no_matches(rig: Rig, airframe: Airframe) -> None:
    poses = _poses(rig)
    left = photograph(TexturedPlane.facing((0, 0, 1), 50.0, 800.0, seed=4), rig.left, poses[0])
    right = photograph(TexturedPlane.facing((0, 0, 1), 50.0, 800.0, seed=9), rig.right, poses[1])
    assert len(match(left, right, rig, trim_search(rig, airframe, SETTINGS))) <= 2


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_an_empty_image_has_no_matches(rig: Rig, airframe: Airframe, grey: int) -> None:
    blank = np.full((480, 640), grey, np.uint8)
    assert len(match(blank, blank, rig, trim_search(rig, airframe, SETTINGS))) == 0


@pytest.mark.slow
def test_a_bend_outside_the_stated_tolerance_is_not_forced_into_it(rig: Rig) -> None:
    """Searched at rest from 4 m to 200 m, a pair that converges by 41 mrad shows far ground at -29 px: no match."""
    plane, poses = TexturedPlane.facing((0, 0, 1), 400.0, 800.0, seed=6), _poses(rig, (-0.0205, -0.0205))
    search = expected_search(rig, SETTINGS, (0.0, 0.0), (0.0, 0.0), 0.001)
    assert len(match(*_pair(rig, poses, plane), rig, search)) == 0


@pytest.mark.slow
def test_the_pair_record_carries_ids_and_times(rig: Rig, airframe: Airframe) -> None:
    poses = _poses(rig)
    plane = TexturedPlane.facing((0, 0, 1), 30.0, 800.0, seed=7)
    images = _pair(rig, poses, plane)
    clocks = (ClockName.CAM_LEFT, ClockName.CAM_RIGHT)
    left, right = (
        Frame(side, 5, clock, 1_000_000 + side, 2_000_000, 30_000, 77, image)
        for side, clock, image in zip(Side, clocks, images, strict=True)
    )
    record = match_pair(FramePair(9, left, right), rig, trim_search(rig, airframe, SETTINGS), 123)
    assert (record.pair_id, record.plan_id, record.clocks, record.matched_host_ns) == (9, 77, clocks, 123)
    assert record.mid_exposure_ns.tolist() == [1_000_000, 1_000_001]
    assert (record.exposure_ns, record.row_time_ns) == (2_000_000, 30_000)
    assert record.left_px.shape == record.right_px.shape == (len(record.sigma_px), 2)


def test_search_type_is_what_is_documented(rig: Rig, airframe: Airframe) -> None:
    search = trim_search(rig, airframe, SETTINGS)
    assert isinstance(search, Search)
    relative = search.right.camera_from_body @ search.left.camera_from_body.T
    assert relative[0, 2] == pytest.approx(-2 * 1.39 * 0.0149, abs=1e-4)  # 41 mrad of divergence at trim


def test_six_taps_reproduce_cubics_and_whole_pixels() -> None:
    np.testing.assert_allclose(keys_taps(np.array(0.0)), [0, 0, 1, 0, 0, 0], atol=1e-15)
    nodes = np.arange(-2.0, 4.0)
    for fraction in np.linspace(0.0, 0.99, 12):
        taps = keys_taps(np.array(fraction))
        for power in range(4):
            assert taps @ nodes**power == pytest.approx(fraction**power, abs=1e-12)


def test_a_match_whose_texture_lies_at_the_border_can_be_looked_back_from_or_is_none() -> None:
    """The centre of a patch's texture, which is the match, lies below the patch's own."""
    image = np.full((120, 160), 100, dtype=np.uint8)
    image[104:] = np.random.default_rng(4).integers(0, 255, (16, 160), dtype=np.uint8)
    rows = np.arange(90, 120 - HALF_WINDOW - 2)
    corners = np.stack([np.full(len(rows), 80), rows], axis=1)
    along = np.tile([1.0, 0.0], (len(rows), 1))
    refined = refine(image, image, corners, corners.astype(np.float64), along)
    right_corners = np.rint(refined.right_px[refined.good]).astype(np.int64)
    assert len(right_corners)
    back = refine(image, image, right_corners, right_corners.astype(np.float64), along[: len(right_corners)])
    assert len(back.good) == len(right_corners)
