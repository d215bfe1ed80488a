"""Ranging: unequal exposures, rolling shutter, tilted ground, wrong matches, products, honest sigma, refusals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.stereo.geometry import Pose, Rig, orientation_axis
from companion.core.stereo.inverse_depth import RangeProduct
from companion.core.stereo.matching import match
from companion.core.stereo.ranging import PairConditions, RangeAnswer, correct
from companion.core.stereo.rotation import exp_rotation
from companion.core.stereo.search import trim_search
from companion.core.stereo.triangulation import range_axis_of_rig
from companion.core.stereo.vehicle_motion import VehicleMotion
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Uncertain
from companion.params.settings import Settings
from companion.records import Deflection, MatchSet, Reject, Side
from sitl_tests.unit.stereo_cases import (
    bend,
    forward,
    ground_below,
    match_set,
    nadir,
    perfect_calibration,
    raw_pixels,
    wall_ahead,
)
from sitl_tests.unit.stereo_scene import TexturedPlane, photograph

SETTINGS = Settings()


def _range(airframe: Airframe, matches: MatchSet, deflection: Deflection, tunables: Settings = SETTINGS) -> RangeAnswer:
    return correct(matches, deflection, deflection, Rig.from_airframe(airframe), airframe, tunables)


@pytest.mark.slow
@given(
    st.floats(5.0, 150.0),
    st.floats(-0.04, 0.06),
    st.floats(-0.02, 0.02),
    st.floats(-0.03, 0.03),
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
)
@settings(max_examples=40, deadline=None)
def test_exact_matches_give_the_exact_range_whatever_bend_and_ground(
    range_m: float, symmetric: float, antisymmetric: float, lift_m: float, tilt: tuple[float, float]
) -> None:
    airframe = nadir(distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
    rig = Rig.from_airframe(airframe)
    slopes = (symmetric - antisymmetric, symmetric + antisymmetric)
    matches = match_set(*raw_pixels(rig, ground_below(range_m, 60, 1, tilt), slopes, (lift_m, lift_m)))
    answer = _range(airframe, matches, bend(slopes, (lift_m, 0.0)))
    assert answer.range.range_m == pytest.approx(range_m, rel=1e-6)
    assert answer.range.rigid_range_m >= 0.0
    assert np.abs(answer.depths.parallax_rad).max() < 1e-9


@pytest.mark.slow
@given(st.floats(5.0, 150.0), st.floats(-0.04, 0.06), st.floats(-0.02, 0.02))
@settings(max_examples=20, deadline=None)
def test_points_come_back_where_they_are(range_m: float, left: float, right: float) -> None:
    airframe = forward()
    rig = Rig.from_airframe(airframe)
    points = wall_ahead(range_m, 40, 2)
    answer = _range(airframe, match_set(*raw_pixels(rig, points, (left, right))), bend((left, right)))
    axis, depths = range_axis_of_rig(rig, orientation_axis(0)), answer.depths
    triangulated = axis.origin_m + (axis.axis + depths.tangent @ axis.across) / depths.inverse_pm[:, np.newaxis]
    np.testing.assert_allclose(triangulated, points, rtol=1e-6, atol=1e-6)


def test_however_many_matches_there_are_what_they_share_stays_in_the_sigma() -> None:
    """A fiftieth of a pixel is common to all: Z^2 / (f B) of it, 45 mm at 60 m, where chance alone would leave 2 mm."""
    airframe = nadir(**perfect_calibration())
    matches = match_set(
        *raw_pixels(Rig.from_airframe(airframe), ground_below(60.0, 3000, 7), (0.02, 0.02)), sigma_px=0.05
    )
    answer = _range(airframe, matches, bend((0.02, 0.02)))
    assert answer.match_sigma_m == pytest.approx(60.0**2 / (800.0 * 1.98) * 0.02, rel=0.02)
    assert answer.range.sigma_m == pytest.approx(answer.match_sigma_m, rel=1e-6)


def test_twist_is_taken_from_the_modal_coordinates() -> None:
    airframe = forward()
    twisting = dataclasses.replace(airframe.wing.symmetric, twist_factor_radpm=Uncertain(0.8, 0.0))
    rolling = dataclasses.replace(airframe.wing.antisymmetric, twist_factor_radpm=Uncertain(-0.5, 0.0))
    airframe = dataclasses.replace(
        airframe, wing=dataclasses.replace(airframe.wing, symmetric=twisting, antisymmetric=rolling)
    )
    rig, q, points = Rig.from_airframe(airframe), (0.015, 0.004), wall_ahead(60.0, 60, 3)
    lift = (q[0] - q[1], q[0] + q[1])
    twist = (0.8 * q[0] + 0.5 * q[1], 0.8 * q[0] - 0.5 * q[1])
    pixels = [rig.project(side, rig.pose(side, 0.02, lift[side], twist[side]), points) for side in Side]
    answer = _range(airframe, match_set(*pixels), bend((0.02, 0.02), q))
    assert answer.range.range_m == pytest.approx(60.0, rel=1e-6)
    assert np.abs(answer.depths.parallax_rad).max() < 1e-9


def test_unequal_exposures_are_bridged_with_the_body_rate() -> None:
    """1 ms at 0.5 rad/s of roll is 0.5 mrad: 0.9 m at 60 m if it were left out."""
    airframe = nadir()
    rig, points = Rig.from_airframe(airframe), ground_below(60.0, 200, 4)
    rate = np.array([0.5, 0.2, -0.3])
    half_s = 0.0005
    pixels = []
    for side, after_s in zip(Side, (-half_s, half_s), strict=True):
        turned = exp_rotation(rate * after_s)  # body axes of that instant, in those of the middle
        pixels.append(rig.project(side, rig.pose(side, 0.02, 0.0), points @ turned))
    matches = match_set(*pixels, mid_exposure_ns=(-500_000, 500_000))
    moving = [bend((0.02, 0.02), t_ns=t, rate_radps=(0.5, 0.2, -0.3)) for t in (-500_000, 500_000)]
    still = [bend((0.02, 0.02), t_ns=t) for t in (-500_000, 500_000)]
    bridged = correct(matches, *moving, rig, airframe, SETTINGS)
    ignored = correct(matches, *still, rig, airframe, SETTINGS)
    assert bridged.range.range_m == pytest.approx(60.0, abs=0.002)
    assert abs(ignored.range.range_m - 60.0) == pytest.approx(3600.0 / 1.98 * 0.0005, rel=0.05)
    assert bridged.range.t_host_ns == 0


def test_flight_between_unequal_exposures_is_bridged_with_the_velocity() -> None:
    """5 ms at 20 m/s ahead and 2 m/s to the right: 10 cm across the baseline, 1 cm along it."""
    airframe = nadir()
    rig, points = Rig.from_airframe(airframe), ground_below(60.0, 200, 4)
    velocity = np.array([20.0, 2.0, 0.0])
    ahead = [points - velocity * after_s for after_s in (-0.0025, 0.0025)]
    pixels = [rig.project(side, rig.pose(side, 0.02, 0.0), ahead[side]) for side in Side]
    left, right = bend((0.02, 0.02), t_ns=-2_500_000), bend((0.02, 0.02), t_ns=2_500_000)
    bridged = correct(
        match_set(*pixels),
        left,
        right,
        rig,
        airframe,
        SETTINGS,
        PairConditions(motion=VehicleMotion(velocity, np.zeros((3, 3)))),
    )
    ignored = correct(match_set(*pixels), left, right, rig, airframe, SETTINGS)
    assert bridged.range.range_m == pytest.approx(60.0, abs=1e-5)
    assert ignored.range.range_m == pytest.approx(60.0 * 1.98 / 1.99, abs=0.02)
    assert np.abs(bridged.depths.parallax_rad).max() < 1e-9


def test_a_crosswind_that_nobody_tells_is_in_the_sigma() -> None:
    """5 ms at 3 m/s along the baseline are 15 mm of 1.98 m: 0.45 m of 60 m."""
    airframe = nadir(**perfect_calibration())
    rig, points = Rig.from_airframe(airframe), ground_below(60.0, 200, 4)
    matches = match_set(*raw_pixels(rig, points, (0.02, 0.02)), 0.001)
    left, right = bend((0.02, 0.02), t_ns=-2_500_000), bend((0.02, 0.02), t_ns=2_500_000)
    still, blown = (
        correct(
            matches, left, right, rig, airframe, SETTINGS, PairConditions(motion=VehicleMotion(np.zeros(3), covariance))
        ).range
        for covariance in (np.zeros((3, 3)), np.diag([0.0, 3.0, 0.0]) ** 2)
    )
    assert np.sqrt(blown.sigma_m**2 - still.sigma_m**2) == pytest.approx(60.0 * 0.015 / 1.98, rel=0.01)


def _foot_of_a_wall(wall_m: float, height_m: float, edge_m: float, seed: int) -> np.ndarray:
    """A wall across the path to the right of ``edge_m``, ground below it; points as the picture shows them."""
    rng = np.random.default_rng(seed)
    y, z = rng.uniform(-0.3, 0.3, 240), rng.uniform(-0.27, 0.27, 240)
    ground_m = np.where(z > 0.0, height_m / np.maximum(z, 1e-9), np.inf)
    depth_m = np.where(y * wall_m > edge_m, np.minimum(wall_m, ground_m), ground_m)
    points = np.column_stack([np.ones(240), y, z]) * depth_m[:, np.newaxis]
    return np.asarray(points[np.isfinite(depth_m)])


@pytest.mark.parametrize("height_m", [2.0, 3.0, 4.0, 8.0])
def test_a_wall_ahead_is_ranged_over_the_ground_before_it(height_m: float) -> None:
    """A third of the picture or more is ground nearer than the wall: a plane through both lies 20 to 30 % too near."""
    airframe = forward(**perfect_calibration())
    rig = Rig.from_airframe(airframe)
    for seed in range(5):
        pixels = raw_pixels(rig, _foot_of_a_wall(30.0, height_m, -100.0, seed), (0.02, 0.02))
        noise = 0.1 * np.random.default_rng(seed).standard_normal(pixels[1].shape)
        answer = _range(airframe, match_set(pixels[0], pixels[1] + noise), bend((0.02, 0.02))).range
        assert answer.range_m == pytest.approx(30.0, abs=4.0 * answer.sigma_m)
        assert answer.trusted


def test_a_range_with_an_edge_on_its_axis_is_one_of_both_or_not_trusted() -> None:
    """A wall's edge on the axis, a second wall at twice the distance beside it."""
    airframe = forward(**perfect_calibration())
    rig = Rig.from_airframe(airframe)
    for seed in range(20):
        points = wall_ahead(30.0, 200, seed)
        far = points[:, 1] < 0.0
        points[far] *= 2.0
        pixels = raw_pixels(rig, points, (0.02, 0.02))
        noise = 0.1 * np.random.default_rng(seed).standard_normal(pixels[1].shape)
        answer = _range(airframe, match_set(pixels[0], pixels[1] + noise), bend((0.02, 0.02))).range
        assert not answer.trusted or min(abs(answer.range_m - 30.0), abs(answer.range_m - 60.0)) < 5.0 * answer.sigma_m


