"""The epipolar filter against rays of known geometry: finds a rotation, knows what it cannot see, fades outliers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.stereo.consistency_gate import KNOCK_RAD, MatchVerdict
from companion.core.stereo.epipolar import EpipolarFilter, EpipolarUpdate
from companion.core.stereo.epipolar_geometry import epipolar_frame, in_frame, parallax
from companion.core.stereo.epipolar_states import LENS, PARALLAX_STATES, VELOCITY, ExtrinsicsPrior, FastBelief
from companion.core.stereo.exposure import rest_exposures
from companion.core.stereo.geometry import Rig
from companion.core.stereo.lens_residual import (
    FOCAL,
    PAIR_TERMS,
    PRISM_X,
    PRISM_Y,
    RADIAL,
    TILT_X,
    TILT_Y,
    LensAxes,
    straightened,
)
from companion.core.stereo.rotation import exp_rotation
from companion.core.stereo.triangulation import Rays
from companion.params.files import load_airframe
from companion.records import Reject

FOCAL_PX = 800.0
NOISE_RAD = 0.1 / FOCAL_PX
EXACT_LENSES = {"lens": (1e-9,) * PAIR_TERMS, "parallax_rad": 1e-9}


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.from_airframe(load_airframe("nadir-2m"))


def _rays(
    rig: Rig,
    turn_rad: np.ndarray,
    seed: int,
    n: int = 150,
    depths_m: tuple[float, float] = (20.0, 80.0),
    noise_rad: float = NOISE_RAD,
) -> Rays:
    """Rays as believed; each camera is really turned by half of ``turn_rad`` (epipolar frame), as wings do."""
    random = np.random.default_rng(seed)
    frame = epipolar_frame(rig)
    left = np.column_stack([random.uniform(-0.35, 0.35, n), random.uniform(-0.28, 0.28, n), np.ones(n)])
    points = rig.left.rest.position_body_m + (left * random.uniform(*depths_m, (n, 1))) @ frame
    where, believed = np.ones((n, 1)), []
    for camera, half_rad in ((rig.left, -0.5 * turn_rad), (rig.right, 0.5 * turn_rad)):
        rest = camera.rest
        really = rest.camera_from_body @ exp_rotation(-frame.T @ half_rad)
        directions = (points - rest.position_body_m) @ really.T
        directions = directions / directions[:, 2:]
        if camera is rig.right:
            directions[:, :2] += noise_rad * random.standard_normal((n, 2))
        believed += [where * rest.position_body_m, directions @ rest.camera_from_body]
    return Rays(*believed)


def _update(rig: Rig, rays: Rays, prior: ExtrinsicsPrior, fast_rad: float = 1e-9) -> EpipolarUpdate:
    sigma = np.full(len(rays.left), NOISE_RAD)
    answer = EpipolarFilter(rig, prior).update(rays, sigma, FastBelief(fast_rad**2 * np.eye(3)), 0)
    assert isinstance(answer, EpipolarUpdate)
    return answer


def test_a_rotation_of_several_milliradians_is_found_within_its_sigma(rig: Rig) -> None:
    squares = []
    for seed in range(40):
        true = np.random.default_rng(1000 + seed).normal(0.0, 0.004, 3)
        estimate = _update(rig, _rays(rig, true, seed), ExtrinsicsPrior(baseline_rad=1e-9, **EXACT_LENSES))
        error = estimate.slow_rad - true
        squares.append(float(error @ np.linalg.solve(estimate.slow_covariance, error)))
        assert np.abs(error[[0, 2]]).max() < 1e-4
    # chi-square with 3 degrees of freedom, 40 draws: mean 3, standard deviation 0.39
    assert 3 - 4 * 0.39 < np.mean(squares) < 3 + 4 * 0.39 + 0.5


def test_yaw_is_weak_by_the_factor_that_geometry_gives_and_the_filter_knows_it(rig: Rig) -> None:
    """Uniform x in +-a, y in +-b: the parallax of yaw is x y, so its sigma is noise / sqrt(n a^2 b^2 / 9)."""
    n = 400
    estimate = _update(
        rig,
        _rays(rig, np.zeros(3), 3, n=n, depths_m=(400.0, 500.0)),
        ExtrinsicsPrior(baseline_rad=1e-9, **EXACT_LENSES),
    )
    sigma = np.sqrt(np.diag(estimate.slow_covariance))
    scaled = NOISE_RAD * estimate.parallax_scale
    assert sigma[1] == pytest.approx(scaled * 3.0 / (0.35 * 0.28 * np.sqrt(n)), rel=0.12)
    assert sigma[0] == pytest.approx(scaled / np.sqrt(n), rel=0.12)
    assert sigma[2] == pytest.approx(scaled * np.sqrt(3.0) / (0.35 * np.sqrt(n)), rel=0.12)


def test_an_unknown_baseline_counts_as_far_as_there_is_disparity(rig: Rig) -> None:
    """At one depth a baseline turned by b is a pitch of b times the disparity B/Z: no match can tell the two apart."""
    depth_m, baseline_rad = 175.0, 0.005  # small: y^2 in the pitch column tells a large one apart
    rays = _rays(rig, np.zeros(3), 4, depths_m=(depth_m, depth_m))
    exact = _update(rig, rays, ExtrinsicsPrior(baseline_rad=1e-9, **EXACT_LENSES))
    unknown = _update(rig, rays, ExtrinsicsPrior(baseline_rad=baseline_rad, **EXACT_LENSES))
    added = np.sqrt(unknown.slow_covariance[0, 0] - exact.slow_covariance[0, 0])
    assert added == pytest.approx(baseline_rad * rig.baseline_m / depth_m, rel=0.05)
    assert unknown.slow_covariance[2, 2] == pytest.approx(exact.slow_covariance[2, 2], rel=0.02)


def test_a_bend_of_many_milliradians_is_not_shrunk(rig: Rig) -> None:
    """Both wings bend: were the whole turn the right camera's, the baseline would seem to turn by half of it."""
    true, errors = np.array([0.0, 0.04, 0.0]), []
    for seed in range(20):
        update = _update(rig, _rays(rig, true, seed), ExtrinsicsPrior(0.04, baseline_rad=1e-9, **EXACT_LENSES))
        errors.append((update.slow_rad - true)[1] / np.sqrt(update.slow_covariance[1, 1]))
    assert abs(np.mean(errors)) < 4.0 / np.sqrt(len(errors))
    assert np.mean(np.square(errors)) < 2.0


