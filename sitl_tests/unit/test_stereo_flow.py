"""Flow between two left images: its derivatives, a toe that it tells, a velocity that contradicts, turns, matching."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pytest

from companion.adapters.recordings.mcap.ros1_codec import pack, unpack
from companion.core.stereo.epipolar import EpipolarFilter, EpipolarUpdate, flow_innovation
from companion.core.stereo.epipolar_posterior import FlowConditions, Posterior, with_considered_states, with_flow
from companion.core.stereo.epipolar_states import (
    ALL_STATES,
    BASELINE,
    CONSIDERED_IN_FLOW_STATES,
    LENS,
    NO_BEND,
    SHIFT,
    TURN_RATE,
    VELOCITY,
    YAW,
    ExtrinsicsPrior,
    FastBelief,
)
from companion.core.stereo.flow import FlightBetween, FlowInnovation, FlowView
from companion.core.stereo.geometry import Pose, Rig
from companion.core.stereo.lens_residual import (
    PAIR_TERMS,
    RADIAL,
    RADIAL_MEAN,
    TILT_X,
    TILT_X_MEAN,
    TILT_Y,
    TILT_Y_MEAN,
    LensAxes,
)
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.core.stereo.triangulation import Rays
from companion.core.stereo.vehicle_motion import TurnTrack, VehicleTrack, turn_covariance
from companion.params.files import load_airframe
from companion.records import ClockName, Floats, Flow, MatchSet, VehicleState

_BASELINE_M, _SPEED_MPS, _PASSED_S, _NOISE_RAD = 2.0, 22.0, 0.15, 1.25e-4
_DOWN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # camera from body of a pair that looks down
_EPIPOLAR = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_MAY_BE_RAD, _MAY_BE_MPS = 2e-3, 0.3
_CONDITIONS = FlowConditions(_PASSED_S, np.zeros((3, 3)), NO_BEND)


def _view(
    toe_rad: float = 0.0,
    faster_mps: float = 0.0,
    noise_rad: float = 0.0,
    seed: int = 1,
    *,
    lenses: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    lower_m: float = 0.0,
    bank: float = 0.0,
) -> FlowView:
    """Ground 60 m below, seen twice; the cameras part by a toe, and fly faster, than is believed.

    ``lenses`` are terms of left and right lens that nobody knows; the right camera sits lower than believed, and the
    ground rises to the right by the slope ``bank``.
    """
    rng = np.random.default_rng(seed)
    turn_rad = np.array([0.02, -0.01, 0.015])
    points = np.column_stack([rng.uniform(-18, 18, 150), rng.uniform(-20, 20, 150), 60.0 + rng.uniform(-6, 6, 150)])
    points[:, 2] -= bank * points[:, 1]
    left_m, right_m = np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])
    half = np.array([0.0, 0.5 * toe_rad, 0.0]) @ _EPIPOLAR
    seen_left = _slopes((points - left_m) @ exp_rotation(half).T @ _DOWN.T, noise_rad, rng, _bent(lenses, 0))
    right_points = points - right_m - np.array([0.0, 0.0, lower_m])
    seen_right = _slopes(right_points @ exp_rotation(-half).T @ _DOWN.T, noise_rad, rng, _bent(lenses, 1))
    # the earlier body axes: those of the later ones turned back, and moved back along the path
    moved_m = np.array([_SPEED_MPS * _PASSED_S, 0.0, 0.0])
    true_moved_m = moved_m + np.array([faster_mps * _PASSED_S, 0.0, 0.0])
    before = points @ exp_rotation(turn_rad).T + true_moved_m
    seen_before = _slopes((before - left_m) @ exp_rotation(half).T @ _DOWN.T, noise_rad, rng, _bent(lenses, 0))
    pose, count = Pose(_DOWN, left_m), len(points)
    covariance = _MAY_BE_MPS**2 * np.eye(3)
    return FlowView(
        np.arange(count),
        Rays(np.tile(left_m, (count, 1)), seen_left @ _DOWN, np.tile(right_m, (count, 1)), seen_right @ _DOWN),
        np.full(count, np.sqrt(2.0) * _NOISE_RAD),
        seen_before,
        seen_left,
        np.full(count, _NOISE_RAD),
        pose,
        pose,
        FlightBetween(_PASSED_S, turn_rad, moved_m, covariance, np.zeros((3, 3))),
        _EPIPOLAR,
        LensAxes(_EPIPOLAR, _EPIPOLAR),
    )


def _bent(lenses: Mapping[str, tuple[float, float]], side: int) -> Floats:
    """Radial term and keystone x, y of one lens."""
    return np.array([lenses.get(name, (0.0, 0.0))[side] for name in ("radial", "keystone_x", "keystone_y")])


def _slopes(points: Floats, noise_rad: float, rng: np.random.Generator, lens: Floats) -> Floats:
    rays = points / points[:, 2:]
    x, y = rays[:, 0].copy(), rays[:, 1].copy()
    rays[:, :2] *= (1.0 + lens[0] * (x * x + y * y) + lens[1] * x + lens[2] * y)[:, np.newaxis]
    rays[:, :2] += noise_rad * rng.standard_normal((len(points), 2))
    return rays


@pytest.mark.slow
def test_at_the_truth_noise_pulls_at_no_state() -> None:
    """Errors in variables: rows at noisy depths and places pull at the lenses' terms in every pair.

    What noise and the same noise turned round pull together is a bias; over the root of a pair's information it is
    what a pair adds in sigmas. With the rows at the measured depths and places it is 0.067 (radial mean).
    """
    pulls, information = [], []
    for seed in range(100):
        exact, rng = _view(seed=seed), np.random.default_rng([seed, 0x5C])
        right, earlier = _NOISE_RAD * rng.standard_normal((2, len(exact.earlier), 2))
        both = [_noisy(exact, way * right, way * earlier) for way in (1.0, -1.0)]
        pulls.append(0.5 * sum(flow.columns.T @ (flow.residual_rad / flow.sigma_rad**2) for flow in both))
        information.append(((both[0].columns / both[0].sigma_rad[:, np.newaxis]) ** 2).sum(axis=0))
    observed = np.mean(information, axis=0) > 1e3  # per rad or m/s: a thousandth of what is known before
    bias = np.abs(np.mean(pulls, axis=0))[observed] / np.sqrt(np.mean(information, axis=0)[observed])
    assert bias.max() < 0.005


def _noisy(exact: FlowView, right: Floats, earlier: Floats) -> FlowInnovation:
    """Innovation at the truth with noise (n, 2) of slopes in the right image and in the earlier left one."""
    rays = dataclasses.replace(exact.rays, right=exact.rays.right + right @ _DOWN[:2])
    noisy = dataclasses.replace(exact, rays=rays, earlier=exact.earlier + np.pad(earlier, ((0, 0), (0, 1))))
    return noisy.innovation(np.zeros(3), np.zeros(PAIR_TERMS))


def _before(yaw_sigma_rad: float = _MAY_BE_RAD) -> Posterior:
    variances = np.zeros(ALL_STATES)
    variances[YAW] = yaw_sigma_rad**2
    variances[VELOCITY], variances[TURN_RATE] = _MAY_BE_MPS**2, 1e-8
    return Posterior(np.zeros(ALL_STATES), np.diag(variances), 1.0, 150, np.zeros(150, dtype=np.bool_))


def test_perfect_flow_leaves_nothing() -> None:
    """Poses, turn, path and depth of a point agree with where it was seen before."""
    answer = _view().innovation(np.zeros(3), np.zeros(PAIR_TERMS))
    assert np.abs(answer.residual_rad).max() < 1e-9


def test_cameras_that_have_flown_on_since_their_pose_leave_nothing() -> None:
    """Depths from the pose's place were off by the way flown, and the toe ahead by more than its sigma."""
    view, flown_m, level = _view(), np.array([0.06, 0.01, 0.3]), (np.zeros(3), np.zeros(PAIR_TERMS))
    rays = dataclasses.replace(view.rays, left_m=view.rays.left_m + flown_m, right_m=view.rays.right_m + flown_m)
    assert np.abs(dataclasses.replace(view, rays=rays).innovation(*level).residual_rad).max() < 1e-9


