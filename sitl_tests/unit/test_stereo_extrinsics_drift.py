"""Tilt and matches fused: each alone and both together err by what they say, and know what they cannot see."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from companion.core.stereo.exposure import TipMotion, exposures
from companion.core.stereo.extrinsics_drift import ExtrinsicsDriftFilter
from companion.core.stereo.geometry import Rig
from companion.core.stereo.ranging import PairConditions, correct
from companion.core.stereo.triangulation import match_rays
from companion.core.stereo.vehicle_motion import STILL
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Deflection, MatchSet, RelativeRotation
from sitl_tests.unit.stereo_cases import bend, forward, ground_below, match_set, nadir, raw_pixels, wall_ahead
from sitl_tests.unit.test_stereo_lens_residual import with_residual

YAW, ROLL = 1, 2
TRUE_SLOPE = 0.02
MATCH_PX = 0.1
PERIOD_NS = 100_000_000


def _believed(slope_rad: float, slow_rad: float, fast_rad: float, t_ns: int) -> Deflection:
    """A tracked slope of both tips; its sigma is a slow part, equal in both, and a fast part of each tip's own."""
    base = bend((slope_rad, slope_rad), t_ns=t_ns, slope_sigma_rad=fast_rad)
    covariance = base.covariance.copy()
    covariance[4:, 4:] += slow_rad**2
    return dataclasses.replace(base, covariance=covariance, slow_slope_sigma_rad=slow_rad)


def _lasting(airframe: Airframe) -> Airframe:
    """Inertial errors that do not drift."""
    left, right = (dataclasses.replace(sensor, bias_time_s=1e7) for sensor in (airframe.left, airframe.right))
    return dataclasses.replace(airframe, left=left, right=right)


def _matches(airframe: Airframe, points: np.ndarray, turned: Airframe, seed: int) -> MatchSet:
    left, right = raw_pixels(Rig.from_airframe(turned), points, (TRUE_SLOPE, TRUE_SLOPE))
    right = right + MATCH_PX * np.random.default_rng(seed).standard_normal(right.shape)
    return match_set(left, right, MATCH_PX)


def _rotation_after(
    slow: ExtrinsicsDriftFilter, airframe: Airframe, matches: MatchSet, wing: Deflection, use_matches: bool
) -> RelativeRotation:
    rig = Rig.from_airframe(airframe)
    moving = exposures(rig, TipMotion.from_airframe(airframe), wing, wing)
    return slow.update(matches, match_rays(rig, moving, matches), (wing, wing), moving, 0.0, use_matches=use_matches)


def _mounted(airframe: Airframe, random: np.random.Generator) -> tuple[Airframe, np.ndarray]:
    """The truth: both cameras turned and both lenses bent by their priors; the relative rotation, epipolar frame."""
    cameras, turned = [], []
    rig = Rig.from_airframe(airframe)
    for mounted, camera in ((rig.left, airframe.left_camera), (rig.right, airframe.right_camera)):
        assert camera is not None
        turn = camera.rotation_sigma_rad * random.standard_normal(3)
        x, y, z = turn.tolist()
        sigma = [camera.focal_px.sigma / camera.focal_px.value, camera.radial_sigma]
        sigma += [camera.tilt_sigma_rad] * 2 + [camera.prism_sigma] * 2
        bent = with_residual(dataclasses.replace(camera, rotation_rad=(x, y, z)), sigma * random.standard_normal(6))
        cameras.append(bent)
        turned.append(mounted.rest.camera_from_body.T @ turn)
    frame = ExtrinsicsDriftFilter(rig, airframe).body_from_epipolar.T
    return dataclasses.replace(airframe, left_camera=cameras[0], right_camera=cameras[1]), frame @ (
        turned[1] - turned[0]
    )