def test_each_camera_is_corrected_with_the_bend_of_its_own_exposure() -> None:
    airframe = nadir()
    rig, points = Rig.from_airframe(airframe), ground_below(60.0, 200, 5)
    left, right = bend((0.020, 0.020), t_ns=0), bend((0.023, 0.023), t_ns=3_000_000)
    matches = match_set(*raw_pixels(rig, points, (0.020, 0.023)), mid_exposure_ns=(0, 3_000_000))
    assert correct(matches, left, right, rig, airframe, SETTINGS).range.range_m == pytest.approx(60.0, rel=1e-6)
    assert correct(matches, left, left, rig, airframe, SETTINGS).range.range_m != pytest.approx(60.0, abs=3.0)


@pytest.mark.slow
def test_rolling_shutter_rows_are_corrected_one_by_one() -> None:
    """30 us per row, body rates and a wing passing zero at full speed: every row has a bend of its own."""
    airframe = nadir()
    rig, points = Rig.from_airframe(airframe), ground_below(40.0, 200, 6)
    row_time_s, qdot, rate = 30e-6, 0.16, np.array([0.3, 0.1, 0.2])
    pixels = [_rolling(rig, side, points, row_time_s, 1.39 * qdot, rate) for side in Side]
    deflection = bend(qdot_mps=(qdot, 0.0), rate_radps=(0.3, 0.1, 0.2))
    row_wise = _range(airframe, match_set(*pixels, row_time_ns=30_000), deflection)
    as_global = _range(airframe, match_set(*pixels), deflection)
    scatter = [np.std(answer.depths.inverse_pm) * 40.0**2 for answer in (row_wise, as_global)]
    assert row_wise.range.range_m == pytest.approx(40.0, abs=0.005)
    assert scatter[0] < 0.02 < 0.3 < scatter[1]