def test_a_third_of_wrong_matches_hardly_matters(rig: Rig) -> None:
    true = np.array([0.002, -0.003, 0.004])
    rays = _rays(rig, true, 6)
    spoiled = rays.right.copy()
    spoiled[:50] += np.random.default_rng(7).normal(0.0, 0.004, (50, 3))
    prior = ExtrinsicsPrior(baseline_rad=1e-9, **EXACT_LENSES)
    estimate = _update(rig, Rays(rays.left_m, rays.left, rays.right_m, spoiled), prior)
    error = np.abs(estimate.slow_rad - true)
    assert np.all(error < 5.0 * np.sqrt(np.diag(estimate.slow_covariance)))
    assert estimate.used < 125


@pytest.mark.parametrize("outliers", [0.05, 0.25])
def test_the_sigma_of_a_rotation_is_right_beside_gross_outliers(rig: Rig, outliers: float) -> None:
    """Squares of pitch and roll over their sigmas: mean 1, standard deviation sqrt(2 / (2 n)) in n pairs."""
    n, squares, exact = 300, [], ExtrinsicsPrior(baseline_rad=1e-9, **EXACT_LENSES)
    for seed in range(n):
        rays, random = _rays(rig, np.zeros(3), seed), np.random.default_rng(9000 + seed)
        spoiled = rays.right.copy()
        spoiled[:, :2] += (random.random((150, 1)) < outliers) * random.normal(0.0, 30 * NOISE_RAD, (150, 2))
        update = _update(rig, Rays(rays.left_m, rays.left, rays.right_m, spoiled), exact)
        squares += (update.slow_rad[[0, 2]] ** 2 / np.diag(update.slow_covariance)[[0, 2]]).tolist()
    assert np.mean(squares) == pytest.approx(1.0, abs=4.0 / np.sqrt(n))


