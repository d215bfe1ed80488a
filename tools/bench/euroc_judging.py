"""Judges estimates of the flexed EuRoC pairs: against the known rotation, on features that no estimate has used.

What is tuned is tuned on the first pairs of the sequence, and judged on the others under other rotations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.stereo.epipolar import EpipolarFilter
from companion.core.stereo.epipolar_geometry import epipolar_frame, in_frame
from companion.core.stereo.epipolar_states import PARALLAX_STATES as _STATES
from companion.core.stereo.epipolar_states import ExtrinsicsPrior, FastBelief
from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import exp_rotation, log_rotation
from tools.bench.euroc_flexing import FAST_SIGMA_RAD, FlexedPair, rays_of

# a rigid bar holds EuRoC's cameras; its calibration says nothing of its own sigmas, this is usual for a good one
_BASELINE_RAD = 0.0005
TUNED = 15  # pairs, of 40
_UNKNOWN_FAST_RAD = 0.005
METHODS = ("modal", "epipolar", "both")


@dataclass(frozen=True)
class Verdict:
    """Errors (n, 3) in pitch, yaw, roll, rad, and the filter's own sigmas (n, 3)."""

    error_rad: np.ndarray
    sigma_rad: np.ndarray


def tuned_prior(rig: Rig, pairs: list[FlexedPair]) -> ExtrinsicsPrior:
    """The one thing that is learned: what these matches scatter beyond their stated sigmas, about each pair's fit."""
    excess = []
    for pair in pairs:
        every = np.ones(len(pair.matches), dtype=bool)
        stated = float(np.median(pair.matches.sigma_px)) / rig.right.lens.focal_px
        excess.append(noise_rad(rig, pair, every) ** 2 - stated**2)
    return ExtrinsicsPrior(baseline_rad=_BASELINE_RAD, parallax_rad=float(np.sqrt(max(np.median(excess), 0.0))))


def split(pairs: list[FlexedPair], seed: int = 5) -> list[np.ndarray]:
    """For each pair, which matches the estimate may use; the others judge it."""
    random = np.random.default_rng(seed)
    return [random.random(len(pair.matches)) < 0.5 for pair in pairs]


def estimate(rig: Rig, pairs: list[FlexedPair], used: list[np.ndarray], method: str, prior: ExtrinsicsPrior) -> Verdict:
    """Error of the total rotation of every pair, estimated by one of three methods; no held-out match is touched."""
    epipolar_from_camera = epipolar_frame(rig) @ rig.right.rest.camera_from_body.T
    running = EpipolarFilter(rig, prior)
    errors, sigmas = [], []
    for pair, in_fit in zip(pairs, used, strict=True):
        fast = np.zeros(3) if method == "epipolar" else pair.fast_known_rad
        fast_sigma = _UNKNOWN_FAST_RAD if method == "epipolar" else FAST_SIGMA_RAD
        correction, sigma = np.zeros(3), np.full(3, np.hypot(prior.rotation_rad, FAST_SIGMA_RAD))
        if method != "modal":
            estimator = EpipolarFilter(rig, prior) if method == "epipolar" else running
            rays = rays_of(rig, pair.matches, fast, in_fit)
            sigma_rad = pair.matches.sigma_px[in_fit] / rig.right.lens.focal_px
            update = estimator.update(rays, sigma_rad, FastBelief(fast_sigma**2 * np.eye(3)), pair.t_ns)
            assert not isinstance(update, str), update
            correction, sigma = update.total_rad, np.sqrt(np.diag(update.total_covariance))
        believed = exp_rotation(epipolar_from_camera.T @ correction) @ exp_rotation(fast)
        errors.append(epipolar_from_camera @ log_rotation(believed @ exp_rotation(pair.total_rad).T))
        sigmas.append(sigma)
    return Verdict(np.array(errors), np.array(sigmas))