def _rolling(
    rig: Rig, side: Side, points: np.ndarray, row_time_s: float, slope_rate: float, rate: np.ndarray
) -> np.ndarray:
    """Pixels seen by a rolling shutter: the row's own time decides the pose, found by iteration."""
    pixels = rig.project(side, rig.camera(side).rest, points)
    for _ in range(6):
        rows = pixels[:, 1].copy()
        for i, row in enumerate(rows):
            t = row_time_s * (row - 239.5)
            pose = rig.pose(side, slope_rate * t, 0.0)
            body = exp_rotation(rate * t)
            pixels[i] = rig.project(side, Pose(pose.camera_from_body @ body.T, body @ pose.position_body_m), points[i])
    return pixels


def test_wrong_matches_do_not_pull_the_range() -> None:
    airframe = nadir()
    rig = Rig.from_airframe(airframe)
    left, right = raw_pixels(rig, ground_below(60.0, 100, 7), (0.02, 0.02))
    random = np.random.default_rng(8)
    right = right + random.normal(scale=0.1, size=right.shape)
    right[:30, 0] += random.uniform(3.0, 60.0, 30)
    answer = _range(airframe, match_set(left, right, 0.1), bend((0.02, 0.02)))
    assert answer.range.range_m == pytest.approx(60.0, abs=0.12)
    assert answer.range.matches <= 75


