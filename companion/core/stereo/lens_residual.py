"""Errors that a calibration leaves in the lenses of a pair, as smooth fields of ray slopes.

With the slopes ``r = (x, y)`` of a ray, the slopes that a calibrated lens gives are wrong by

    ``e(r) = kappa r + rho |r|^2 r + (t.r) r + s |r|^2``

``kappa`` is the relative error of the focal length, ``rho`` the error of the first radial term. ``t`` is the keystone
of a tilted image plane, ``s`` a thin prism (both named as in OpenCV's distortion models). An error of the direction in
which the middle of the image looks counts as a rotation of the camera. Then a principal point off by ``c`` (as a slope)
is ``t = -c``, and OpenCV's tangential distortion ``P = (p_2, p_1)`` is ``s = P`` and ``t = 2 P`` (Brown 1966). A
calibration separates keystone and prism better than principal point and tangential terms: correlations of their errors
are 0.2, not 0.9.

Across the epipolar lines ``t_x`` shows as ``t_x x y``, as a yaw does, and ``s_x`` does not show at all. So matches
cannot tell them from toe. They keep their prior (Schmidt's consider states, :data:`CONSIDERED`). The flow measures the
toe without ``t_x``, and separates the two: there only ``s_x`` is considered.

A pair shows the difference of its lenses. Of the errors that both lenses share three terms count, because near things
lie elsewhere in either image. At the disparity ``d`` the radial term leaves ``2 rho x y d`` across the lines, a yaw of
near things alone; it is considered too. Keystone leaves ``t_x y d``, as does a baseline that points ahead by ``t_x``
more than is believed. The flow runs through the left lens alone, which has the mean and half of the difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.stereo.exposure import CameraExposure
from companion.core.stereo.triangulation import Rays
from companion.params.airframe import Airframe, Camera
from companion.records import Floats

FOCAL, RADIAL, TILT_X, TILT_Y, PRISM_X, PRISM_Y = range(6)
"""Terms of one lens, and of the difference of two, left minus right."""
LENS_TERMS = 6
"""Terms of one lens (by definition)."""
RADIAL_MEAN, TILT_X_MEAN, TILT_Y_MEAN = range(6, 9)
"""Last terms of a pair: means over both lenses of the radial term and of the keystone."""
PAIR_TERMS = 9
"""Terms of a pair: the six of the difference, and three means (by definition)."""
CONSIDERED = (TILT_X, PRISM_X, RADIAL_MEAN)
"""Terms of a pair that matches do not estimate: they show as yaw, or not at all."""
CONSIDERED_IN_FLOW = (PRISM_X,)
"""Terms of a pair that the flow does not estimate either."""

OBSERVED = [FOCAL, RADIAL, TILT_X, TILT_Y, PRISM_Y, RADIAL_MEAN, TILT_X_MEAN, TILT_Y_MEAN]
"""Terms of a pair that matches or the flow estimate."""
_MEANS = [RADIAL, TILT_X, TILT_Y]  # terms of one lens whose means a pair has
_PRIOR_TERMS = 2.0  # weight of the prior of the ratio, in terms: half of those that matches alone estimate (choice)


@dataclass(frozen=True, slots=True, eq=False)
class LensAxes:
    """Axes of both lenses: the camera's axes, turned by quarter turns to be near the epipolar frame's.

    A bent wing turns a camera, and its lens with it. So a residual is a field of slopes in the camera's own axes, not
    in the frame's. The terms x and y are along these axes. ``left`` and ``right`` (3, 3) have the axes x, y, z as rows,
    in the frame of the rays.
    """

    left: Floats
    right: Floats

    @classmethod
    def exposed(cls, pair: tuple[CameraExposure, CameraExposure], epipolar_from_body: Floats) -> LensAxes:
        """Axes at both exposures, in body axes; ``epipolar_from_body`` (3, 3)."""
        left, right = (exposure.pose.camera_from_body for exposure in pair)
        return cls(*(quarter_turns(epipolar_from_body @ camera.T) @ camera for camera in (left, right)))

    def in_frame(self, frame_from_body: Floats) -> LensAxes:
        """The axes in another frame than body axes, ``frame_from_body`` (3, 3)."""
        return LensAxes(self.left @ frame_from_body.T, self.right @ frame_from_body.T)

    def turned(self, half: Floats) -> LensAxes:
        """The axes with the right camera turned by a rotation (3, 3), and the left one back by it."""
        return LensAxes(self.left @ half, self.right @ half.T)


def quarter_turns(turn: Floats) -> Floats:
    """The rotation (3, 3) by quarter turns that is nearest to a rotation (3, 3)."""
    nearest, rows = np.zeros((3, 3)), np.arange(3)
    columns = np.argmax(np.abs(turn), axis=1)
    nearest[rows, columns] = np.sign(turn[rows, columns])
    return nearest


def residual_field(x: Floats, y: Floats) -> Floats:
    """Error of the slopes (n, 2) per unit of each term, (n, 2, 6); slopes ``x``, ``y`` are (n,)."""
    r2 = x * x + y * y
    field: Floats = np.zeros((len(x), 2, 6))
    field[:, 0, 0], field[:, 1, 0] = x, y
    field[:, 0, 1], field[:, 1, 1] = x * r2, y * r2
    field[:, 0, 2], field[:, 1, 3] = x * x, y * y
    field[:, 0, 3] = field[:, 1, 2] = x * y
    field[:, 0, 4] = field[:, 1, 5] = r2
    return field


def left_fields(rays: Floats, quarter: Floats) -> Floats:
    """Error (n, 3, 3) of the left camera's rays (n, 3) of unit depth per unit of its radial term and both keystones.

    ``quarter`` (3, 3) are the quarter turns from the camera's axes, in which rays and errors are, to the epipolar
    frame's, in which keystones are.
    """
    x, y, _ = (rays @ quarter.T).T
    fields: Floats = quarter[:2].T @ residual_field(x, y)[:, :, _MEANS]
    return fields


def left_terms(terms: Floats) -> tuple[Floats, Floats]:
    """Radial term and keystones (3,) of the left lens, and their change (3, 9) per unit of the pair's terms (9,)."""
    per_term = 0.5 * np.eye(PAIR_TERMS)[_MEANS] + np.eye(PAIR_TERMS)[LENS_TERMS:]
    return per_term @ terms, per_term


