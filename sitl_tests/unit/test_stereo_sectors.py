"""Sectors: bearing convention, nearest obstacle, unknown against clear, support and trust."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.stereo.geometry import Rig
from companion.core.stereo.ranging import PairConditions, correct
from companion.core.stereo.sectors import SECTORS, matched_sectors, sectors_of
from companion.core.stereo.triangulation import Depths, RangeAxis
from companion.params.settings import Settings
from companion.records import ObstacleSectors
from sitl_tests.unit.stereo_cases import bend, forward, match_set, raw_pixels, wall_ahead

SETTINGS = Settings()


def _sectors(points: np.ndarray, relative_sigma: float = 0.01) -> ObstacleSectors:
    """Sectors of points given directly, with depth counted along body x where possible."""
    depth = np.linalg.norm(points, axis=1)
    inverse = 1.0 / depth
    return sectors_of(points * inverse[:, None], inverse, relative_sigma * inverse, np.zeros(3), 77, SETTINGS)


def _at(bearing_deg: float, distance_m: float, down_m: float = 0.0, count: int = 3) -> np.ndarray:
    bearing = np.radians(bearing_deg)
    return np.tile([distance_m * np.cos(bearing), distance_m * np.sin(bearing), down_m], (count, 1))


@settings(deadline=None)
@given(st.integers(0, SECTORS - 1), st.floats(-2.4, 2.4), st.floats(5.0, 190.0))
def test_a_sector_is_centred_on_its_multiple_of_five_degrees_clockwise(
    index: int, off_deg: float, distance_m: float
) -> None:
    sectors = _sectors(_at(5.0 * index + off_deg, distance_m))
    assert np.flatnonzero(sectors.known).tolist() == [index]
    assert sectors.distance_m[index] == pytest.approx(distance_m)
    assert not sectors.clear.any()


def test_right_is_clockwise() -> None:
    assert np.flatnonzero(_sectors(_at(90.0, 20.0)).known).tolist() == [18]  # body +y, the right wing
    assert np.flatnonzero(_sectors(_at(-10.0, 20.0)).known).tolist() == [70]


def test_the_nearest_supported_distance_wins() -> None:
    scene = np.vstack([_at(0.0, 80.0, count=20), _at(0.5, 30.0), _at(-0.5, 12.0, count=1)])
    sectors = _sectors(scene)
    assert sectors.distance_m[0] == pytest.approx(30.0)  # one lonely match at 12 m is no obstacle
    assert 0.0 < sectors.sigma_m[0] < 1.0


def test_what_all_matches_share_is_larger_towards_the_edges() -> None:
    """A toe moves a ray of slope x by ``1 + x^2``; in the middle the sigma is the range's own."""
    x, inverse_pm, common_pm = np.repeat([0.0, 0.4], 3), 1.0 / 40.0, 1e-5
    tangent = np.column_stack([x, np.zeros(6)])
    depths = Depths(np.full(6, inverse_pm), np.full(6, 1e-9), tangent, np.zeros(6), np.zeros(6))
    forwards = RangeAxis(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.eye(3)[1:])
    sectors = matched_sectors(depths, forwards, common_pm, 77, SETTINGS)
    assert sectors is not None
    assert np.flatnonzero(sectors.known).tolist() == [0, 4]
    relative = sectors.sigma_m[[0, 4]] / sectors.distance_m[[0, 4]] * inverse_pm / common_pm
    assert relative == pytest.approx([1.0, 1.16], rel=1e-6)


def test_what_is_above_or_below_the_height_band_is_no_obstacle() -> None:
    sectors = _sectors(np.vstack([_at(0.0, 60.0, down_m=20.0), _at(10.0, 60.0, down_m=-20.0), _at(20.0, 60.0)]))
    assert np.flatnonzero(sectors.known).tolist() == [4]
    assert not sectors.clear.any()