def test_matches_off_the_epipolar_line_are_dropped() -> None:
    airframe = nadir()
    rig = Rig.from_airframe(airframe)
    left, right = raw_pixels(rig, ground_below(60.0, 100, 9), (0.02, 0.02))
    right = right + np.random.default_rng(1).normal(scale=0.05, size=right.shape)
    right[:60] += [6.0, 4.0]  # a moving shadow: agrees with itself, though not with the geometry of the rest
    right[:20, 1] += np.linspace(-20.0, 20.0, 20)
    answer = _range(airframe, match_set(left[40:], right[40:], 0.05), bend((0.02, 0.02)))
    assert answer.range.range_m == pytest.approx(60.0, abs=0.1)


@pytest.mark.slow
def test_sigma_is_honest_against_noise_bend_and_calibration_together() -> None:
    """Truth drawn from the stated sigmas; the normalised squared error of 300 draws is that of a Gaussian."""
    airframe = nadir(rotation_sigma_rad=2e-4, focal_px=Uncertain(800.0, 0.4))
    random, squares = np.random.default_rng(10), []
    for draw in range(300):
        slopes = 0.02 + 1.5e-4 * random.normal(size=2)
        true = _perturbed(airframe, random)
        left, right = raw_pixels(Rig.from_airframe(true), ground_below(60.0, 80, draw), (slopes[0], slopes[1]))
        right = right + 0.1 * random.normal(size=right.shape)
        answer = _range(airframe, match_set(left, right, 0.1), bend((0.02, 0.02), slope_sigma_rad=1.5e-4)).range
        squares.append(((answer.range_m - 60.0) / answer.sigma_m) ** 2)
    assert 0.8 < np.mean(squares) < 1.2  # 300 draws: 0.92 to 1.08 one sigma


def _perturbed(airframe: Airframe, random: np.random.Generator) -> Airframe:
    cameras = []
    for camera in (airframe.left_camera, airframe.right_camera):
        assert camera is not None
        turn = camera.rotation_sigma_rad * random.normal(size=3)
        focal = Uncertain(camera.focal_px.value + camera.focal_px.sigma * random.normal(), 0.0)
        cameras.append(dataclasses.replace(camera, rotation_rad=tuple(turn), focal_px=focal))
    return dataclasses.replace(airframe, left_camera=cameras[0], right_camera=cameras[1])