def test_slow_and_fast_part_are_told_apart_by_time(rig: Rig) -> None:
    """A constant 3 mrad under a fast part that is known to 0.5 mrad only: 100 pairs find the constant."""
    random, tracker = (
        np.random.default_rng(8),
        EpipolarFilter(rig, ExtrinsicsPrior(walk_rad_rts=1e-5, baseline_rad=1e-9, lens=EXACT_LENSES["lens"])),
    )
    slow, first = np.array([0.003, -0.003, 0.001]), None
    for k in range(100):
        fast_error = random.normal(0.0, 5e-4, 3)
        rays = _rays(rig, slow + fast_error, 100 + k)
        update = tracker.update(rays, np.full(150, NOISE_RAD), FastBelief(25e-8 * np.eye(3)), k * 100_000_000)
        assert isinstance(update, EpipolarUpdate)
        first = first or update
        assert abs(update.total_rad[0] - slow[0] - fast_error[0]) < 2e-4
    sigma = np.sqrt(np.diag(update.slow_covariance))
    assert np.all(sigma < 0.25 * np.sqrt(np.diag(first.slow_covariance)))
    assert np.all(np.abs(update.slow_rad - slow) < 4.0 * sigma)


@pytest.mark.slow
def test_a_fast_error_with_memory_is_not_averaged_away(rig: Rig) -> None:
    """Yaw that wanders by 0.5 mrad within a second: its sigma is right in 12 flights of 3 s, ten pairs a second."""
    time_s, fast_rad, ratios = 1.0, 5e-4, []
    for flight in range(12):
        random, tracker = np.random.default_rng(flight), EpipolarFilter(rig, ExtrinsicsPrior(**EXACT_LENSES))
        error, keep = random.normal(0.0, fast_rad, 3), np.exp(-0.1 / time_s)
        for k in range(30):
            rays = _rays(rig, error, 1000 * flight + k)
            belief = FastBelief(fast_rad**2 * np.eye(3), time_s)
            update = tracker.update(rays, np.full(150, NOISE_RAD), belief, k * 100_000_000)
            assert isinstance(update, EpipolarUpdate)
            ratios.append((update.total_rad - error)[1] / np.sqrt(update.total_covariance[1, 1]))
            error = keep * error + random.normal(0.0, fast_rad * np.sqrt(1.0 - keep**2), 3)
    assert 0.6 < np.mean(np.square(ratios)) < 1.5


def _axes(rig: Rig) -> LensAxes:
    """Lens axes of both cameras at rest, epipolar frame."""
    frame = epipolar_frame(rig)
    return LensAxes.exposed(rest_exposures(rig), frame).in_frame(frame)


def _flown_on(rays: Rays, ahead_m: float) -> Rays:
    """The same rays, of a right camera that exposes later and so sees the same from farther ahead, along y."""
    return dataclasses.replace(rays, right_m=rays.right_m + np.array([0.0, ahead_m, 0.0]))


@pytest.mark.parametrize("ahead_m", [0.0, 0.2])
def test_the_design_is_the_derivative_of_the_parallax(rig: Rig, ahead_m: float) -> None:
    rays = in_frame(_rays(rig, np.array([0.003, 0.002, -0.004]), 9), epipolar_frame(rig))
    rays, axes = _flown_on(rays, ahead_m), _axes(rig)
    at = np.array([1e-3, -2e-3, 3e-3, 1e-3, 2e-3, 1e-3, 2e-3, 1e-3, -1e-3, 1e-3, 2e-3, 1e-3, -2e-3, 1e-3])
    _, design = parallax(rays, axes, at)
    for column, step in enumerate(1e-6 * np.eye(PARALLAX_STATES)):
        slope = (parallax(rays, axes, at - step)[0] - parallax(rays, axes, at + step)[0]) / 2e-6
        # the design leaves out what is second order in the state: a few mrad times the column itself
        assert np.abs(slope - design[:, column]).max() < 0.01


