"""Lenses that are not what their calibration says: the field is as stated, and toe and range err by what they say."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from companion.core.stereo.epipolar_geometry import epipolar_frame, in_frame, parallax
from companion.core.stereo.epipolar_states import LENS, PARALLAX_STATES, YAW
from companion.core.stereo.exposure import TipMotion, exposures, rest_exposures
from companion.core.stereo.extrinsics_drift import ExtrinsicsDriftFilter
from companion.core.stereo.geometry import MountedCamera, Rig
from companion.core.stereo.lens_residual import (
    FOCAL,
    LENS_TERMS,
    PAIR_TERMS,
    PRISM_X,
    PRISM_Y,
    RADIAL,
    RADIAL_MEAN,
    TILT_X,
    TILT_Y,
    LensAxes,
    lens_ratio,
    quarter_turns,
    residual_field,
    straightened,
)
from companion.core.stereo.ranging import PairConditions, correct
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.core.stereo.triangulation import match_rays, range_axis_of_rig, triangulate
from companion.params.airframe import Airframe, Camera
from companion.params.settings import Settings
from companion.records import Deflection, Floats, RelativeRotation, Side
from sitl_tests.unit.stereo_cases import bend, forward, ground_below, match_set, nadir, raw_pixels, wall_ahead

Looks = Callable[..., Airframe]
NOTHING = np.zeros(6)
SLOPE_RAD, TILT_RAD, MATCH_PX = 0.02, 3e-4, 0.05
PAIR_NS, PAIRS, SETTLED = 1_000_000_000, 20, 8


def with_residual(camera: Camera, residual: Floats) -> Camera:
    """The true camera behind a belief whose slopes are wrong by a residual (6,), in the camera's own axes.

    The middle of the image goes on looking where it did: what a shifted principal point turns is turned back.
    """
    tilt, prism = residual[TILT_X : TILT_Y + 1], residual[PRISM_X : PRISM_Y + 1]
    shift = 2.0 * prism - tilt
    focal = camera.focal_px.value * (1.0 + float(residual[FOCAL]))
    k1, k2, p1, p2, k3 = camera.distortion
    turned = log_rotation(
        exp_rotation(np.array(camera.rotation_rad)) @ exp_rotation(np.array([-shift[1], shift[0], 0.0]))
    )
    rx, ry, rz = turned.tolist()
    cx, cy = camera.principal_px
    return dataclasses.replace(
        camera,
        focal_px=dataclasses.replace(camera.focal_px, value=focal),
        principal_px=(cx + focal * float(shift[0]), cy + focal * camera.focal_ratio * float(shift[1])),
        distortion=(k1 + float(residual[RADIAL]), k2, p1 + float(prism[1]), p2 + float(prism[0]), k3),
        rotation_rad=(rx, ry, rz),
    )


def _of(**terms: float) -> np.ndarray:
    """A residual by the names of its terms."""
    names = {
        "focal": FOCAL,
        "radial": RADIAL,
        "tilt_x": TILT_X,
        "tilt_y": TILT_Y,
        "prism_x": PRISM_X,
        "prism_y": PRISM_Y,
    }
    residual = np.zeros(6)
    for name, value in terms.items():
        residual[names[name]] = value
    return residual


TANGENTIAL_X = _of(prism_x=3e-4, tilt_x=6e-4)
"""OpenCV's ``p2 = 3e-4``: 0.06 px across the lines in the corner."""


def _with(airframe: Airframe, left: np.ndarray, right: np.ndarray) -> Airframe:
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    return dataclasses.replace(
        airframe,
        left_camera=with_residual(airframe.left_camera, left),
        right_camera=with_residual(airframe.right_camera, right),
    )


def _camera(airframe: Airframe) -> Camera:
    assert airframe.right_camera is not None
    return airframe.right_camera