def test_what_is_known_of_velocity_and_turn_is_in_the_prediction() -> None:
    """A path told with 3 degrees of wrong heading, a turn told with a wrong bias: both known, nothing is left."""
    view, off_mps, off_rad = _view(), np.array([0.2, 1.1, -0.1]), np.array([4e-4, -2e-4, 3e-4])
    to_body = view.epipolar_from_body.T
    between = dataclasses.replace(
        view.between,
        moved_m=view.between.moved_m - _PASSED_S * (to_body @ off_mps),
        turn_rad=log_rotation(exp_rotation(-to_body @ off_rad) @ exp_rotation(view.between.turn_rad)),
    )
    told_view, level = dataclasses.replace(view, between=between), (np.zeros(3), np.zeros(PAIR_TERMS))
    assert np.abs(told_view.innovation(*level).residual_rad).max() > 1e-3
    assert np.abs(told_view.innovation(*level, off_mps, off_rad).residual_rad).max() < 1e-9


@pytest.mark.parametrize(
    ("bends", "difference", "mean"),
    [("radial", RADIAL, RADIAL_MEAN), ("keystone_x", TILT_X, TILT_X_MEAN), ("keystone_y", TILT_Y, TILT_Y_MEAN)],
)
def test_lens_terms_that_are_known_leave_nothing(bends: str, difference: int, mean: int) -> None:
    """The left lens bends both of its rays: a difference and a mean of 6 and 4 thousandths leave second order alone."""
    view, terms = _view(lenses={bends: (7e-3, 1e-3)}), np.zeros(PAIR_TERMS)
    left_as = view.innovation(np.zeros(3), terms).residual_rad
    terms[[difference, mean]] = 6e-3, 4e-3
    assert np.abs(view.innovation(np.zeros(3), terms).residual_rad).max() < 0.02 * np.abs(left_as).max()