def test_only_texture_seen_beyond_the_largest_range_makes_clear() -> None:
    far = np.vstack([_at(0.0, 900.0), _at(15.0, 900.0, count=2), _at(30.0, 900.0, down_m=300.0)])
    near = _at(45.0, 50.0)
    beyond_and_near = np.vstack([_at(60.0, 900.0), _at(60.0, 70.0)])
    sectors = _sectors(np.vstack([far, near, beyond_and_near]))
    assert np.flatnonzero(sectors.clear).tolist() == [0]  # not: too few, looking down, nothing but near, something near
    assert np.flatnonzero(sectors.known).tolist() == [9, 12]
    assert sectors.clear[SECTORS // 2] == sectors.known[SECTORS // 2] == False  # noqa: E712 (behind: never looked)


def test_rays_that_part_ahead_of_the_cameras_clear_nothing() -> None:
    directions = _at(0.0, 1.0)
    sectors = sectors_of(directions, np.full(3, -0.05), np.full(3, 5e-4), np.zeros(3), 77, SETTINGS)
    assert not sectors.clear.any()


def test_far_texture_that_may_be_nearer_does_not_clear() -> None:
    assert _sectors(_at(0.0, 260.0), relative_sigma=0.02).clear[0]
    assert not _sectors(_at(0.0, 260.0), relative_sigma=0.4).clear.any()


def test_an_uncertain_obstacle_is_unknown_and_never_clear() -> None:
    """A distance with more sigma than the trust ratio is not published, but it forbids to call the sector clear."""
    vague = _at(0.0, 120.0)
    points = np.vstack([vague, _at(0.0, 900.0)])
    inverse = 1.0 / np.linalg.norm(points, axis=1)
    sigma = inverse * np.array([0.08] * 3 + [0.01] * 3)
    sectors = sectors_of(points * inverse[:, None], inverse, sigma, np.zeros(3), 0, SETTINGS)
    assert not sectors.known.any()
    assert not sectors.clear.any()


def test_no_points_no_knowledge() -> None:
    sectors = _sectors(np.empty((0, 3)))
    assert not sectors.known.any()
    assert not sectors.clear.any()
    assert (sectors.min_m, sectors.max_m, sectors.t_host_ns) == (SETTINGS.min_range_m, SETTINGS.max_range_m, 77)


def test_a_forward_pair_gives_sectors_with_its_range() -> None:
    """A post at bearing +10 degrees and 40 m, open land behind it and to the left: bent wing, noisy matches."""
    airframe = forward(rotation_sigma_rad=2e-5)
    rig, random = Rig.from_airframe(airframe), np.random.default_rng(3)
    bearing = np.radians(10.0 + random.uniform(-1.5, 1.5, 25))
    post = np.column_stack([40.0 * np.cos(bearing), 40.0 * np.sin(bearing), random.uniform(-4, 4, 25)])
    side = np.radians(random.uniform(-17.0, 17.0, 160))
    land = np.column_stack([3000.0 * np.cos(side), 3000.0 * np.sin(side), random.uniform(-100, 100, 160)])
    left, right = raw_pixels(rig, np.vstack([post, land]), (0.02, 0.024))
    right = right + 0.05 * random.normal(size=right.shape)
    deflection = bend((0.02, 0.024), slope_sigma_rad=1e-4)
    sectors = correct(match_set(left, right, 0.05), deflection, deflection, rig, airframe, SETTINGS).sectors
    assert sectors is not None
    assert np.flatnonzero(sectors.known).tolist() == [2]
    assert sectors.distance_m[2] == pytest.approx(40.0, abs=4.0 * sectors.sigma_m[2])
    assert sectors.clear[[70, 71, 0, 1]].all()
    assert not sectors.clear[5:67].any()


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0.0, 0.0), (30.0, 0.0), (-25.0, 8.0), (0.0, -12.0)])
def test_in_a_bank_posts_stay_at_their_bearing_and_the_ground_stays_below(roll_deg: float, pitch_deg: float) -> None:
    """Posts at the aircraft's own height in the world, and the ground 30 m below, seen from a banked aircraft."""
    airframe = forward(rotation_sigma_rad=2e-5)
    rig, random = Rig.from_airframe(airframe), np.random.default_rng(5)
    roll, pitch = np.radians(roll_deg), np.radians(pitch_deg)
    bearing = np.radians(10.0 + random.uniform(-1.0, 1.0, 40))
    post = np.column_stack([40.0 * np.cos(bearing), 40.0 * np.sin(bearing), random.uniform(-3, 3, 40)])
    ahead = random.uniform(60.0, 150.0, 300)
    ground = np.column_stack([ahead, ahead * random.uniform(-0.3, 0.3, 300), np.full(300, 30.0)])
    # world to body: pitch about y, then roll about x, written out again from the definition of the angles
    about_y = np.array([[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), np.sin(roll)], [0, -np.sin(roll), np.cos(roll)]])
    points = np.vstack([post, ground]) @ (about_x @ about_y).T
    left, right = raw_pixels(rig, points, (0.02, 0.024))
    inside = np.all((left > 0) & (left < (640, 480)) & (right > 0) & (right < (640, 480)), axis=1)
    matches = match_set(left[inside], right[inside] + 0.02 * random.normal(size=right[inside].shape), 0.02)
    deflection = bend((0.02, 0.024), slope_sigma_rad=2e-5)
    levelled = correct(
        matches, deflection, deflection, rig, airframe, SETTINGS, PairConditions(attitude_rad=(roll, pitch))
    ).sectors
    assert levelled is not None
    assert np.flatnonzero(levelled.known).tolist() == [2]
    assert levelled.distance_m[2] == pytest.approx(40.0, abs=4.0 * levelled.sigma_m[2])
    if abs(pitch_deg) > 10.0:
        by_body = correct(matches, deflection, deflection, rig, airframe, SETTINGS).sectors
        assert by_body is not None
        assert not np.array_equal(by_body.known, levelled.known), "without the attitude the picture is another one"