@pytest.mark.parametrize(
    "residual",
    [_of(focal=4e-4), _of(radial=2e-3), _of(tilt_x=5e-4), _of(tilt_y=-5e-4), _of(prism_x=3e-4), _of(prism_y=2e-4)],
)
def test_the_true_camera_differs_from_its_belief_by_the_residual(residual: np.ndarray) -> None:
    """Rays of one pixel, by belief and by truth, in the camera's axes: their slopes differ by the field."""
    believed = _camera(nadir(rotation_rad=(0.003, -0.002, 0.004)))
    pixels = np.array([(u, v) for u in np.linspace(5.0, 634.0, 9) for v in np.linspace(5.0, 474.0, 7)])
    belief, truth = (
        MountedCamera.from_record(Side.RIGHT, camera, "camera")
        for camera in (believed, with_residual(believed, residual))
    )
    into = belief.rest.camera_from_body
    slopes = [rays[:, :2] / rays[:, 2:] for rays in (c.rays(c.rest, pixels) @ into.T for c in (belief, truth))]
    expected = residual_field(*slopes[0].T) @ residual
    assert np.abs(slopes[0] - slopes[1] - expected).max() < 0.01 * np.abs(expected).max()


def test_opencvs_tangential_term_is_a_prism_and_twice_as_much_tilt() -> None:
    camera = with_residual(_camera(nadir()), TANGENTIAL_X)
    assert camera.distortion == pytest.approx((0.0, 0.0, 0.0, 3e-4, 0.0))
    assert camera.principal_px == pytest.approx((319.5, 239.5))
    assert camera.rotation_rad == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize("looks", [nadir, forward], ids=["down", "ahead"])
def test_a_bent_wing_turns_the_lens_with_its_camera(looks: Callable[..., Airframe]) -> None:
    """Keystones of 2 mrad in both lenses, wings bent by 60 mrad: in the frame at rest they were wrong by 6 % of that.

    With the terms known, the rays of either exposure meet where the points are, and the filter's parallax is none.
    """
    airframe = looks()
    rig, bent = Rig.from_airframe(airframe), (0.06, 0.06)
    left_terms, right_terms = _of(tilt_x=2e-3, radial=3e-3), _of(tilt_x=1.5e-3, tilt_y=-1e-3)
    points = ground_below(60.0, 400, 3, spread=0.4) if airframe.looks_down else wall_ahead(60.0, 400, 3)
    left, right = raw_pixels(Rig.from_airframe(_with(airframe, left_terms, right_terms)), points, bent)
    matches, wing, frame = match_set(left, right), bend(bent), epipolar_frame(rig)
    moving = exposures(rig, TipMotion.from_airframe(airframe), wing, wing)
    terms = np.concatenate([left_terms - right_terms, np.zeros(PAIR_TERMS - LENS_TERMS)])
    terms[RADIAL_MEAN:] = 0.5 * (left_terms + right_terms)[[RADIAL, TILT_X, TILT_Y]]
    rays, axis_m = match_rays(rig, moving, matches), points @ (frame[2] if airframe.looks_down else np.eye(3)[0])
    state, sight = np.zeros(PARALLAX_STATES), range_axis_of_rig(rig, frame[2])
    state[LENS] = terms
    wrong_m, wrong_rad = [], []
    for pair in (moving, rest_exposures(rig)):
        axes = LensAxes.exposed(pair, frame)
        depths = triangulate(straightened(rays, terms, axes), sight, np.ones(len(left)))
        wrong_m.append(np.abs(1.0 / depths.inverse_pm - axis_m).max())
        wrong_rad.append(np.abs(parallax(in_frame(rays, frame), axes.in_frame(frame), state)[0]).max())
    # what stays is of second order in the residual (1e-3), against its product with the bend
    assert wrong_m[0] < 0.15 * wrong_m[1]
    assert wrong_rad[0] < 0.15 * wrong_rad[1]


@pytest.mark.parametrize("angle_rad", [0.0, 0.3, -0.6])
def test_a_camera_that_bends_far_keeps_its_quarter_turns(angle_rad: float) -> None:
    """Beyond 30 degrees the rounded entries of a rotation are no rotation any more."""
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.array_equal(quarter_turns(quarter @ exp_rotation(angle_rad * np.eye(3)[0])), quarter)