def test_a_place_of_the_right_camera_that_is_known_leaves_nothing() -> None:
    """The right camera 40 mm lower: the baseline points down by 0.02."""
    view, level = _view(lower_m=0.04), (np.zeros(3), np.zeros(PAIR_TERMS), np.zeros(3), np.zeros(3))
    assert np.abs(view.innovation(*level).residual_rad).max() > 1e-4
    assert np.abs(view.innovation(*level, np.array([0.0, 0.02])).residual_rad).max() < 1e-7


@pytest.mark.parametrize("term", [RADIAL, TILT_X, TILT_Y, RADIAL_MEAN, TILT_X_MEAN, TILT_Y_MEAN])
def test_derivatives_by_lens_terms_are_those_of_differences(term: int) -> None:
    """Through the depth and through the left camera's own rays."""
    view, step = _view(), 1e-5 * np.eye(PAIR_TERMS)[term]
    none = np.zeros(PAIR_TERMS)
    base, moved = view.innovation(np.zeros(3), none), view.innovation(np.zeros(3), step)
    assert np.allclose((base.residual_rad - moved.residual_rad) / 1e-5, base.lens[:, term], atol=2e-4)


@pytest.mark.parametrize("axis", range(2))
def test_derivatives_by_the_baseline_are_those_of_differences(axis: int) -> None:
    """As those by turn and velocity."""
    view, level = _view(bank=0.3), (np.zeros(3), np.zeros(PAIR_TERMS), np.zeros(3), np.zeros(3))
    base, moved = view.innovation(*level), view.innovation(*level, 1e-5 * np.eye(2)[axis])
    assert np.allclose((base.residual_rad - moved.residual_rad) / 1e-5, base.baseline[:, axis], atol=2e-4)


def test_a_wing_whose_lift_is_unknown_bends_no_toe_in_a_bank() -> None:
    """A right tip 100 mm too low tilts the depths as a bank does: where nobody doubts its place, the toe is wrong."""
    errors = {}
    for sigma in (1e-3, 0.05):
        before = _before()
        before.covariance[SHIFT, SHIFT] = sigma**2 * np.eye(2)
        view = _view(lower_m=0.1, bank=0.35, noise_rad=_NOISE_RAD)
        baseline = np.zeros(2)
        innovation = view.innovation(np.zeros(3), np.zeros(PAIR_TERMS), np.zeros(3), np.zeros(3), baseline)
        answer = with_flow(before, innovation, _CONDITIONS)
        errors[sigma] = math.inf if answer is None else abs(answer.mean[YAW]) / math.sqrt(answer.covariance[YAW, YAW])
    assert errors[0.05] < 3.0 < errors[1e-3]


def test_the_filter_predicts_the_flow_with_the_velocity_that_it_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    """And with its turn in the time between the exposures."""
    view, asked = _view(), []
    filtered = EpipolarFilter(Rig.from_airframe(load_airframe("nadir-2m")), ExtrinsicsPrior())
    answer = _before()
    answer.mean[VELOCITY], answer.mean[TURN_RATE] = (0.2, 1.1, -0.1), (1e-3, 2e-3, 3e-3)
    answer.mean[BASELINE], answer.mean[SHIFT] = (1e-3, 2e-3), (3e-3, -1e-3)
    predict = FlowView.innovation

    def spied(self: FlowView, *states: Floats) -> FlowInnovation:
        asked.extend(states)
        return predict(self, *states)

    monkeypatch.setattr(FlowView, "innovation", spied)
    filtered._flown(answer, view, NO_BEND, 0)
    assert np.array_equal(asked[2], [0.2, 1.1, -0.1])
    assert np.allclose(asked[3], _PASSED_S * np.array([1e-3, 2e-3, 3e-3]))
    assert np.allclose(asked[4], [4e-3, 1e-3])


def test_doubt_of_the_calibration_ends_and_needs_features() -> None:
    """A velocity that is wrong from the start by a third contradicts every pair; one without features, none.

    A flow is refused from four sigma on: the calibration is doubted until that is ten of those stated, in steps of two
    in variance. Then as before nobody knows which of both is wrong.
    """
    filtered = EpipolarFilter(Rig.from_airframe(load_airframe("nadir-2m")), ExtrinsicsPrior())
    few = _view(faster_mps=8.0)
    few = dataclasses.replace(few, earlier=np.full_like(few.earlier, np.nan))
    filtered._flown(_before(1e-5), few, NO_BEND, 0)
    assert filtered.lens_ratio == 1.0
    contradictions = [filtered._flown(_before(1e-5), _view(faster_mps=8.0), NO_BEND, 0)[1] for _ in range(40)]
    assert (10.0 / 4.0) ** 2 <= filtered.lens_ratio < 2.0 * (10.0 / 4.0) ** 2
    assert contradictions == [True] * 40
    assert filtered.flow_left_aside


