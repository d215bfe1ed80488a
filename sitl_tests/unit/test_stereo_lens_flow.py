"""Lenses that are not what their calibration says, in flight: the flow tells the keystone that looks like a yaw."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from companion.core.stereo.consistency_gate import MatchVerdict
from companion.core.stereo.epipolar_states import YAW
from companion.core.stereo.exposure import TipMotion, exposures
from companion.core.stereo.extrinsics_drift import ExtrinsicsDriftFilter
from companion.core.stereo.flow import FlightBetween, FlowView
from companion.core.stereo.geometry import Rig
from companion.core.stereo.lens_residual import LENS_TERMS, TILT_X, LensAxes, pair_variances
from companion.core.stereo.triangulation import Rays, match_rays
from companion.params.airframe import Airframe
from companion.records import Floats, Side
from sitl_tests.unit.stereo_cases import bend, forward, match_set, raw_pixels
from sitl_tests.unit.test_stereo_lens_residual import calibrated_by_default, old_lens, with_residual

PAIRS, PAIR_S, SPEED_MPS, VELOCITY_MPS = 60, 0.15, 22.0, 0.3
SLOPE, MOUNTING_RAD, MATCH_PX, FEATURES = (0.02, 0.02), 3e-4, 0.1, 120


@dataclasses.dataclass(frozen=True)
class Flown:
    """The last pair of a flight: toe error and lens terms' errors over sigma; pairs that were taken for a knock.

    ``tilt_share`` is the sigma of ``t_x`` over that of its prior.
    """

    toe_over: float
    lens_over: Floats
    tilt_share: float
    lens_ratio: float
    knocks: int


def _true_rig(airframe: Airframe, residuals: tuple[Floats, Floats], yaw_rad: float) -> Rig:
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    turned = dataclasses.replace(airframe.right_camera, rotation_rad=(0.0, yaw_rad, 0.0))
    cameras = {
        "left_camera": with_residual(airframe.left_camera, residuals[0]),
        "right_camera": with_residual(turned, residuals[1]),
    }
    return Rig.from_airframe(dataclasses.replace(airframe, **cameras))


def _fly(
    airframe: Airframe,
    residuals: tuple[Floats, Floats],
    seed: int,
    *,
    away_m: tuple[float, float] = (30.0, 90.0),
    surface_mps: float = 0.0,
) -> Flown:
    """Nine seconds straight ahead toward things ``away_m``; the velocity that is told is wrong by a constant.

    All of the things move along the flight with ``surface_mps``.
    """
    rng, rig, tips = np.random.default_rng([seed, 0xF1]), Rig.from_airframe(airframe), TipMotion.from_airframe(airframe)
    yaw_rad = float(np.sqrt(2.0) * MOUNTING_RAD * rng.standard_normal())
    true, drift, knocks = _true_rig(airframe, residuals, yaw_rad), ExtrinsicsDriftFilter(rig, airframe), 0
    moved_m = np.array([SPEED_MPS * PAIR_S, 0.0, 0.0])
    believed_m = moved_m + PAIR_S * VELOCITY_MPS * rng.standard_normal(3)
    moved_m = moved_m - np.array([surface_mps * PAIR_S, 0.0, 0.0])
    between = FlightBetween(PAIR_S, np.zeros(3), believed_m, VELOCITY_MPS**2 * np.eye(3), np.zeros((3, 3)))
    for k in range(PAIRS):
        ahead_m = rng.uniform(*away_m, 2 * FEATURES)
        points = np.column_stack([ahead_m, *(ahead_m * rng.uniform(-w, w, 2 * FEATURES) for w in (0.36, 0.26))])
        (left, right), (earlier, _) = raw_pixels(true, points, SLOPE), raw_pixels(true, points + moved_m, SLOPE)
        inside = np.all((np.minimum(left, right) > 5.0) & (np.maximum(left, right) < (635.0, 475.0)), axis=1)
        left, right, earlier = (each[inside][:FEATURES] for each in (left, right, earlier))
        right, earlier = (each + MATCH_PX * rng.standard_normal(each.shape) for each in (right, earlier))
        matches, wing = match_set(left, right, MATCH_PX), bend(SLOPE, t_ns=round(k * PAIR_S * 1e9))
        moving = exposures(rig, tips, wing, wing)
        rays = match_rays(rig, moving, matches)
        axes = LensAxes.exposed(moving, drift.body_from_epipolar.T)
        flow = _view(rig, rays, (earlier, left), between, drift.body_from_epipolar.T, axes) if k else None
        turned = drift.update(matches, rays, (wing, wing), moving, 0.0, flow=flow)
        knocks += drift.verdict is MatchVerdict.KNOCKED
    sigma = np.sqrt(np.diag(drift.joint_covariance))
    lens_error = turned.lens[:LENS_TERMS] - (residuals[0] - residuals[1])
    return Flown(
        (turned.rotation_rad[YAW] - yaw_rad) / sigma[YAW],
        lens_error / sigma[3 : 3 + LENS_TERMS],
        sigma[3 + TILT_X] / np.sqrt(drift.lens_ratio * pair_variances(airframe)[TILT_X]),
        drift.lens_ratio,
        knocks,
    )


def _view(
    rig: Rig,
    rays: Rays,
    left_px: tuple[Floats, Floats],
    between: FlightBetween,
    epipolar_from_body: Floats,
    axes: LensAxes,
) -> FlowView:
    """Every feature found again in the left image before, at pixels (n, 2) there and now."""
    lens, count = rig.left.lens, len(rays.left)
    earlier, later = (lens.unproject(px) for px in left_px)
    pose = rig.pose(Side.LEFT, SLOPE[0], 0.0)
    sigma_rad = np.full(count, MATCH_PX / lens.focal_px)
    index = np.arange(count)
    return FlowView(index, rays, sigma_rad, earlier, later, sigma_rad, pose, pose, between, epipolar_from_body, axes)


def _ahead() -> Airframe:
    return calibrated_by_default(forward(rotation_sigma_rad=MOUNTING_RAD))


@pytest.mark.parametrize("sigmas", [4.0, 8.0])
def test_a_keystone_beyond_what_is_stated_is_learnt_and_no_knock(sigmas: float) -> None:
    """``t_x`` of four sigma is a yaw of 2 mrad to the matches of every pair, and none to the flow.

    Taken for an error of each pair alone it was a knock every other second, after which the toe was wrong by all of it.
    Of eight sigma it contradicts the flow from the start: were that refused for good, the toe would stay wrong.
    """
    airframe, residuals = _ahead(), (np.zeros(LENS_TERMS), np.zeros(LENS_TERMS))
    assert airframe.right_camera is not None
    residuals[0][TILT_X] = sigmas * np.sqrt(2.0) * airframe.right_camera.tilt_sigma_rad
    flown = _fly(airframe, residuals, 1)
    assert flown.knocks == 0
    assert abs(flown.toe_over) < 3.0
    assert abs(flown.lens_over[TILT_X]) < 3.0
    assert flown.tilt_share < 0.5


@pytest.mark.parametrize("surface_mps", [-10.0, 8.0])
def test_a_surface_that_moves_from_the_start_turns_no_camera(surface_mps: float) -> None:
    """A ship or a wave that comes at 10 m/s passes 1.45 times too fast: the flow alone would have a toe of 15 mrad.

    While a calibration was doubted up to 40 of its sigmas, the flow was believed, and the toe was wrong by all of it.
    """
    still = np.zeros(LENS_TERMS)
    flown = _fly(_ahead(), (still, still), 1, away_m=(60.0, 62.0), surface_mps=surface_mps)
    assert abs(flown.toe_over) < 3.0
    assert flown.knocks == 0


@pytest.mark.slow
@pytest.mark.parametrize("worse", [pytest.param(1.0, marks=pytest.mark.long), 3.0])
def test_lenses_that_are_worse_than_stated_leave_an_honest_toe_in_flight(worse: float) -> None:
    """Six calibrations as good as they say, and three times as bad: chi-square of the toe within 99.9 %, no knock."""
    airframe, flights = _ahead(), 6
    flown = [
        _fly(airframe, (old_lens(2 * seed, worse, airframe), old_lens(2 * seed + 1, worse, airframe)), seed)
        for seed in range(flights)
    ]
    assert sum(flight.knocks for flight in flown) == 0
    assert np.mean([flight.toe_over**2 for flight in flown]) < chi2.ppf(0.999, flights) / flights
    ratios = [flight.lens_ratio for flight in flown]
    assert (max(ratios) < 2.0) if worse == 1.0 else (np.median(ratios) > 2.0)