def slope_errors(directions: Floats, axes: Floats) -> Floats:
    """Error (n, 2, 6) of the slopes of directions (n, 3) per unit of each term of the lens with these axes (3, 3)."""
    bent, z = _bent(directions, axes), directions[:, 2:, np.newaxis]
    return np.asarray((bent[:, :2] - directions[:, :2, np.newaxis] / z * bent[:, 2:]) / z)


def parallax_columns(left: Floats, right: Floats) -> Floats:
    """Parallax (n, 9) per unit of each term of the pair, of both lenses' errors (n, 6) across the lines."""
    return np.column_stack([0.5 * (left + right), (left - right)[:, _MEANS]])


def lens_ratio(terms: Floats, covariance: Floats, prior: Floats, believed: float = 1.0) -> float:
    """Ratio of the variance of this pair's lens residual to the stated one, at least 1, from the estimated terms.

    An old calibration is wrong in all its terms by one factor, also in those that do not show. Under the prior variance
    ``believed p``, of which matches have removed the share ``w``, a posterior mean ``m`` has the expectation
    ``E m^2 = p (w^2 ratio + w (1 - w) believed)``. The result is the mean of an inverse-gamma posterior whose prior has
    the mean 1 and the weight of :data:`_PRIOR_TERMS` terms.

    Parameters
    ----------
    terms, covariance : (9,), (9, 9) float64
        Posterior of the pair's terms.
    prior : (9,) float64
        Variances that the calibration states; a term whose variance is 0 is left out.
    believed : float
        Ratio that the prior had when the terms were estimated.

    Returns
    -------
    float
    """
    stated = [term for term in OBSERVED if prior[term] > 0.0]
    m, p, after = terms[stated], prior[stated], np.diag(covariance)[stated]
    w = np.clip(1.0 - after / (believed * p), 0.0, 1.0)
    excess = m**2 / p - believed * w * (1.0 - w)
    return float(max((_PRIOR_TERMS + excess.sum()) / (_PRIOR_TERMS + (w**2).sum()), 1.0))


def straightened(rays: Rays, residual: Floats, axes: LensAxes) -> Rays:
    """Rays with the residual (9,) of the pair taken out; half of the difference from each camera."""
    both = np.zeros(LENS_TERMS)
    both[_MEANS] = residual[LENS_TERMS:]
    half = 0.5 * residual[:LENS_TERMS]
    left = rays.left - _bent(rays.left, axes.left) @ (both + half)
    return Rays(rays.left_m, left, rays.right_m, rays.right - _bent(rays.right, axes.right) @ (both - half))


def pair_variances(airframe: Airframe) -> Floats:
    """Prior variances (9,) of the pair's terms, as if errors of the two lenses were independent.

    Those that ``calibrate stereo`` finds in one bundle go together: differences are overstated by it, and the mean of
    ``tilt_x`` is understated (README.md of :mod:`companion.calibration`).
    """
    difference = (np.stack([_sigmas(camera) for camera in airframe.camera_pair]) ** 2).sum(axis=0)
    return np.concatenate([difference, 0.25 * difference[_MEANS]])


def _sigmas(camera: Camera) -> Floats:
    """Sigma (6,) of each term of one lens."""
    tilt, prism = camera.tilt_sigma_rad, camera.prism_sigma
    return np.array([camera.focal_px.sigma / camera.focal_px.value, camera.radial_sigma, tilt, tilt, prism, prism])


def _bent(directions: Floats, axes: Floats) -> Floats:
    """Error (n, 3, 6) of directions (n, 3) per unit of each term of a lens; its axes (3, 3) are in the same frame."""
    x, y, z = axes @ directions.T
    bent: Floats = axes[:2].T @ (residual_field(x / z, y / z) * z[:, np.newaxis, np.newaxis])
    return bent