def _errors(tilt_rad: float, use_matches: bool, flights: int = 40, pairs: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Last yaw error of each flight, and its stated sigma; the tracker's slow error is drawn from ``tilt_rad``."""
    airframe = _lasting(nadir(rotation_sigma_rad=3e-4))
    rig = Rig.from_airframe(airframe)
    errors, sigmas = [], []
    for flight in range(flights):
        random = np.random.default_rng([flight, 77])
        truth, mounting = _mounted(airframe, random)
        off_rad = tilt_rad * random.standard_normal()
        slow = ExtrinsicsDriftFilter(rig, airframe)
        for k in range(pairs):
            fast = 2e-4 * random.standard_normal(2)
            wing = _believed(TRUE_SLOPE - off_rad, tilt_rad, 2e-4, k * PERIOD_NS)
            wing = dataclasses.replace(wing, slope_rad=wing.slope_rad - fast)
            rolling = ground_below(60.0, 120, 100 * flight + k, tilt=(0.1, -0.05))
            rotation = _rotation_after(
                slow, airframe, _matches(airframe, rolling, truth, 1000 * flight + k), wing, use_matches
            )
        # up-bend turns the right camera about -x of the body, which is +y of this pair's epipolar frame, twice over
        errors.append(rotation.slow_rad[YAW] - (2.0 * off_rad + mounting[YAW]))
        sigmas.append(np.sqrt(rotation.slow_covariance[YAW, YAW]))
    return np.array(errors), np.array(sigmas)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tilt_rad", "use_matches"), [(0.002, False), (0.01, True), pytest.param(0.0002, True, marks=pytest.mark.long)]
)
def test_the_sigma_of_tilt_only_epipolar_only_and_both_is_honest(tilt_rad: float, use_matches: bool) -> None:
    """Chi-square with 40 degrees of freedom over 40: mean 1, standard deviation 0.22."""
    errors, sigmas = _errors(tilt_rad, use_matches)
    assert 1.0 - 3 * 0.22 < np.mean((errors / sigmas) ** 2) < 1.0 + 3 * 0.22


def test_both_together_are_better_than_either() -> None:
    tilt, features, both = (
        _errors(tilt_rad, use_matches, flights=10, pairs=1)[1].mean()
        for tilt_rad, use_matches in ((0.0001, False), (0.01, True), (0.0001, True))
    )
    assert both < 0.9 * min(tilt, features)
    # mounting is common to both, so that their information does not simply add up; it can at most
    assert both > 0.98 / np.hypot(1 / tilt, 1 / features)


def test_without_looking_the_yaw_is_as_uncertain_as_tilt_and_mounting() -> None:
    airframe = nadir(rotation_sigma_rad=3e-4)
    rotation = _rotation_after(
        ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe),
        airframe,
        _matches(airframe, ground_below(60.0, 50, 1), airframe, 1),
        _believed(TRUE_SLOPE, 0.001, 2e-4, 0),
        use_matches=False,
    )
    assert (rotation.matches, rotation.parallax_scale) == (0, 0.0)
    slow = (2 * 0.001) ** 2 + 2 * 3e-4**2
    assert rotation.slow_covariance[YAW, YAW] == pytest.approx(slow)
    assert rotation.covariance[YAW, YAW] == pytest.approx(slow + 2 * 2e-4**2)
    assert rotation.slow_covariance[ROLL, ROLL] == pytest.approx(2 * 3e-4**2)


@pytest.mark.parametrize("count", [3, 50])
def test_a_pair_without_flow_contradicts_none(count: int) -> None:
    """Neither a pair of too few matches nor one that is not used keeps the verdict on the flow before it."""
    airframe = nadir()
    slow = ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe)
    slow.flow_contradicts = True
    matches = _matches(airframe, ground_below(60.0, count, 1), airframe, 1)
    _rotation_after(slow, airframe, matches, _believed(TRUE_SLOPE, 0.001, 0.0, 0), use_matches=count < 12)
    assert not slow.flow_contradicts