def test_few_features_are_no_contradiction_after_a_flow_that_agreed() -> None:
    """Right after a flow that was used, a wrong velocity is a contradiction, and a flow without features is not."""
    filtered = EpipolarFilter(Rig.from_airframe(load_airframe("nadir-2m")), ExtrinsicsPrior())
    _, contradicts = filtered._flown(_before(1e-5), _view(), NO_BEND, 0)
    assert not contradicts
    wrong = _view(faster_mps=8.0)
    few = dataclasses.replace(wrong, earlier=np.full_like(wrong.earlier, np.nan))
    assert filtered._flown(_before(1e-5), wrong, NO_BEND, 100_000_000)[1]
    assert not filtered._flown(_before(1e-5), few, NO_BEND, 100_000_000)[1]


@pytest.mark.parametrize("exposure", range(2))
def test_derivatives_by_the_stamps_are_those_of_a_flight_that_lasts_longer(exposure: int) -> None:
    """An exposure later than stamped: the flight to it is longer, that from it shorter, and so is the camera's turn.

    The way of a camera a metre off the axis of the turn, at 60 m, is left out.
    """
    view, rates = _view(), np.array([[0.2, -0.1, 0.05], [0.3, 0.1, -0.2]])
    view = dataclasses.replace(view, between=dataclasses.replace(view.between, camera_rates_radps=rates))
    later_s = 1e-6
    longer_s = later_s if exposure else -later_s
    between = dataclasses.replace(
        view.between,
        moved_m=view.between.moved_m * (1.0 + longer_s / _PASSED_S),
        turn_rad=log_rotation(exp_rotation(longer_s * rates[exposure]) @ exp_rotation(view.between.turn_rad)),
    )
    base, moved = (each.innovation(np.zeros(3), np.zeros(PAIR_TERMS))
                   for each in (view, dataclasses.replace(view, between=between)))  # fmt: skip
    assert np.allclose(
        (base.residual_rad - moved.residual_rad) / later_s,
        base.stamps[:, exposure],
        atol=np.linalg.norm(rates[exposure]) / 60.0,
    )


def test_a_stamp_that_may_be_wrong_leaves_the_toe_and_the_velocity_as_they_were() -> None:
    """A flight 15 ms longer than stamped: by stamps good to 0.1 ms a velocity or a toe, by a USB camera's neither."""
    view = _view()
    between = dataclasses.replace(view.between, moved_m=0.9 * view.between.moved_m)
    innovation = dataclasses.replace(view, between=between).innovation(np.zeros(3), np.zeros(PAIR_TERMS))
    assert with_flow(_before(), innovation, _CONDITIONS._replace(stamp_sigma_s=1e-4)) is None
    answer = with_flow(_before(), innovation, _CONDITIONS._replace(stamp_sigma_s=1e-2))
    assert answer is not None
    off = np.abs(answer.mean) / np.sqrt(np.maximum(np.diag(answer.covariance), 1e-20))
    assert off[YAW] < 1.5
    assert off[VELOCITY].max() < 1.5


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_by_turn_and_velocity_are_those_of_differences(axis: int) -> None:
    """The analytic rows are what a small change of turn and path makes of the prediction."""
    view, none = _view(), np.zeros(PAIR_TERMS)
    base, step = view.innovation(np.zeros(3), none), 1e-6
    unit = _EPIPOLAR.T @ np.eye(3)[axis]
    faster = dataclasses.replace(view.between, moved_m=view.between.moved_m + step * _PASSED_S * unit)
    moved = dataclasses.replace(view, between=faster).innovation(np.zeros(3), none)
    turned = log_rotation(exp_rotation(step * unit) @ exp_rotation(view.between.turn_rad))
    rolled = dataclasses.replace(view, between=dataclasses.replace(view.between, turn_rad=turned))
    after = rolled.innovation(np.zeros(3), none)
    # rows are along and across each feature's path, which a small change turns by next to nothing
    assert np.allclose((base.residual_rad - moved.residual_rad) / step, base.velocity[:, axis], atol=2e-5)
    assert np.allclose((base.residual_rad - after.residual_rad) / step, base.turn[:, axis], atol=2e-2)