def test_what_is_too_near_to_be_measured_forbids_to_call_its_sector_clear() -> None:
    sectors = _sectors(np.vstack([_at(0.0, 3.0, count=20), _at(0.0, 900.0)]))
    assert not sectors.known.any()
    assert not sectors.clear.any()


def _ahead(seed: int, right: int, wrong: int) -> ObstacleSectors | None:
    """A wall at 40 m by its right matches, and wrong ones: patches that look alike somewhere in the search's band."""
    airframe = forward(rotation_sigma_rad=2e-5)
    rig, random = Rig.from_airframe(airframe), np.random.default_rng(seed)
    points = wall_ahead(40.0, right, seed)
    points = np.vstack([points, wall_ahead(1.0, wrong, seed + 1) * random.uniform(4.0, 30.0, (wrong, 1))])
    left_px, right_px = raw_pixels(rig, points, (0.02, 0.024))
    right_px[:right] += 0.05 * random.normal(size=(right, 2))
    right_px[right:, 1] += random.uniform(-8.0, 8.0, wrong)
    deflection = bend((0.02, 0.024), slope_sigma_rad=2e-5)
    return correct(match_set(left_px, right_px, 0.05), deflection, deflection, rig, airframe, SETTINGS).sectors


def test_wrong_matches_alone_make_no_sectors() -> None:
    """Their own scatter across the epipolar lines, 5 mrad, let all of them pass: sectors at 4 to 20 m."""
    assert all(_ahead(seed, 0, 35) is None for seed in range(12))


def test_wrong_matches_among_right_ones_cost_no_sectors() -> None:
    for seed in range(12):
        sectors = _ahead(seed, 60, 25)
        assert sectors is not None
        assert np.count_nonzero(sectors.known) >= 5
        assert sectors.distance_m[sectors.known] == pytest.approx(40.0, rel=0.1)