@dataclasses.dataclass
class Flown:
    """Pairs of one flight after the first few: toe error over sigma; relative errors of trusted ranges over sigma."""

    toe_over: np.ndarray
    range_over: np.ndarray
    trusted: int
    last: RelativeRotation
    joint: np.ndarray


def _believed(off_rad: float, t_ns: int) -> Deflection:
    """A tracked slope whose error is slow, and lasts."""
    base = bend((SLOPE_RAD - off_rad, SLOPE_RAD - off_rad), t_ns=t_ns)
    covariance = base.covariance.copy()
    covariance[4:, 4:] += TILT_RAD**2
    return dataclasses.replace(base, covariance=covariance, slow_slope_sigma_rad=TILT_RAD)


def _mounted(airframe: Airframe, random: np.random.Generator) -> tuple[Airframe, float]:
    """The right camera turned by twice the variance of one, as a true pair is; its yaw."""
    turn = np.sqrt(2.0) * _camera(airframe).rotation_sigma_rad * random.standard_normal(3)
    x, y, z = turn.tolist()
    camera = dataclasses.replace(_camera(airframe), rotation_rad=(x, y, z))
    return dataclasses.replace(airframe, right_camera=camera), y


def _fly(airframe: Airframe, residuals: tuple[np.ndarray, np.ndarray], seed: int) -> Flown:
    """A climb from 20 to 100 m (walls as far ahead) with noisy matches through the true lenses and mounting."""
    left_node, right_node = (dataclasses.replace(node, bias_time_s=1e7) for node in (airframe.left, airframe.right))
    airframe = dataclasses.replace(airframe, left=left_node, right=right_node)
    rig, settings, random = Rig.from_airframe(airframe), Settings(), np.random.default_rng([seed, 0x1E])
    mounted, yaw_rad = _mounted(airframe, random)
    true_rig, drift = Rig.from_airframe(_with(mounted, *residuals)), ExtrinsicsDriftFilter(rig, airframe)
    true_rotation = yaw_rad * np.eye(3)[YAW]
    off_rad = TILT_RAD * random.standard_normal()
    toe_over, range_over = [], []
    for k in range(PAIRS):
        range_m = 20.0 * 5.0 ** random.uniform()
        points = (
            ground_below(range_m, 500, 1000 * seed + k, tilt=(0.05, -0.08), spread=0.42)
            if airframe.looks_down
            else wall_ahead(range_m, 500, 1000 * seed + k)
        )
        left, right = raw_pixels(true_rig, points, (SLOPE_RAD, SLOPE_RAD))
        inside = np.all((np.minimum(left, right) > 10.0) & (np.maximum(left, right) < (630.0, 470.0)), axis=1)
        left, right = left[inside][:150], right[inside][:150]
        matches = match_set(left, right + MATCH_PX * random.standard_normal(right.shape), MATCH_PX)
        wing = _believed(off_rad, k * PAIR_NS)
        moving = exposures(rig, TipMotion.from_airframe(airframe), wing, wing)
        rotation = drift.update(matches, match_rays(rig, moving, matches), (wing, wing), moving, 0.0)
        joint = drift.joint_covariance
        answer = correct(
            matches, wing, wing, rig, airframe, settings, PairConditions(turned=rotation, joint_covariance=joint)
        ).range
        if k >= SETTLED:
            true_rad = true_rotation + 2.0 * off_rad * (epipolar_frame(rig) @ rig.right.turn_rad(1.0))
            toe_over.append((rotation.rotation_rad - true_rad)[YAW] / np.sqrt(rotation.covariance[YAW, YAW]))
            if answer.trusted:
                range_over.append((answer.range_m - range_m) / answer.sigma_m)
    return Flown(np.array(toe_over), np.array(range_over), len(range_over), rotation, joint)