def test_the_toe_is_found_within_what_the_velocity_leaves() -> None:
    """At 60 m a velocity known to 0.3 of 22 m/s leaves ``B/Z dv/v``, 0.45 mrad, of a toe of 2 mrad."""
    limit_rad = _BASELINE_M / 60.0 * _MAY_BE_MPS / _SPEED_MPS
    errors, stated = [], 0.0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        toe_rad, faster_mps = _MAY_BE_RAD * rng.standard_normal(), _MAY_BE_MPS * rng.standard_normal()
        view = _view(toe_rad, faster_mps, _NOISE_RAD, seed)
        answer = with_flow(_before(), view.innovation(np.zeros(3), np.zeros(PAIR_TERMS)), _CONDITIONS)
        assert answer is not None
        stated = float(np.sqrt(answer.covariance[YAW, YAW]))
        errors.append((answer.mean[YAW] - toe_rad) / stated)
    assert stated < 1.2 * limit_rad
    # mean of 40 squares of unit normals: 1 within three of their sigmas
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / 40.0))


def test_a_velocity_far_from_the_truth_is_not_believed() -> None:
    """3 m/s too slow would be 4 mrad of toe, which a toe known to 0.1 mrad contradicts."""
    view = _view(faster_mps=3.0, noise_rad=_NOISE_RAD)
    assert with_flow(_before(1e-4), view.innovation(np.zeros(3), np.zeros(PAIR_TERMS)), _CONDITIONS) is None


@pytest.mark.parametrize("yaw_sigma_rad", [5e-4, 1e-3])
def test_a_path_that_is_too_long_shows_in_the_velocity_and_is_doubted_or_refused(yaw_sigma_rad: float) -> None:
    """Exposures 14 ms late are 2 m/s, and move a yaw by two sigma to five of its posterior ones; 8 ms by three."""
    late, later = (
        with_flow(
            _before(yaw_sigma_rad),
            _view(faster_mps=faster_mps, noise_rad=_NOISE_RAD).innovation(np.zeros(3), np.zeros(PAIR_TERMS)),
            _CONDITIONS,
        )
        for faster_mps in (1.2, 2.0)
    )
    assert later is None
    assert late is not None
    assert abs(late.mean[YAW]) < 1.3 * np.sqrt(late.covariance[YAW, YAW])


def test_a_doubted_flow_leaves_a_covariance_that_is_positive() -> None:
    """The considered lens terms are put back as they were; the doubt must not stay in their cross-covariances."""
    before, (prism,) = _before(5e-4), CONSIDERED_IN_FLOW_STATES
    covariance = before.covariance.copy()
    covariance[LENS, LENS] = 1e-7 * np.eye(PAIR_TERMS)
    covariance[YAW, prism] = covariance[prism, YAW] = -0.99 * np.sqrt(covariance[YAW, YAW] * covariance[prism, prism])
    before = dataclasses.replace(before, covariance=covariance)
    innovation = _view(faster_mps=1.4, noise_rad=_NOISE_RAD).innovation(np.zeros(3), np.zeros(PAIR_TERMS))
    answer = with_flow(before, innovation, _CONDITIONS)
    assert answer is not None
    after = with_considered_states(answer, before.mean, before.covariance, CONSIDERED_IN_FLOW_STATES).covariance
    uncertain = np.flatnonzero(np.diag(after) > 0.0)
    sigma = np.sqrt(np.diag(after)[uncertain])
    assert np.linalg.eigvalsh(after[np.ix_(uncertain, uncertain)] / np.outer(sigma, sigma)).min() > 0.01


def test_mismatches_move_the_toe_by_less_than_its_sigma() -> None:
    """Features of which a tenth were found elsewhere tell the toe as the good ones do."""
    view = _view(1e-3, noise_rad=_NOISE_RAD)
    astray = view.earlier.copy()
    astray[::10, :2] += 0.004
    innovation = dataclasses.replace(view, earlier=astray).innovation(np.zeros(3), np.zeros(PAIR_TERMS))
    answer = with_flow(_before(), innovation, _CONDITIONS)
    assert answer is not None
    assert abs(answer.mean[YAW] - 1e-3) < 2.0 * np.sqrt(answer.covariance[YAW, YAW])


@pytest.mark.slow
def test_wrong_furrows_bias_neither_toe_nor_velocity() -> None:
    """A quarter of the matches 3 px beside the right furrow: over many pairs even a quarter of a sigma adds up."""
    over_sigma = []
    for seed in range(150):
        rng, view = np.random.default_rng(5000 + seed), _view(noise_rad=_NOISE_RAD, seed=seed)
        wrong, right = rng.random(len(view.sigma_rad)) < 0.25, view.rays.right.copy()
        right[wrong, 1] += rng.normal(0.0, 30.0 * _NOISE_RAD, int(wrong.sum()))
        view = dataclasses.replace(view, rays=dataclasses.replace(view.rays, right=right))
        answer = with_flow(_before(), view.innovation(np.zeros(3), np.zeros(PAIR_TERMS)), _CONDITIONS)
        assert answer is not None
        sigma = np.sqrt(np.diag(answer.covariance))
        over_sigma.append([answer.mean[k] / sigma[k] for k in (YAW, VELOCITY.start, VELOCITY.start + 1)])
    # means of 150 values that scatter by less than one: three of their sigmas
    assert np.all(np.abs(np.mean(over_sigma, axis=0)) < 3.0 * np.std(over_sigma, axis=0) / np.sqrt(150.0))