def test_products_differ_where_the_scene_does() -> None:
    """Ground at 60 m, a mast top of 30 matches at 35 m to the side, a roof of 25 matches on the axis at 50 m."""
    airframe = nadir()
    rig, random = Rig.from_airframe(airframe), np.random.default_rng(12)
    mast = np.column_stack([random.uniform(6, 8, 30), random.uniform(6, 8, 30), np.full(30, 35.0)])
    roof = np.column_stack([random.uniform(-2, 2, 25), random.uniform(-2, 2, 25), np.full(25, 50.0)])
    ground = ground_below(60.0, 150, 13)
    ground = ground[np.linalg.norm(ground[:, :2], axis=1) > 5.0]
    left, right = raw_pixels(rig, np.vstack([mast, roof, ground]), (0.02, 0.02))
    right = right + 0.05 * random.normal(size=right.shape)
    for product, expected in ((0, 50.0), (1, 35.0), (2, 50.0)):
        tunables = dataclasses.replace(SETTINGS, product=product)
        answer = _range(airframe, match_set(left, right, 0.05), bend((0.02, 0.02)), tunables)
        assert answer.range.range_m == pytest.approx(expected, rel=0.01), product


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.15, -0.1)])
@pytest.mark.parametrize("product", [0, 1, 2])
def test_the_sigma_of_every_product_is_honest(product: int, tilt: tuple[float, float]) -> None:
    """Against the range on the axis; the nearest thing is the nearest that four matches show, and errs to be near."""
    airframe = nadir(rotation_sigma_rad=2e-5, focal_px=Uncertain(800.0, 0.04))
    random, scores = np.random.default_rng(10), []
    for draw in range(80):
        slopes = 0.02 + 1.5e-5 * random.normal(size=2)
        points = ground_below(60.0, 80, draw, tilt=tilt)
        left, right = raw_pixels(Rig.from_airframe(_perturbed(airframe, random)), points, (slopes[0], slopes[1]))
        matches = match_set(left, right + 0.1 * random.normal(size=right.shape), 0.1)
        tunables = dataclasses.replace(SETTINGS, product=product)
        answer = _range(airframe, matches, bend((0.02, 0.02), slope_sigma_rad=1.5e-5), tunables).range
        true_m = float(np.sort(points[:, 2])[3]) if product == 1 else 60.0
        scores.append((answer.range_m - true_m) / answer.sigma_m)
    if product == 1:
        assert np.mean(scores) < 0.2
        assert np.sqrt(np.mean(np.square(scores))) < 2.0
        assert np.percentile(scores, 95) < 3.0
    else:
        assert 0.6 < np.mean(np.square(scores)) < 1.5  # 80 draws: 0.84 to 1.16 one sigma


@pytest.mark.parametrize("count", [0, 1, 2, 11])
def test_too_few_matches_are_refused_with_finite_numbers(count: int) -> None:
    airframe = nadir()
    matches = match_set(*raw_pixels(Rig.from_airframe(airframe), ground_below(60.0, count, 14), (0.0, 0.0)))
    answer = _range(airframe, matches, bend()).range
    assert (answer.trusted, answer.reject, answer.matches) == (False, Reject.NO_MATCHES, count)
    assert np.isfinite([answer.range_m, answer.sigma_m, answer.toe_rad, answer.toe_sigma_rad]).all()


@pytest.mark.parametrize("count", [20, 40])
def test_a_fit_to_few_of_many_matches_has_some_to_spare(count: int) -> None:
    """The matches nearest to the axis, of which one has no weight: a sixth of such ranges had too few by that one."""
    airframe = nadir(**perfect_calibration())
    rig, tunables = Rig.from_airframe(airframe), SETTINGS.replace("RNG_PRODUCT", float(RangeProduct.CENTRE))
    for seed in range(20):
        pixels = raw_pixels(rig, ground_below(60.0, count, seed), (0.0, 0.0))
        noise = 0.05 * np.random.default_rng(seed).standard_normal(pixels[1].shape)
        assert _range(airframe, match_set(pixels[0], pixels[1] + noise), bend(), tunables).range.trusted


@pytest.mark.parametrize("count", [4, 11])
def test_too_few_matches_for_a_range_still_tell_an_obstacle(count: int) -> None:
    """A mast before bare sky."""
    airframe, rng = forward(**perfect_calibration()), np.random.default_rng(6)
    points = np.column_stack([np.full(count, 60.0), rng.uniform(-1.0, 1.0, count), rng.uniform(-4.0, 2.0, count)])
    answer = _range(airframe, match_set(*raw_pixels(Rig.from_airframe(airframe), points, (0.0, 0.0))), bend())
    assert answer.range.reject is Reject.NO_MATCHES
    assert answer.sectors is not None
    assert answer.sectors.distance_m[0] == pytest.approx(60.0, rel=0.02)


@pytest.mark.parametrize("range_m", [3.6, 230.0, -80.0])
def test_ranges_outside_the_limits_are_refused(range_m: float) -> None:
    airframe = nadir(rotation_sigma_rad=0.0)
    rig = Rig.from_airframe(airframe)
    far = raw_pixels(rig, ground_below(abs(range_m), 60, 15), (0.0, 0.0))
    pixels = far if range_m > 0 else far[::-1]  # swapped images: rays that meet behind the cameras
    answer = _range(airframe, match_set(*pixels, 0.01), bend()).range
    assert (answer.trusted, answer.reject) == (False, Reject.OUT_OF_RANGE)
    assert np.isfinite(answer.range_m)
    assert np.isfinite(answer.sigma_m)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.floats(0.0, 3000.0), st.sampled_from([0, 1, 2]))