@pytest.mark.parametrize("looks", [nadir, forward], ids=["down", "ahead"])
@pytest.mark.parametrize("side", [0, 1])
def test_a_tangential_distortion_puts_no_trusted_range_beyond_five_sigma(
    looks: Callable[..., Airframe], side: int
) -> None:
    """One lens of ``p2 = 3e-4``, either sign, under the default sigmas of a calibration: 1.8 of their one-sigmas."""
    airframe = calibrated_by_default(looks(rotation_sigma_rad=3e-4))
    for sign in (-1.0, 1.0):
        residuals = [NOTHING, NOTHING]
        residuals[side] = sign * TANGENTIAL_X
        flown = _fly(airframe, (residuals[0], residuals[1]), 5)
        assert flown.trusted == PAIRS - SETTLED
        assert np.abs(flown.range_over).max() < 3.0
        assert np.abs(flown.toe_over).max() < 3.0


def calibrated_by_default(airframe: Airframe) -> Airframe:
    usual = {
        entry.name: entry.default
        for entry in dataclasses.fields(Camera)
        if entry.name in ("tilt_sigma_rad", "prism_sigma", "radial_sigma")
    }
    return dataclasses.replace(
        airframe,
        left_camera=dataclasses.replace(_camera(airframe), **usual, position_m=(0.0, -0.99, 0.0)),
        right_camera=dataclasses.replace(_camera(airframe), **usual),
    )


@pytest.mark.slow
@pytest.mark.parametrize("looks", [pytest.param(nadir, marks=pytest.mark.long), forward], ids=["down", "ahead"])
def test_lenses_drawn_from_the_prior_leave_honest_sigmas(looks: Looks) -> None:
    """Toe and range of 16 flights, each one draw of what no match tells: chi-square within 99.8 %; no 5 sigma."""
    airframe, flights = calibrated_by_default(looks(rotation_sigma_rad=3e-4)), 16
    camera = _camera(airframe)
    tilt, prism = camera.tilt_sigma_rad, camera.prism_sigma
    sigmas = np.array([camera.focal_px.sigma / 800.0, camera.radial_sigma, tilt, tilt, prism, prism])
    flown = [
        _fly(airframe, tuple(sigmas * np.random.default_rng([seed, 7]).standard_normal((2, 6))), seed)
        for seed in range(flights)
    ]
    low, high = chi2.ppf([0.001, 0.999], flights) / flights
    toe, ranges = (np.concatenate([getattr(f, name) for f in flown]) for name in ("toe_over", "range_over"))
    assert low < np.mean(toe**2) < high
    assert np.mean(ranges**2) < high
    assert np.abs(ranges).max() < 5.0
    assert sum(f.trusted for f in flown) > 0.95 * flights * (PAIRS - SETTLED)


def test_keystone_and_prism_across_the_lines_are_learnt_and_along_them_only_believed() -> None:
    """``t_x`` shows as a yaw does and ``s_x`` not at all; the other two are parallaxes of their own.

    A tenth of ``t_x`` may be learnt from near things, by how little a baseline's direction is believed to be off.
    """
    airframe = calibrated_by_default(nadir(rotation_sigma_rad=0.003))
    truth = _of(tilt_y=8e-4, prism_y=-4e-4)
    flown = _fly(airframe, (truth, NOTHING), 1)
    prior = np.sqrt(2.0) * np.array([_camera(airframe).tilt_sigma_rad] * 2 + [_camera(airframe).prism_sigma] * 2)
    sigma = np.sqrt(np.diag(flown.joint))[3 + TILT_X : 3 + PRISM_Y + 1]
    assert np.all(sigma[[0, 2]] > 0.9 * prior[[0, 2]])
    assert np.all(sigma[[1, 3]] < 0.5 * prior[[1, 3]])
    error = flown.last.lens[TILT_X : PRISM_Y + 1] - truth[TILT_X : PRISM_Y + 1]
    assert np.all(np.abs(error) < 3.0 * sigma)


PRIOR = np.array([5e-4, 2e-3, 4e-4, 4e-4, 1e-4, 1e-4, 1e-3, 2e-4, 2e-4]) ** 2