def test_what_the_tracker_learns_is_taken_over_and_what_the_matches_told_is_not_counted_twice() -> None:
    """Two witnesses of one constant: tilt known to s, then to s/2; nothing seen in between."""
    airframe = nadir(rotation_sigma_rad=1e-7)
    slow = ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe)
    matches = _matches(airframe, ground_below(60.0, 50, 1), airframe, 1)
    first = _rotation_after(slow, airframe, matches, _believed(TRUE_SLOPE, 0.001, 0.0, 0), use_matches=True)
    later = _rotation_after(slow, airframe, matches, _believed(TRUE_SLOPE, 0.0005, 0.0, PERIOD_NS), use_matches=False)
    seen_slope = first.slow_covariance[YAW, YAW] / 4.0
    ratio = 0.25
    expected = ratio**2 * seen_slope + 0.0005**2 * (1.0 - ratio)
    assert later.slow_covariance[YAW, YAW] / 4.0 == pytest.approx(expected, rel=1e-3)


def _scaled_errors(bend_scale: float, flights: int = 8, pairs: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """Yaw error of the last 30 pairs of each flight, rad, and its sigma; the tracked fast bend is wrong by a share."""
    airframe = _lasting(nadir(rotation_sigma_rad=3e-4))
    rig, tips = Rig.from_airframe(airframe), TipMotion.from_airframe(airframe)
    errors, sigmas = [], []
    for flight in range(flights):
        random = np.random.default_rng([flight, 78])
        drift, scale = ExtrinsicsDriftFilter(rig, airframe), bend_scale * random.standard_normal()
        for k in range(pairs):
            fast_rad = 0.01 * random.standard_normal()
            slope_rad = TRUE_SLOPE + (1.0 + scale) * fast_rad
            pixels = raw_pixels(
                rig, ground_below(60.0, 100, 1000 * flight + k, tilt=(0.1, -0.05)), (slope_rad, slope_rad)
            )
            noise = 0.03 * random.standard_normal(pixels[1].shape)
            wing = _believed(TRUE_SLOPE + fast_rad, 2e-4, 2e-5, k * PERIOD_NS)
            moving = exposures(rig, tips, wing, wing)
            matches = match_set(pixels[0], pixels[1] + noise, 0.03)
            rotation = drift.update(matches, match_rays(rig, moving, matches), (wing, wing), moving, 0.0)
            if k >= pairs - 30:
                errors.append(rotation.rotation_rad[YAW] - 2.0 * scale * fast_rad)
                sigmas.append(np.sqrt(rotation.covariance[YAW, YAW]))
    return np.array(errors), np.array(sigmas)


@pytest.mark.long
def test_an_error_of_scale_of_the_fast_bend_is_learnt_over_pairs() -> None:
    """Gyros and slope factor wrong by their sigmas, 0.6 %: 0.12 mrad of each pair's toe; a third of it may be left."""
    sigma = math.hypot(0.005 / math.sqrt(2.0), 0.007 / 1.39)
    errors, sigmas = _scaled_errors(sigma)
    per_flight = errors.reshape(-1, 30)
    fast = per_flight - per_flight.mean(axis=1, keepdims=True)
    assert np.sqrt(np.mean(fast**2)) < 0.33 * 2.0 * sigma * 0.01
    assert np.mean((errors / sigmas) ** 2) < 1.5


def _last_yaw_sigma(sigmas_rad: list[float], use_matches: bool) -> float:
    """Yaw sigma under a slow bend whose stated sigma goes through a list; ``use_matches`` is for the last pair."""
    airframe = _lasting(nadir(rotation_sigma_rad=1e-7))
    slow = ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe)
    for k, sigma_rad in enumerate(sigmas_rad):
        wing = _believed(TRUE_SLOPE, sigma_rad, 0.0, k * PERIOD_NS)
        matches = _matches(airframe, ground_below(60.0, 60, k), airframe, k)
        rotation = _rotation_after(slow, airframe, matches, wing, use_matches=use_matches or k + 1 < len(sigmas_rad))
    return float(np.sqrt(rotation.slow_covariance[YAW, YAW]))


