"""Error budget of a range: numerical gradients by extrinsics, lenses and stamps, times their covariances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.stereo.exposure import CameraExposure, TipMotion, tip_signs
from companion.core.stereo.geometry import Rig
from companion.core.stereo.lens_residual import PAIR_TERMS, LensAxes, straightened
from companion.core.stereo.rotation import skew
from companion.core.stereo.triangulation import Rays
from companion.core.stereo.vehicle_motion import VehicleMotion
from companion.params.airframe import Airframe
from companion.records import Deflection, Floats, Side

_STEP_RAD = 1e-6  # step of the difference quotient (numerical)
_STEP_M = 1e-5  # step of the difference quotient (numerical)
_STEP_RELATIVE = 1e-6  # step of the difference quotient (numerical)
# modal coordinates and antisymmetric slope, from [q symmetric, q antisymmetric, slope left, slope right], and back
_ANTISYMMETRIC_FROM_TIPS = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -0.5, 0.5]])
_TIPS_FROM_ANTISYMMETRIC = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Gradient:
    """Change of one result per small change of each camera, body axes; rows are left and right.

    Attributes
    ----------
    turn_prad : (2, 3) float64
        Change per radian of rotation of the camera.
    shift_pm : (2, 3) float64
        Change per metre of displacement of the camera.
    focal : (2,) float64
        Change per relative change of the focal length.
    lens : (9,) float64
        Change per unit of each term that is taken out of the lens residual in excess.
    """

    turn_prad: Floats
    shift_pm: Floats
    focal: Floats
    lens: Floats


@dataclass(frozen=True, slots=True)
class Budget:
    """One-sigma of a result by cause, in the unit of the result."""

    modal: float
    calibration: float
    timing: float

    def times(self, factor: float) -> Budget:
        """Budget of the result times a factor."""
        return Budget(self.modal * factor, self.calibration * factor, self.timing * factor)

    @property
    def total(self) -> float:
        """Root of the sum of squares; the causes are independent."""
        return float(np.sqrt(self.modal**2 + self.calibration**2 + self.timing**2))


def gradient_of(
    inverse_depths: Callable[[Rays], Floats],
    weights: Floats,
    rays: Rays,
    exposures: tuple[CameraExposure, CameraExposure],
    epipolar_from_body: Floats,
) -> Gradient:
    """Differentiate ``weights @ inverse_depths(rays)`` numerically, all cameras and axes in one evaluation.

    Parameters
    ----------
    inverse_depths : callable
        Gives inverse depths (m,), 1/m, of m matched rays, each independent of the others.
    weights : (n,) float64
        Weights of the result.
    rays : Rays
        n matched rays.
    exposures : tuple
        Left and right exposure, for the cameras' axes.
    epipolar_from_body : (3, 3) float64
        Rotation to the frame of the lens terms.
    """
    changed = [rays]
    for side in Side:
        origin, direction = (rays.left_m, rays.left) if side is Side.LEFT else (rays.right_m, rays.right)
        look = exposures[side].pose.camera_from_body[2]
        changed += [_with(rays, side, origin, direction @ (np.eye(3) + _STEP_RAD * skew(e)).T) for e in np.eye(3)]
        changed += [_with(rays, side, origin + _STEP_M * e, direction) for e in np.eye(3)]
        # a longer focal length makes every ray flatter: its part across the optical axis shrinks
        flat = direction - (direction @ look)[:, np.newaxis] * look
        changed.append(_with(rays, side, origin, direction - _STEP_RELATIVE * flat))
    axes = LensAxes.exposed(exposures, epipolar_from_body)
    changed += [straightened(rays, _STEP_RELATIVE * term, axes) for term in np.eye(PAIR_TERMS)]
    stacked = Rays.stacked(changed)
    results = np.nan_to_num(inverse_depths(stacked)).reshape(len(changed), -1) @ weights
    changes = results[1:] - results[0]
    steps, lens = changes[:-PAIR_TERMS].reshape(2, 7), changes[-PAIR_TERMS:]
    return Gradient(
        steps[:, :3] / _STEP_RAD, steps[:, 3:6] / _STEP_M, steps[:, 6] / _STEP_RELATIVE, lens / _STEP_RELATIVE
    )


def toe_gradient(epipolar_y: Floats) -> Gradient:
    """Gradient of the relative toe: the angle by which the optical axes diverge in the epipolar plane.

    ``epipolar_y`` (3,) is a unit vector.

    A camera turned by ``r`` turns its axis toward the right wing by ``r . y``, with ``y = z cross x``, x along the
    baseline and z the viewing direction.
    """
    return Gradient(np.stack([-epipolar_y, epipolar_y]), np.zeros((2, 3)), np.zeros(2), np.zeros(PAIR_TERMS))


def budget(
    gradient: Gradient,
    rig: Rig,
    airframe: Airframe,
    bend: Deflection,
    exposures: tuple[CameraExposure, CameraExposure],
    timing_sigma_s: float,
    motion: VehicleMotion,
    apart: Floats | None = None,
) -> Budget:
    """Sigma of a result by cause.

    The two exposures are so near each other that one error of the modal state acts at both. So modal errors are
    propagated jointly. Errors of calibration and stamps are independent for the two cameras. ``motion`` is the flight
    between the exposures: errors of the velocity and of the stamps displace the cameras.

    ``apart`` (12, 12), body axes, is the joint covariance of the cameras' relative rotation and of the lens residual
    (:class:`companion.core.stereo.extrinsics_drift.ExtrinsicsDriftFilter`). With it, of the other causes only those
    count that both cameras share.
    """
    modal = modal_gradient(gradient, rig, TipMotion.from_airframe(airframe))
    block = np.ix_([0, 1, 4, 5], [0, 1, 4, 5])
    tips = bend.covariance[block]
    if apart is None:
        variance = float(modal @ tips @ modal)
        calibration, timing = _of_each_camera(gradient, airframe, exposures, timing_sigma_s)
    else:
        modal = modal @ _TIPS_FROM_ANTISYMMETRIC.T
        apart_gradient = np.concatenate(
            [0.5 * (gradient.turn_prad[Side.RIGHT] - gradient.turn_prad[Side.LEFT]), gradient.lens]
        )
        variance = float(
            modal @ (_ANTISYMMETRIC_FROM_TIPS @ tips @ _ANTISYMMETRIC_FROM_TIPS.T) @ modal
            + apart_gradient @ apart @ apart_gradient
        )
        calibration, timing = _of_both_cameras(gradient, airframe, exposures, timing_sigma_s)
    alike = gradient.turn_prad[Side.RIGHT] + gradient.turn_prad[Side.LEFT]
    calibration += airframe.pair_sigma_rad**2 * float(alike @ alike)
    timing += _flight_variance(gradient, exposures, timing_sigma_s, motion)
    return Budget(float(np.sqrt(max(variance, 0.0))), float(np.sqrt(calibration)), float(np.sqrt(timing)))


def _of_each_camera(
    gradient: Gradient, airframe: Airframe, exposures: tuple[CameraExposure, CameraExposure], timing_sigma_s: float
) -> tuple[float, float]:
    """Variances by calibration and by stamps, independent for each camera."""
    calibration = timing = 0.0
    for side in Side:
        camera, moving = airframe.camera_pair[side], exposures[side]
        relative_focal = camera.focal_px.sigma / camera.focal_px.value
        calibration += camera.rotation_sigma_rad**2 * float(gradient.turn_prad[side] @ gradient.turn_prad[side])
        calibration += (relative_focal * float(gradient.focal[side])) ** 2
        rate = gradient.turn_prad[side] @ moving.rate_radps + gradient.shift_pm[side] @ moving.velocity_mps
        timing += (timing_sigma_s * float(rate)) ** 2
    return calibration, timing


def _of_both_cameras(
    gradient: Gradient, airframe: Airframe, exposures: tuple[CameraExposure, CameraExposure], timing_sigma_s: float
) -> tuple[float, float]:
    """Variances by calibration and by stamps that both cameras share; matches measure the differences."""
    alike = gradient.turn_prad[Side.RIGHT] + gradient.turn_prad[Side.LEFT]
    calibration = timing = 0.0
    for side in Side:
        camera = airframe.camera_pair[side]
        relative_focal = camera.focal_px.sigma / camera.focal_px.value
        calibration += (0.5 * camera.rotation_sigma_rad) ** 2 * float(alike @ alike)
        calibration += (0.5 * relative_focal * float(gradient.focal.sum())) ** 2
        timing += (timing_sigma_s * float(gradient.shift_pm[side] @ exposures[side].velocity_mps)) ** 2
    return calibration, timing


def _flight_variance(
    gradient: Gradient, exposures: tuple[CameraExposure, CameraExposure], timing_sigma_s: float, motion: VehicleMotion
) -> float:
    """Variance of a result by the velocity's error, which both cameras share, and by stamps of flying cameras."""
    shared = sum(exposures[side].after_s * gradient.shift_pm[side] for side in Side)
    stamps = timing_sigma_s * (gradient.shift_pm @ motion.velocity_mps)
    return float(shared @ motion.covariance @ shared + stamps @ stamps)


def modal_gradient(gradient: Gradient, rig: Rig, tips: TipMotion) -> Floats:
    """Change (4,) of the result per m of symmetric and antisymmetric coordinate, per rad of left and right slope."""
    change = np.zeros(4)
    for side in Side:
        camera, signs = rig.camera(side), tip_signs(side)
        change[2 + side] = gradient.turn_prad[side] @ camera.turn_rad(1.0)
        per_metre = gradient.turn_prad[side] @ camera.turn_rad(0.0, 1.0) * signs * tips.twist_radpm
        change[:2] += per_metre - gradient.shift_pm[side, 2] * camera.lift_gain * signs
    return change


def _with(rays: Rays, side: Side, origin: Floats, direction: Floats) -> Rays:
    if side is Side.LEFT:
        return Rays(origin, direction, rays.right_m, rays.right)
    return Rays(rays.left_m, rays.left, origin, direction)