@pytest.mark.slow
def test_features_that_went_astray_pull_no_more_at_the_toe_than_noise_does() -> None:
    """A seventh of the features found 3 px beside in the earlier image, noise and errors also turned round.

    What both ways leave together is a bias, pair by pair the same: where each row was judged by itself, a tenth of a
    pair's sigma, which many pairs add up to more than one of theirs.
    """
    bias = np.mean([_bias_over_sigma(seed, 0.15) - _bias_over_sigma(seed, 0.0) for seed in range(60)])
    assert abs(bias) < 0.03


def _bias_over_sigma(seed: int, astray_ratio: float) -> float:
    """Half of the toes, over sigma, that noise and errors leave together with the same ones turned round."""
    exact, rng = _view(seed=seed), np.random.default_rng([seed, 0xA57])
    right, earlier = _NOISE_RAD * rng.standard_normal((2, len(exact.earlier), 2))
    error, astray = 30.0 * _NOISE_RAD * rng.standard_normal(earlier.shape), rng.random(len(earlier)) < astray_ratio
    earlier[astray] += error[astray]
    over_sigma = []
    for way in (1.0, -1.0):
        innovation = _noisy(exact, way * right, way * earlier)
        answer = with_flow(_before(), innovation, _CONDITIONS)
        assert answer is not None
        over_sigma.append(answer.mean[YAW] / math.sqrt(answer.covariance[YAW, YAW]))
    return 0.5 * math.fsum(over_sigma)


def _updated_with_ten_off_the_lines(view: FlowView, flow: FlowView) -> EpipolarUpdate:
    """A filter after the view's matches, each fifteenth of them off across its line, and a flow."""
    filtered = EpipolarFilter(Rig.from_airframe(load_airframe("nadir-2m")), ExtrinsicsPrior())
    rays = dataclasses.replace(view.rays, right=view.rays.right.copy())
    rays.right[::15, 0] += 50.0 * _NOISE_RAD
    update = filtered.update(rays, view.sigma_rad, FastBelief(np.zeros((3, 3))), 1, flow=flow)
    assert isinstance(update, EpipolarUpdate)
    return update


def test_a_match_that_is_off_across_the_lines_is_left_out_of_the_flow() -> None:
    """Ten matches 5 px beside their epipolar lines have wrong depths too: none of them tells the toe."""
    view = _view(noise_rad=_NOISE_RAD)
    update = _updated_with_ten_off_the_lines(view, view)
    assert 130 <= update.flow <= 140


def test_a_flow_of_which_every_feature_is_off_across_the_lines_tells_nothing() -> None:
    """Dirt on a lens is tracked perfectly, and matches nothing: the pair counts as without flow."""
    view = _view(noise_rad=_NOISE_RAD)
    outlier = np.zeros(len(view.sigma_rad), dtype=np.bool_)
    outlier[::15] = True
    assert _updated_with_ten_off_the_lines(view, view.without(~outlier)).flow == 0


def test_a_turn_is_integrated_where_rates_are_there() -> None:
    """Coning rates of 200 samples a second give the rotation that small steps compose to; a gap gives none."""
    track, t_ns = TurnTrack(), np.arange(0, 1_000_000_000, 5_000_000, dtype=np.int64)
    s = 1e-9 * t_ns
    rates = np.column_stack([0.5 * np.cos(6 * s), 0.5 * np.sin(6 * s), 0.2 * np.ones(len(s))])
    track.add(t_ns, rates)
    turn = track.between(102_000_000, 253_000_000)
    fine_s = 0.102 + 1e-4 * np.arange(1510)
    composed = np.eye(3)
    for t in fine_s:
        rate = np.array([0.5 * np.cos(6 * (t + 5e-5)), 0.5 * np.sin(6 * (t + 5e-5)), 0.2])
        composed = composed @ exp_rotation(1e-4 * rate)
    assert turn is not None
    assert np.allclose(turn, log_rotation(composed), atol=3e-5)
    assert track.between(900_000_000, 1_100_000_000) is None
    track.add(t_ns + 1_200_000_000, rates)
    assert track.between(900_000_000, 1_300_000_000) is None, "rates are missing for 0.2 s"


def test_a_gap_of_the_rates_counts_whole_where_a_turn_begins_or_ends_in_it() -> None:
    track, t_ns = TurnTrack(), np.arange(0, 1_000_000_000, 5_000_000, dtype=np.int64)
    sent = (t_ns <= 455_000_000) | (t_ns >= 545_000_000)
    track.add(t_ns[sent], np.zeros((int(sent.sum()), 3)))
    assert track.between(500_000_000, 700_000_000) is None
    assert track.between(300_000_000, 500_000_000) is None
    assert track.between(545_000_000, 700_000_000) is not None