def test_a_stated_sigma_that_ripples_with_the_load_makes_nobody_forget() -> None:
    """Two percent up and down, twenty times: what the matches have told of a lasting error stays told."""
    steady = _last_yaw_sigma([0.002] * 20, use_matches=True)
    rippling = _last_yaw_sigma([0.002, 0.00204] * 10, use_matches=True)
    assert steady < 0.1 * 2.0 * 0.002
    assert rippling == pytest.approx(steady, rel=0.02)


def test_a_tracker_that_has_lost_the_bend_is_believed_at_once() -> None:
    sigma = _last_yaw_sigma([0.0005] * 5 + [0.005], use_matches=False)
    assert 0.75 * 2.0 * 0.005 < sigma <= 2.0 * 0.005


def test_matches_on_the_axes_say_nothing_about_yaw_and_the_filter_knows() -> None:
    """The parallax of yaw is x y: features on the cross x = 0 or y = 0 of the right image are blind to it."""
    airframe = nadir(rotation_sigma_rad=1e-7)
    random = np.random.default_rng(3)
    reach = random.uniform(-15.0, 15.0, 100)
    cross = np.column_stack(
        [np.where(np.arange(100) % 2, reach, 0.0), np.where(np.arange(100) % 2, 0.99, reach), np.full(100, 60.0)]
    )
    wing = _believed(TRUE_SLOPE, 0.002, 0.0, 0)
    slow = ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe)
    rotation = _rotation_after(slow, airframe, _matches(airframe, cross, airframe, 2), wing, use_matches=True)
    assert np.sqrt(rotation.slow_covariance[YAW, YAW]) > 0.9 * 0.004
    everywhere = ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe)
    rotation = _rotation_after(
        everywhere, airframe, _matches(airframe, ground_below(60.0, 100, 4), airframe, 2), wing, use_matches=True
    )
    assert np.sqrt(rotation.slow_covariance[YAW, YAW]) < 0.25 * 0.004


def test_a_forward_pair_sees_its_bend_as_roll_at_once() -> None:
    airframe = forward(rotation_sigma_rad=1e-7)
    wing = _believed(TRUE_SLOPE - 0.002, 0.004, 0.0, 0)
    slow = ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe)
    rotation = _rotation_after(
        slow, airframe, _matches(airframe, wall_ahead(40.0, 100, 5), airframe, 6), wing, use_matches=True
    )
    # parallax of roll is x: noise / (rms of x times sqrt(n)), x uniform within +-0.3
    noise = MATCH_PX / 800.0
    assert np.sqrt(rotation.slow_covariance[ROLL, ROLL]) == pytest.approx(noise / (0.3 / np.sqrt(3.0) * 10.0), rel=0.3)
    assert abs(abs(rotation.slow_rad[ROLL]) - 0.004) < 4 * np.sqrt(rotation.slow_covariance[ROLL, ROLL])


def test_the_range_takes_the_rotation_and_its_sigma() -> None:
    """A slope that is 1 mrad wrong in both tips: 60 m would read 64 m; matches bring it back within its own sigma."""
    airframe = nadir(rotation_sigma_rad=1e-4)
    rig, settings = Rig.from_airframe(airframe), Settings()
    slow = ExtrinsicsDriftFilter(rig, airframe)
    for k in range(60):
        wing = _believed(TRUE_SLOPE - 0.001, 0.001, 1e-4, k * PERIOD_NS)
        matches = _matches(airframe, ground_below(60.0, 150, k, tilt=(0.1, 0.1)), airframe, k)
        rotation = _rotation_after(slow, airframe, matches, wing, use_matches=True)
    blind = correct(matches, wing, wing, rig, airframe, settings).range
    held = correct(matches, wing, wing, rig, airframe, settings, PairConditions(turned=rotation)).range
    assert abs(blind.range_m - 60.0) > 3.0
    assert held.sigma_m < 0.5 * blind.sigma_m
    assert abs(held.range_m - 60.0) < 3.0 * held.sigma_m
    assert held.toe_rad == pytest.approx(2 * TRUE_SLOPE, abs=3.0 * held.toe_sigma_rad)
    assert held.toe_sigma_rad == pytest.approx(np.sqrt(rotation.covariance[YAW, YAW]), rel=0.05)


