"""Errors that a calibration leaves in the lenses of a pair, as smooth fields of ray slopes.

With the slopes ``r = (x, y)`` of a ray, the slopes that a calibrated lens gives are wrong by

    ``e(r) = kappa r + rho |r|^2 r + (t.r) r + s |r|^2``

``kappa`` is the focal length's relative error, ``rho`` the first radial term's. ``t`` is the keystone of a tilted image
plane, ``s`` a thin prism (both named as in OpenCV's distortion models). The direction in which the middle of the image
looks counts as the camera's rotation. Then a principal point off by ``c`` (as a slope) is ``t = -c``, and OpenCV's
tangential distortion ``P = (p_2, p_1)`` is ``s = P`` and ``t = 2 P`` (Brown 1966). These two fields, and not principal
point and tangential terms, are what a calibration tells apart: correlations of their errors are 0.2, not 0.9.

Across the epipolar lines ``t_x`` shows as ``t_x x y``, which is just how a yaw shows, and ``s_x`` not at all: no number
of matches tells them from toe. They are carried with their prior (Schmidt's consider states, :data:`CONSIDERED`). The
flow tells the toe without ``t_x``, and so the two apart: there only the rest is considered.

A pair sees the difference of its lenses. Of what both have wrong alike two terms count, for near things lie
elsewhere in either image: the radial one leaves ``2 rho x y d`` across the lines at the disparity ``d``, a yaw of near
things alone, which is considered too; keystone leaves ``t_x y d``, just what a baseline leaves that points ahead by
``t_x`` more than believed.
"""

from __future__ import annotations

import numpy as np

from companion.core.stereo.triangulation import Rays
from companion.params.airframe import Airframe, Camera
from companion.records import Floats

FOCAL, RADIAL, TILT_X, TILT_Y, PRISM_X, PRISM_Y = range(6)
"""Terms of one lens, and of the difference of two, left minus right."""
LENS_TERMS = 6
"""Terms of one lens."""
RADIAL_MEAN = 6
"""Last term of a pair: mean of the two radial terms."""
PAIR_TERMS = 7
"""Terms of a pair: the six of the difference, and the mean of the radial ones."""
CONSIDERED = (TILT_X, PRISM_X, RADIAL_MEAN)
"""Terms of a pair that matches never move: what shows of them shows as yaw."""
CONSIDERED_IN_FLOW = (PRISM_X,)
"""Terms of a pair that the flow never moves either."""

OBSERVED = [FOCAL, RADIAL, TILT_X, TILT_Y, PRISM_Y, RADIAL_MEAN]
"""Terms of a pair that matches show, or the flow."""
_PRIOR_TERMS = 2.0  # chosen: half of the terms that matches alone show


def residual_field(x: Floats, y: Floats) -> Floats:
    """Error of the slopes (n, 2) per unit of each term, (n, 2, 6); slopes ``x``, ``y`` are (n,)."""
    r2, none = x * x + y * y, np.zeros_like(x)
    along = [x, x * r2, x * x, x * y, r2, none]
    across = [y, y * r2, x * y, y * y, none, r2]
    return np.stack([np.stack(along, axis=-1), np.stack(across, axis=-1)], axis=1)


def radial_field(rays: Floats) -> Floats:
    """Error (n, 3) of rays (n, 3) of unit depth per unit of the radial term of their lens; 0 along the axis."""
    x, y = rays[:, 0], rays[:, 1]
    along, across = residual_field(x, y)[:, :, RADIAL].T
    return np.stack([along, across, np.zeros_like(x)], axis=1)


def left_radial(terms: Floats) -> tuple[float, Floats]:
    """Radial term of the left lens, and its change (7,) per unit of each of the pair's terms (7,)."""
    per_term = np.zeros(PAIR_TERMS)
    per_term[RADIAL], per_term[RADIAL_MEAN] = 0.5, 1.0
    return float(per_term @ terms), per_term


def parallax_columns(left: Floats, right: Floats) -> Floats:
    """Parallax (n, 7) that a unit of each term of the pair leaves; slopes (n, 2) of matched rays."""
    across_left, across_right = (residual_field(*slopes.T)[:, 1] for slopes in (left, right))
    radial = across_left[:, RADIAL] - across_right[:, RADIAL]
    return np.column_stack([0.5 * (across_left + across_right), radial])


def lens_ratio(terms: Floats, covariance: Floats, prior: Floats, believed: float = 1.0) -> float:
    """Variance of this pair's lens residual over its prior's, at least 1, as the terms that matches show tell it.

    A calibration that is old is so in all its terms: those that never show are as wrong as those that do. Under the
    prior variance ``believed p``, of which matches have taken away the share ``w``, a posterior mean ``m`` has the
    expectation ``E m^2 = p (w^2 ratio + w (1 - w) believed)``. The answer is the mean of an inverse-gamma posterior
    whose prior has a mean of one and weighs as much as :data:`_PRIOR_TERMS` terms that have shown.

    Parameters
    ----------
    terms, covariance : (7,), (7, 7) float64
        Posterior of the pair's terms.
    prior : (7,) float64
        Variances that the calibration states.
    believed : float
        Ratio under whose prior the terms were estimated.

    Returns
    -------
    float
    """
    m, p, after = terms[OBSERVED], prior[OBSERVED], np.diag(covariance)[OBSERVED]
    w = np.clip(1.0 - after / (believed * p), 0.0, 1.0)
    excess = m**2 / p - believed * w * (1.0 - w)
    return float(max((_PRIOR_TERMS + excess.sum()) / (_PRIOR_TERMS + (w**2).sum()), 1.0))


def straightened(rays: Rays, residual: Floats, epipolar_from_body: Floats) -> Rays:
    """Rays in body axes with the residual (7,) of the pair taken out; half of the difference from each camera.

    Terms are those of the epipolar frame, which every camera's axes are close to, or turned from by quarter turns.
    """
    both = np.zeros(LENS_TERMS)
    both[RADIAL] = residual[RADIAL_MEAN]
    half = 0.5 * residual[:LENS_TERMS]
    left = _corrected(rays.left, both + half, epipolar_from_body)
    return Rays(rays.left_m, left, rays.right_m, _corrected(rays.right, both - half, epipolar_from_body))


def pair_variances(airframe: Airframe) -> Floats:
    """Prior variances (7,) of the pair's terms: the cameras are calibrated with errors of their own."""
    cameras = [camera for camera in (airframe.left_camera, airframe.right_camera) if camera is not None]
    difference = (np.stack([_sigmas(camera) for camera in cameras]) ** 2).sum(axis=0)
    return np.append(difference, 0.25 * difference[RADIAL])


def mean_tilt_variance(airframe: Airframe) -> float:
    """Prior variance of the mean of both lenses' keystone, rad^2."""
    return 0.25 * float(pair_variances(airframe)[TILT_X])


def _sigmas(camera: Camera) -> Floats:
    """Sigma (6,) of each term of one lens."""
    tilt, prism = camera.tilt_sigma_rad, camera.prism_sigma
    return np.array([camera.focal_px.sigma / camera.focal_px.value, camera.radial_sigma, tilt, tilt, prism, prism])


def _corrected(directions: Floats, residual: Floats, epipolar_from_body: Floats) -> Floats:
    """Directions (n, 3), body axes, less a residual (6,) of their slopes in the epipolar frame."""
    inside = directions @ epipolar_from_body.T
    wrong = residual_field(inside[:, 0] / inside[:, 2], inside[:, 1] / inside[:, 2]) @ residual
    return np.asarray(directions - (inside[:, 2:] * wrong) @ epipolar_from_body[:2], dtype=np.float64)