def test_rates_whose_stamps_repeat_are_left_out_and_a_jump_of_stamps_heals() -> None:
    track, t_ns = TurnTrack(), np.arange(0, 1_000_000_000, 5_000_000, dtype=np.int64)
    rates = np.tile([0.0, 0.0, 0.1], (len(t_ns), 1))
    track.add(t_ns, rates)
    for _ in range(1000):
        track.add(t_ns, 5.0 * rates)
    turn = track.between(100_000_000, 300_000_000)
    assert turn is not None
    assert np.allclose(turn, [0.0, 0.0, 0.02], atol=1e-9)
    track.add(np.array([10**15], dtype=np.int64), rates[:1])
    for k in range(1, 20):
        track.add(t_ns + k * 1_000_000_000, rates)
    turn = track.between(18_100_000_000, 18_300_000_000)
    assert turn is not None
    assert np.allclose(turn, [0.0, 0.0, 0.02], atol=1e-9)
    assert track.between(100_000_000, 300_000_000) is None, "only the last seconds are kept"


@pytest.mark.parametrize("field", ["residual_rad", "sigma_rad", "rotation", "lens", "turn", "velocity"])
def test_a_row_that_is_not_finite_is_left_out_and_too_few_rows_tell_nothing(field: str) -> None:
    innovation = _view(1e-3, noise_rad=_NOISE_RAD).innovation(np.zeros(3), np.zeros(PAIR_TERMS))
    values = getattr(innovation, field).copy()
    values[:6] = np.nan
    answer = with_flow(_before(), dataclasses.replace(innovation, **{field: values}), _CONDITIONS)
    assert answer is not None
    assert np.isfinite(answer.mean).all()
    assert answer.flow == (len(innovation.sigma_rad) - 6) // 2
    values[20:] = np.nan
    assert with_flow(_before(), dataclasses.replace(innovation, **{field: values}), _CONDITIONS) is None


def _state(k: int, velocity: tuple[float, float, float] | None) -> VehicleState:
    heading = (np.pi - 0.01 + 0.01 * k + np.pi) % (2.0 * np.pi) - np.pi
    at_ns = k * 100_000_000
    return VehicleState(at_ns, at_ns, 0.0, 0.0, heading, 20.0, 0.0, 0.6, True, False, velocity)


def test_velocity_over_ground_is_turned_into_body_axes() -> None:
    """South at a heading of south is ahead, also where the heading steps from +pi to -pi; without it air tells."""
    over, air = VehicleTrack(), VehicleTrack()
    for k in range(4):
        over.add(_state(k, (-18.0, 0.0, 1.0)))
        air.add(_state(k, None if k == 2 else (-18.0, 0.0, 1.0)))
    motion = over.motion(100_000_000)
    assert motion.over_ground
    assert np.allclose(motion.velocity_mps, [18.0, 0.0, 1.0], atol=1e-6)
    assert np.sqrt(motion.covariance[0, 0]) == pytest.approx(0.3)
    assert not air.motion(100_000_000).over_ground
    assert air.motion(100_000_000).velocity_mps[0] == pytest.approx(20.0)


@pytest.mark.parametrize(("stated_mps", "sigma_mps"), [(None, 0.3), (0.15, 0.15), (0.8, 0.8), (0.02, 0.1)])
def test_the_receivers_accuracy_is_believed_down_to_a_tenth(stated_mps: float | None, sigma_mps: float) -> None:
    """The less accurate of the two states around an instant counts."""
    track = VehicleTrack()
    for k in range(4):
        stated = 0.05 if k == 2 and stated_mps is not None else stated_mps
        track.add(dataclasses.replace(_state(k, (-18.0, 0.0, 0.0)), velocity_sigma_mps=stated))
    assert np.sqrt(track.motion(150_000_000).covariance[0, 0]) == pytest.approx(sigma_mps)


@pytest.mark.parametrize(("stated_mps", "sigma_mps"), [(1.5, 1.5), (0.15, 0.3)])
def test_an_accuracy_that_is_lost_makes_the_velocity_no_better(stated_mps: float, sigma_mps: float) -> None:
    """Neither at once nor later; the next statement counts again."""
    track = VehicleTrack()
    for k, stated in enumerate((stated_mps, None, None, None, 0.2, 0.2)):
        track.add(dataclasses.replace(_state(k, (-18.0, 0.0, 0.0)), velocity_sigma_mps=stated))
    for at_ns in (150_000_000, 250_000_000):
        assert np.sqrt(track.motion(at_ns).covariance[0, 0]) == pytest.approx(sigma_mps)
    assert np.sqrt(track.motion(450_000_000).covariance[0, 0]) == pytest.approx(0.2)