def test_numbers_that_are_none_change_nothing() -> None:
    airframe = nadir()
    slow = ExtrinsicsDriftFilter(Rig.from_airframe(airframe), airframe)
    matches = _matches(airframe, ground_below(60.0, 50, 1), airframe, 1)
    good = _rotation_after(slow, airframe, matches, _believed(TRUE_SLOPE, 0.001, 2e-4, 0), use_matches=True)
    broken = dataclasses.replace(matches, left_px=matches.left_px * np.nan)
    rotation = _rotation_after(slow, airframe, broken, _believed(TRUE_SLOPE, 0.001, 2e-4, PERIOD_NS), use_matches=True)
    assert rotation.matches == 0
    assert np.allclose(rotation.slow_rad, good.slow_rad, rtol=1e-3)
    assert np.isfinite(rotation.covariance).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "airframe", [load_airframe("forward-2m"), load_airframe("nadir-2m")], ids=lambda airframe: airframe.name
)
def test_no_number_of_pairs_averages_a_steady_hundredth_of_a_pixel_away(airframe: Airframe) -> None:
    """A hundredth of a pixel in the corner of 640 x 480 at 800 px is 0.104 mrad of yaw; a good tracker still helps."""
    steady = 0.01 / 800.0 / (0.4 * 0.3)
    rig, sigma = Rig.from_airframe(airframe), []
    looks = wall_ahead if airframe.orientation == 0 else ground_below
    for tilt_rad in (0.01, 0.5 * 0.5 * steady):
        slow = ExtrinsicsDriftFilter(rig, airframe)
        for k in range(150):
            wing = _believed(TRUE_SLOPE, tilt_rad, 0.0, k * PERIOD_NS)
            matches = _matches(airframe, looks(60.0, 200, k), airframe, k)
            matches = dataclasses.replace(matches, sigma_px=0.01 * matches.sigma_px)
            rotation = _rotation_after(slow, airframe, matches, wing, use_matches=True)
        sigma.append(np.sqrt(rotation.slow_covariance[YAW, YAW]))
    mounting = np.sqrt(2.0) * airframe.left_camera.rotation_sigma_rad if airframe.left_camera else 0.0
    alone = steady if airframe.orientation else steady * mounting / np.hypot(steady, mounting)
    assert sigma[0] > 0.9 * alone
    assert sigma[1] < sigma[0] if airframe.orientation else sigma[1] > 0.9 * alone


def test_lift_of_the_tips_against_each_other_turns_the_baseline_alone() -> None:
    """An antisymmetric deflection of sigma s moves the tips apart by twice that; a symmetric one moves both alike."""
    airframe = nadir()
    rig = Rig.from_airframe(airframe)
    drift, wing = ExtrinsicsDriftFilter(rig, airframe), bend((TRUE_SLOPE, TRUE_SLOPE), t_ns=0)
    gains = rig.left.lift_gain + rig.right.lift_gain
    for mode, sigma_rad in ((0, 0.0), (1, gains * 0.05 / rig.baseline_m)):
        covariance = np.zeros((6, 6))
        covariance[mode, mode] = 0.05**2
        doubted = dataclasses.replace(wing, covariance=covariance)
        moving = exposures(rig, TipMotion.from_airframe(airframe), doubted, doubted)
        shift = drift._shift((doubted, doubted), moving, 0.0, STILL)
        assert np.sqrt(np.diag(shift)) == pytest.approx([0.0, sigma_rad], abs=1e-12)