@pytest.mark.parametrize("term", [FOCAL, RADIAL, TILT_X, TILT_Y, PRISM_X, PRISM_Y])
def test_a_lens_shows_across_the_lines_of_cameras_that_expose_at_two_instants(rig: Rig, term: int) -> None:
    """10 ms at 20 m/s tilt the baseline by 0.1 rad: slopes x show across the lines by a tenth, lens errors in them too.

    Without that the toe of a flight was 0.2 mrad off beside a focal difference of 1e-3. Here lenses that are wrong by
    2e-3, taken out by the equation, leave what taking them out of the rays leaves: errors of second order.
    """
    axes, state, ahead_m = _axes(rig), np.zeros(PARALLAX_STATES), 0.2
    exact = in_frame(_rays(rig, np.zeros(3), 9, noise_rad=0.0), epipolar_frame(rig))
    points = exact.left_m + exact.left * 60.0
    later = _flown_on(exact, ahead_m)
    later = dataclasses.replace(later, left=points - later.left_m, right=points - later.right_m)
    terms = 2e-3 * np.eye(PAIR_TERMS)[term]
    state[LENS] = terms
    wrong = straightened(later, -terms, axes)
    assert np.abs(parallax(wrong, axes, np.zeros(PARALLAX_STATES))[0]).max() > 1e-5
    assert np.abs(parallax(wrong, axes, state)[0]).max() < 2e-6


def test_at_the_truth_noise_pulls_at_no_state(rig: Rig) -> None:
    """Errors in variables: columns at the noisy rays pull at the radial mean and the focal difference in every pair.

    What noise and the same noise turned round pull together is a bias; over the root of a pair's information it is
    what a pair adds in sigmas. With the columns at the measured rays it is 0.058 (radial mean).
    """
    frame, axes, zero = epipolar_frame(rig), _axes(rig), np.zeros(PARALLAX_STATES)
    pulls, information = [], []
    for seed in range(100):
        rays = in_frame(_rays(rig, np.zeros(3), seed, noise_rad=0.0), frame)
        noise = np.random.default_rng([seed, 0x5C]).normal(0.0, NOISE_RAD, (len(rays.right), 2))
        noise = np.column_stack([noise, np.zeros(len(noise))])
        both = [parallax(dataclasses.replace(rays, right=rays.right + way * noise), axes, zero) for way in (1.0, -1.0)]
        pulls.append(0.5 * sum(design.T @ residual_rad for residual_rad, design in both) / NOISE_RAD**2)
        information.append((both[0][1] ** 2).sum(axis=0) / NOISE_RAD**2)
    observed = np.mean(information, axis=0) > 1e3  # per rad or m/s: a thousandth of what is known before
    bias = np.abs(np.mean(pulls, axis=0))[observed] / np.sqrt(np.mean(information, axis=0)[observed])
    assert bias.max() < 0.002


def test_turning_the_rays_back_leaves_no_parallax(rig: Rig) -> None:
    true = np.array([0.002, -0.003, 0.004])
    rays = in_frame(_rays(rig, true, 10), epipolar_frame(rig))
    turned = dataclasses.replace(rays, right=rays.right @ exp_rotation(true).T)
    left_over, _ = parallax(turned, _axes(rig), np.zeros(PARALLAX_STATES))
    assert np.std(left_over) < 1.2 * NOISE_RAD


def test_it_refuses_and_forgets_nothing(rig: Rig) -> None:
    tracker = EpipolarFilter(rig, ExtrinsicsPrior())
    rays, sigma, still = _rays(rig, np.full(3, 0.002), 11), np.full(150, NOISE_RAD), FastBelief(1e-8 * np.eye(3))
    tracker.update(rays, sigma, still, 1_000)
    before = tracker.predict(1_000)[0]
    few = Rays(rays.left_m[:5], rays.left[:5], rays.right_m[:5], rays.right[:5])
    assert tracker.update(few, sigma[:5], still, 2_000) is Reject.NO_MATCHES
    assert tracker.update(rays, sigma, still, 999) is Reject.TIME_BACKWARDS
    broken = Rays(rays.left_m, rays.left * np.nan, rays.right_m, rays.right)
    assert tracker.update(broken, sigma, still, 2_000) is Reject.NOT_FINITE
    assert np.array_equal(tracker.predict(1_000)[0], before)