def own_design(rig: Rig, pair: FlexedPair, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parallax (n,) under the true applied rotation, and its design (n, 14), written down here once more.

    Columns: pitch, yaw, roll, baseline y and z; focal length, radial term, keystone x and y, prism x and y by which the
    lenses differ, and the radial term and keystone x and y that both have wrong.
    """
    rays = in_frame(rays_of(rig, pair.matches, pair.total_rad, chosen), epipolar_frame(rig))
    left, right = rays.left / rays.left[:, 2:], rays.right / rays.right[:, 2:]
    x, y, d = right[:, 0], 0.5 * (left[:, 1] + right[:, 1]), left[:, 0] - right[:, 0]
    x_mid, square = 0.5 * (left[:, 0] + right[:, 0]), (left[:, :2] ** 2).sum(axis=1) + (right[:, :2] ** 2).sum(axis=1)
    cubic = [slopes[:, 1] * (slopes[:, :2] ** 2).sum(axis=1) for slopes in (left, right)]
    lens = [y, y * square / 2, x_mid * y, y * y, 0 * y, square / 2, cubic[0] - cubic[1]]
    lens += [left[:, 0] * left[:, 1] - right[:, 0] * right[:, 1], left[:, 1] ** 2 - right[:, 1] ** 2]
    design = np.column_stack([-(1 + y * y), x * y, x, d, -y * d, *lens])
    return left[:, 1] - right[:, 1], design


def inliers(parallax: np.ndarray) -> np.ndarray:
    """Matches that are no blunders: within four robust sigmas of the rest."""
    off = np.abs(parallax - np.median(parallax))
    return off < 4 * 1.4826 * np.median(off)


def calibration_error(rig: Rig, pairs: list[FlexedPair], used: list[np.ndarray], belief: ExtrinsicsPrior) -> np.ndarray:
    """Constant relative rotation (3,) by which the published calibration is off: all held-out matches together."""
    rows = [own_design(rig, pair, ~in_fit) for pair, in_fit in zip(pairs, used, strict=True)]
    parallax, design = np.concatenate([p for p, _ in rows]), np.concatenate([h for _, h in rows])
    good = inliers(parallax)
    prior = np.diag(1.0 / np.sqrt(belief.variances()))
    sigma = 1.4826 * np.median(np.abs(parallax[good] - np.median(parallax[good])))
    stacked = np.vstack([design[good] / sigma, prior])
    fitted, *_ = np.linalg.lstsq(stacked, np.concatenate([parallax[good] / sigma, np.zeros(_STATES)]), rcond=None)
    return fitted[:3]


def noise_rad(rig: Rig, pair: FlexedPair, chosen: np.ndarray) -> float:
    """Sigma of one parallax about its own best fit, robust."""
    parallax, design = own_design(rig, pair, chosen)
    good = inliers(parallax)
    fitted, *_ = np.linalg.lstsq(design[good][:, :3], parallax[good], rcond=None)
    left_over = parallax[good] - design[good][:, :3] @ fitted
    return float(1.4826 * np.median(np.abs(left_over)))


def cramer_rao(
    rig: Rig, pairs: list[FlexedPair], used: list[np.ndarray], fast_sigma_rad: float | None, prior: ExtrinsicsPrior
) -> np.ndarray:
    """Sigma (n, 3) that nobody can beat with these matches: lenses and baseline unknown within their priors.

    With ``fast_sigma_rad`` the slow part is followed from pair to pair and the fast part is known to that; without,
    every pair stands alone.
    """
    walk = np.zeros(_STATES)
    walk[:3] = prior.walk_rad_rts**2
    information = np.diag(1.0 / prior.variances())
    bounds, last_ns = [], pairs[0].t_ns
    for pair, in_fit in zip(pairs, used, strict=True):
        parallax, design = own_design(rig, pair, in_fit)
        design = design[inliers(parallax)] / noise_rad(rig, pair, in_fit)
        if fast_sigma_rad is None:
            alone = np.linalg.inv(np.diag(1.0 / prior.variances()) + design.T @ design)
            bounds.append(np.sqrt(np.diag(alone)[:3]))
            continue
        predicted = np.linalg.inv(information) + np.diag(walk) * 1e-9 * (pair.t_ns - last_ns)
        joint = np.zeros((_STATES + 3, _STATES + 3))
        joint[:_STATES, :_STATES], joint[_STATES:, _STATES:] = (predicted, fast_sigma_rad**2 * np.eye(3))
        rows = np.hstack([design, design[:, :3]])
        posterior = np.linalg.inv(np.linalg.inv(joint) + rows.T @ rows)
        add = np.hstack([np.eye(3), np.zeros((3, _STATES - 3)), np.eye(3)])
        bounds.append(np.sqrt(np.diag(add @ posterior @ add.T)))
        information, last_ns = np.linalg.inv(posterior[:_STATES, :_STATES]), pair.t_ns
    return np.array(bounds)