@pytest.mark.parametrize("worse", [2.0, 4.0])
def test_a_calibration_that_is_old_is_recognised(worse: float) -> None:
    """All but one term show, two count as good ones: the mean ratio of calibrations lies between one and the truth."""
    rng = np.random.default_rng(8)
    after = np.diag(0.01 * PRIOR)
    ratios = [
        lens_ratio(worse * np.sqrt(0.99**2 * PRIOR) * rng.standard_normal(PAIR_TERMS), after, PRIOR)
        for _ in range(4000)
    ]
    assert np.mean(ratios) == pytest.approx((2.0 + 8.0 * worse**2) / 10.0, rel=0.05)


def test_terms_that_have_not_shown_say_nothing_of_the_calibration() -> None:
    assert lens_ratio(np.zeros(PAIR_TERMS), np.diag(PRIOR), PRIOR) == 1.0


def test_a_calibration_is_not_taken_for_better_than_it_says() -> None:
    assert lens_ratio(np.zeros(PAIR_TERMS), np.diag(1e-3 * PRIOR), PRIOR) == 1.0


def test_terms_without_a_sigma_say_nothing_of_the_calibration() -> None:
    exact = PRIOR.copy()
    exact[[FOCAL, TILT_X, TILT_Y]] = 0.0
    terms = np.where(exact > 0.0, 2.0 * np.sqrt(PRIOR), 0.0)
    shown = lens_ratio(terms, 0.01 * np.diag(exact), exact)
    assert 1.0 < shown < 4.0
    assert lens_ratio(np.zeros(PAIR_TERMS), np.zeros((PAIR_TERMS, PAIR_TERMS)), np.zeros(PAIR_TERMS)) == 1.0


def old_lens(seed: int, worse: float, airframe: Airframe) -> np.ndarray:
    camera = _camera(airframe)
    tilt, prism = camera.tilt_sigma_rad, camera.prism_sigma
    sigma = np.array([camera.focal_px.sigma / camera.focal_px.value, camera.radial_sigma, tilt, tilt, prism, prism])
    return np.asarray(worse * sigma * np.random.default_rng([seed, 0x01D]).standard_normal(6))


@pytest.mark.slow
@pytest.mark.parametrize("looks", [nadir, pytest.param(forward, marks=pytest.mark.long)], ids=["down", "ahead"])
def test_an_old_calibration_is_in_the_toes_sigma(looks: Looks) -> None:
    """Lenses four times as wrong as stated: what the observed terms say widens all, those that look like yaw too.

    Taken at their word the stated sigmas leave 7 of these 12 flights inside three sigma; where all four observed terms
    happen to be small, nothing can tell. The four err by what they say: chi-square of 48 values within 99.9 %.
    """
    airframe = calibrated_by_default(looks(rotation_sigma_rad=3e-4))
    over, shown_over = [], []
    for seed in range(12):
        residuals = (old_lens(2 * seed, 4.0, airframe), old_lens(2 * seed + 1, 4.0, airframe))
        flown = _fly(airframe, residuals, seed)
        over.append(flown.toe_over[-1])
        error = flown.last.lens[: PRISM_Y + 1] - (residuals[0] - residuals[1])
        shown_over.append((error / np.sqrt(np.diag(flown.joint))[3 : 3 + len(error)])[[FOCAL, RADIAL, TILT_Y, PRISM_Y]])
    assert np.sum(np.abs(over) < 3.0) >= 10
    assert np.mean(np.square(shown_over)) < chi2.ppf(0.999, np.size(shown_over)) / np.size(shown_over)


def test_a_wider_belief_is_no_evidence_of_an_old_calibration() -> None:
    """Terms as large as their prior, learnt under one four times as wide: the mean ratio stays at one."""
    rng, believed, learnt_ratio = np.random.default_rng(9), 4.0, 0.9
    noise = believed * PRIOR * (1.0 - learnt_ratio) / learnt_ratio
    after = np.diag((1.0 - learnt_ratio) * believed * PRIOR)
    truth, errors = (np.sqrt(v) * rng.standard_normal((4000, PAIR_TERMS)) for v in (PRIOR, noise))
    ratios = [lens_ratio(learnt_ratio * terms, after, PRIOR, believed) for terms in truth + errors]
    # never below one, so that the mean lies above it by less than half
    assert 1.0 < np.mean(ratios) < 1.5