def test_belief_grows_wider_while_nothing_is_seen(rig: Rig) -> None:
    """An Ornstein-Uhlenbeck process: ``P(t) = V + (P(0) - V) exp(-2 t / T)``, ``T = 2 V / walk^2``."""
    prior = ExtrinsicsPrior(walk_rad_rts=1e-3, rotation_rad=0.005)
    tracker = EpipolarFilter(rig, prior)
    tracker.update(_rays(rig, np.zeros(3), 12), np.full(150, NOISE_RAD), FastBelief(1e-8 * np.eye(3)), 0)
    now, soon, late = (np.diag(tracker.predict(t_ns)[1])[:3] for t_ns in (0, 4_000_000_000, 10**13))
    assert prior.time_s == pytest.approx(50.0)
    assert np.allclose(soon, 25e-6 + (now - 25e-6) * np.exp(-8.0 / 50.0), rtol=1e-9)
    assert np.allclose(late, 25e-6, rtol=1e-9)


def test_a_rotation_without_a_sigma_stays_and_a_doubt_of_it_too(rig: Rig) -> None:
    """Cameras whose file says that nothing turns them: no time heals a knock, the matches do."""
    tracker = EpipolarFilter(rig, ExtrinsicsPrior(rotation_rad=0.0))
    rays, sigma, still = _rays(rig, np.zeros(3), 12), np.full(150, NOISE_RAD), FastBelief(np.zeros((3, 3)))
    for t_ns in (0, 100_000_000):
        assert isinstance(tracker.update(rays, sigma, still, t_ns), EpipolarUpdate)
    assert np.all(np.diag(tracker.predict(10**13)[1])[:3] < 1e-16)
    tracker.reopen()
    assert np.allclose(np.diag(tracker.predict(10**13)[1])[:3], KNOCK_RAD**2)


def test_a_flight_that_is_not_known_at_all_leaves_the_rotation(rig: Rig) -> None:
    """Hostile speeds once told 25 baselines flown between the exposures, along one line: the prior was singular."""
    flown = 600.0 * np.array([[0.004, 0.063], [0.063, 0.996]])
    sigma = np.full(150, NOISE_RAD)
    update = EpipolarFilter(rig, ExtrinsicsPrior()).update(
        _rays(rig, np.zeros(3), 3), sigma, FastBelief(np.zeros((3, 3))), 0, shift_covariance=flown
    )
    assert isinstance(update, EpipolarUpdate)
    assert np.all(np.isfinite(update.total_covariance))


def test_a_knock_forgets_the_velocity_that_was_learned_beside_the_wrong_rotation(rig: Rig) -> None:
    """The flow teaches velocity and toe together: what it taught beside a rotation that was wrong is wrong too."""
    tracker = EpipolarFilter(rig, ExtrinsicsPrior(0.001, baseline_rad=1e-9, **EXACT_LENSES))
    prior_m2ps2, sigma = 0.3**2 * np.eye(3), np.full(150, NOISE_RAD)
    tracker._velocity_covariance = prior_m2ps2
    tracker._covariance[VELOCITY, VELOCITY], tracker._mean[VELOCITY] = 0.01**2 * np.eye(3), 1.0
    for k in range(3):  # so many outliers in a row are a turned camera
        assert np.diag(tracker._covariance)[VELOCITY].max() < 0.2**2
        update = tracker.update(
            _rays(rig, np.array([0.03, 0.0, 0.0]), k), sigma, FastBelief(1e-18 * np.eye(3)), k * 100
        )
        assert isinstance(update, EpipolarUpdate)
    assert update.verdict is MatchVerdict.KNOCKED
    assert np.allclose(tracker._covariance[VELOCITY, VELOCITY], prior_m2ps2, rtol=1e-6)
    assert np.allclose(tracker._mean[VELOCITY], 0.0)