@settings(max_examples=60, deadline=None)
def test_whatever_the_pixels_nothing_but_finite_numbers_comes_out(
    seed: int, count: int, spread_px: float, product: int
) -> None:
    random = np.random.default_rng(seed)
    left, right = (320.0 + spread_px * random.normal(size=(2, count, 2))).round(1)
    airframe, tunables = nadir(), dataclasses.replace(SETTINGS, product=product, min_matches=4)
    answer = _range(airframe, match_set(left, right), bend((0.02, -0.03)), tunables).range
    numbers = [answer.range_m, answer.sigma_m, answer.toe_rad, answer.toe_sigma_rad, answer.rigid_range_m]
    assert np.isfinite(numbers).all()
    assert answer.trusted is (answer.reject is None)


def test_a_bend_that_is_not_a_number_is_refused() -> None:
    airframe = nadir()
    matches = match_set(*raw_pixels(Rig.from_airframe(airframe), ground_below(60.0, 50, 1), (0.0, 0.0)))
    answer = _range(airframe, matches, bend(slope_sigma_rad=float("nan"))).range
    assert (answer.trusted, answer.reject, answer.range_m) == (False, Reject.NOT_FINITE, 0.0)


def test_trust_ends_where_sigma_exceeds_its_share_of_the_range() -> None:
    """3 % of 60 m is 1.8 m, or 0.99 mrad of toe."""
    airframe = nadir(rotation_sigma_rad=0.0)
    matches = match_set(*raw_pixels(Rig.from_airframe(airframe), ground_below(60.0, 300, 16), (0.0, 0.0)), 0.05)
    for toe_sigma, trusted in ((0.9e-3, True), (1.1e-3, False)):
        answer = _range(airframe, matches, bend(slope_sigma_rad=toe_sigma / np.sqrt(2.0))).range
        assert answer.trusted is trusted
        assert answer.reject is (None if trusted else Reject.SIGMA_TOO_LARGE)


def test_ids_and_orientation_travel_with_the_range() -> None:
    airframe = nadir()
    matches = match_set(*raw_pixels(Rig.from_airframe(airframe), ground_below(30.0, 50, 17), (0.0, 0.0)))
    answer = _range(airframe, matches, bend(t_ns=5_000))
    assert (answer.range.pair_id, answer.range.plan_id, answer.range.orientation) == (3, 8, 25)
    assert answer.range.t_host_ns == 5_000
    assert answer.sectors is None


def test_an_orientation_between_the_axes_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError, match="orientation 1"):
        orientation_axis(1)
    np.testing.assert_array_equal(orientation_axis(25), [0, 0, 1])
    np.testing.assert_array_equal(orientation_axis(6), [0, -1, 0])


@pytest.mark.slow
@pytest.mark.parametrize("range_m", [20.0, 60.0, 100.0])
def test_from_images_to_range_with_the_true_bend(range_m: float) -> None:
    """The oracle: noisy images of tilted ground, true extrinsics. The demo's target is 0.15 m median at 60 m."""
    airframe = nadir(distortion=(-0.1, 0.02, 0.0005, -0.0005, 0.0))
    rig, slopes = Rig.from_airframe(airframe), (0.0222, 0.0186)
    poses = rig.pose(Side.LEFT, slopes[0], 0.0149), rig.pose(Side.RIGHT, slopes[1], 0.0149)
    normal = np.array([0.1, -0.15, 1.0])
    plane = TexturedPlane.facing((0.1, -0.15, 1.0), range_m / np.linalg.norm(normal), 800.0, seed=int(range_m))
    images = [photograph(plane, rig.camera(side), poses[side], noise_grey=2.0, seed=side) for side in Side]
    matches = match(images[0], images[1], rig, trim_search(rig, airframe, SETTINGS))
    record = dataclasses.replace(match_set(matches.left_px, matches.right_px), sigma_px=matches.sigma_px)
    answer = _range(airframe, record, bend(slopes, (0.0149, 0.0)))
    assert answer.range.range_m == pytest.approx(range_m, abs=range_m**2 / 1584.0 * 0.03)  # 0.03 px: 0.07 m at 60 m
    assert abs(answer.range.range_m - range_m) < 3.0 * answer.match_sigma_m
    assert answer.range.trusted
    toe_rad = slopes[0] + slopes[1]
    assert answer.range.rigid_range_m == pytest.approx(1.0 / (1.0 / range_m + toe_rad / 1.98), rel=0.05)