@pytest.mark.parametrize("count", [0, 3])
def test_a_recording_keeps_the_flow_to_the_bit(count: int) -> None:
    """The flow in a pair's matches is read as it was written; so is its absence."""
    px = np.random.default_rng(5).uniform(0, 600, (4, 2))
    host = (ClockName.HOST, ClockName.HOST)
    without = MatchSet(7, 8, host, np.array([1, 2]), 3, 0, px, px + 0.1, np.full(4, 0.02), 9)
    flow = Flow(6, np.arange(count), px[:count] - 40.3, np.full(count, 0.019))
    assert unpack(MatchSet, pack(without)).flow is None
    read = unpack(MatchSet, pack(dataclasses.replace(without, flow=flow))).flow
    assert read.earlier_pair_id == 6
    for name in ("index", "earlier_px", "sigma_px"):
        assert np.array_equal(getattr(read, name), getattr(flow, name))


def test_a_turns_covariance_is_that_of_scale_axes_and_noise() -> None:
    """Against 20,000 drawn gyros, whose variances are known to 1 %: three sigma."""
    gyro = dataclasses.replace(load_airframe("nadir-2m").root, gyro_noise_radps_rthz=2e-4)
    rng, turn = np.random.default_rng(3), np.array([0.03, -0.01, 0.02])
    scale = gyro.gyro_scale_sigma * rng.standard_normal((20_000, 3)) * turn
    axes = np.cross(gyro.misalignment_sigma_rad * rng.standard_normal((20_000, 3)), turn)
    noise = np.sqrt(0.5 * _PASSED_S) * gyro.gyro_noise_radps_rthz * rng.standard_normal((20_000, 3))
    drawn = np.cov((scale + axes + noise).T)
    assert turn_covariance(turn, _PASSED_S, gyro) == pytest.approx(drawn, rel=0.05, abs=0.03 * float(np.trace(drawn)))


def test_a_gyro_that_states_neither_scale_nor_axes_is_believed_to_a_percent() -> None:
    """The default of both is 0, which no gyro has: a turn of 0.03 rad is then 0.3 mrad wrong about every axis."""
    root = load_airframe("nadir-2m").root
    unstated = dataclasses.replace(root, gyro_scale_sigma=0.0, misalignment_sigma_rad=0.0, gyro_noise_radps_rthz=0.0)
    sigma_rad = np.sqrt(np.diag(turn_covariance(np.array([0.03, 0.0, 0.0]), _PASSED_S, unstated)))
    assert sigma_rad == pytest.approx([3e-4, 3e-4, 3e-4])
    stated = dataclasses.replace(unstated, gyro_scale_sigma=0.001, misalignment_sigma_rad=0.002)
    sigma_rad = np.sqrt(np.diag(turn_covariance(np.array([0.03, 0.0, 0.0]), _PASSED_S, stated)))
    assert sigma_rad == pytest.approx([3e-5, 6e-5, 6e-5])


def test_the_flow_of_a_steady_flight_tells_more_than_that_of_a_roll() -> None:
    """With the velocity known to 0.01 m/s the turn counts: a gyro right to a percent leaves 0.3 mrad of 0.03 rad."""
    gyro = dataclasses.replace(load_airframe("nadir-2m").root, gyro_scale_sigma=0.01)
    before, innovation = _before(), _view(noise_rad=_NOISE_RAD).innovation(np.zeros(3), np.zeros(PAIR_TERMS))
    before.covariance[VELOCITY, VELOCITY] = 1e-4 * np.eye(3)
    sigma_rad = []
    for rolled_rad in (0.0, 0.03):
        turned = turn_covariance(np.array([rolled_rad, rolled_rad, 0.0]), _PASSED_S, gyro)
        answer = with_flow(before, innovation, _CONDITIONS._replace(turn_covariance=turned))
        assert answer is not None
        sigma_rad.append(float(np.sqrt(answer.covariance[YAW, YAW])))
    assert sigma_rad[0] < 0.6 * sigma_rad[1]


@pytest.mark.parametrize("rolled_rad", [-0.08, 0.05, 0.1])
@pytest.mark.parametrize("axis", range(3))
def test_a_tip_that_turned_far_more_than_tracked_tells_no_false_toe(rolled_rad: float, axis: int) -> None:
    """Half the square of a turn shortens all slopes, whichever way it goes: linear about none, pairs add that up."""
    exact = _view()
    unit = _EPIPOLAR.T @ np.eye(3)[axis]
    tracked = log_rotation(exp_rotation(rolled_rad * unit) @ exp_rotation(exact.between.turn_rad))
    between = dataclasses.replace(exact.between, turn_rad=tracked, turn_covariance=0.1**2 * np.outer(unit, unit))
    view = dataclasses.replace(exact, between=between)
    before, conditions = _before(), _CONDITIONS._replace(turn_covariance=view.turn_covariance)
    answer = with_flow(before, flow_innovation(before, view, conditions), conditions)
    assert answer is not None
    # a twentieth of a pair's sigma, as noise pulls at no state by more
    assert abs(answer.mean[YAW]) < 0.05 * math.sqrt(answer.covariance[YAW, YAW])
