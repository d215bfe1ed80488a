"""Pose and rates of each camera while it exposed: wing bend, rigid motion between the exposures, rolling shutter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.stereo.geometry import MountedCamera, Pose, Rig
from companion.core.stereo.rotation import exp_rotation
from companion.params.airframe import Airframe
from companion.records import Deflection, Floats, Side


@dataclass(frozen=True, slots=True, eq=False)
class CameraExposure:
    """One camera's exposure, in the body axes of the instant midway between the two exposures.

    Attributes
    ----------
    pose : Pose
        At the camera's own mid-exposure.
    rate_radps : (3,) float64
        Rate of turn of the camera: rigid body rate and bending of the wing.
    velocity_mps : (3,) float64
        Velocity of the camera by the rigid body rate alone (rate x place).
    after_s : float
        Time of the mid-exposure after the instant midway, s.
    path_mps : (3,) float64
        Velocity of the camera by flight and the wing's lift, which moves it from row to row of a rolling shutter.
    """

    pose: Pose
    rate_radps: Floats
    velocity_mps: Floats
    after_s: float = 0.0
    path_mps: Floats = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class TipMotion:
    """Slope and twist of a tip per metre of modal coordinate, from the airframe file.

    ``slope_radpm`` and ``twist_radpm`` are (2,), for the symmetric and antisymmetric coordinate.
    """

    slope_radpm: Floats
    twist_radpm: Floats

    @classmethod
    def from_airframe(cls, airframe: Airframe) -> TipMotion:
        """Take the first modes' factors."""
        modes = (airframe.wing.symmetric, airframe.wing.antisymmetric)
        return cls(
            np.array([mode.slope_factor_radpm.value for mode in modes]),
            np.array([mode.twist_factor_radpm.value for mode in modes]),
        )


def tip_signs(side: Side) -> Floats:
    """Signs (2,) of symmetric and antisymmetric coordinate at a tip: left is their difference, right their sum."""
    return np.array([1.0, -1.0 if side is Side.LEFT else 1.0])


def exposures(
    rig: Rig, tips: TipMotion, left: Deflection, right: Deflection, velocity_mps: Floats | None = None
) -> tuple[CameraExposure, CameraExposure]:
    """Both exposures, each at its own instant, brought to the body axes midway between them.

    Parameters
    ----------
    rig : Rig
        The cameras.
    tips : TipMotion
        The airframe's slope and twist factors.
    left, right : Deflection
        The wing at the left and at the right mid-exposure.
    velocity_mps : (3,) float64, optional
        The aircraft's velocity in body axes, which moves the cameras between the two exposures and from row to row.
    """
    middle_ns = (left.t_host_ns + right.t_host_ns) // 2
    drift = np.zeros(3) if velocity_mps is None else velocity_mps
    return (
        _exposure(rig.left, tips, left, 1e-9 * (left.t_host_ns - middle_ns), drift),
        _exposure(rig.right, tips, right, 1e-9 * (right.t_host_ns - middle_ns), drift),
    )


def with_relative_rotation(
    pair: tuple[CameraExposure, CameraExposure], rotation_rad: Floats
) -> tuple[CameraExposure, CameraExposure]:
    """Both exposures with the cameras turned against each other by a small rotation vector (3,), body axes.

    The right camera takes half of it and the left one the opposite half, as bending of both wings does. The mean
    viewing direction stays.
    """
    halves = (-0.5 * rotation_rad, 0.5 * rotation_rad)
    left, right = (
        replace(
            exposure, pose=Pose(exposure.pose.camera_from_body @ exp_rotation(-half), exposure.pose.position_body_m)
        )
        for exposure, half in zip(pair, halves, strict=True)
    )
    return left, right


def rest_exposures(rig: Rig) -> tuple[CameraExposure, CameraExposure]:
    """Exposures of the ground calibration: both cameras at rest, no bend and no motion."""
    still = np.zeros(3)
    return CameraExposure(rig.left.rest, still, still), CameraExposure(rig.right.rest, still, still)


def bent_pose(camera: MountedCamera, tips: TipMotion, bend: Deflection) -> Pose:
    """Pose of a camera on the bent wing, in the body axes of that instant."""
    signs = tip_signs(camera.side)
    return camera.pose(
        float(bend.slope_rad[camera.side]), float(signs @ bend.q_m), float((signs * tips.twist_radpm) @ bend.q_m)
    )


def slope_change_sigma_rad(earlier: Deflection, later: Deflection, side: Side) -> float:
    """One-sigma error of the tracked change of a tip's slope between two instants, rad.

    Besides the slow error that both tips share, the tip's error is a process of first order with the tracker's
    correlation time. A lasting difference between the tips counts as fast, on the safe side.
    """
    variances = [
        max(float(b.covariance[4 + side, 4 + side]) - b.slow_slope_sigma_rad**2, 0.0) for b in (earlier, later)
    ]
    time_s = 0.5 * (earlier.fast_slope_time_s + later.fast_slope_time_s)
    passed_s = 1e-9 * (later.t_host_ns - earlier.t_host_ns)
    correlation = math.exp(-passed_s / time_s) if time_s > 0.0 else 0.0
    return math.sqrt(sum(variances) - 2.0 * correlation * math.sqrt(variances[0] * variances[1]))


def _exposure(
    camera: MountedCamera, tips: TipMotion, bend: Deflection, after_s: float, drift_mps: Floats
) -> CameraExposure:
    signs = tip_signs(camera.side)
    pose = bent_pose(camera, tips, bend)
    turned = exp_rotation(bend.body_rate_radps * after_s)
    moved = Pose(pose.camera_from_body @ turned.T, turned @ pose.position_body_m + drift_mps * after_s)
    wing_rate = camera.turn_rad(
        float((signs * tips.slope_radpm) @ bend.qdot_mps), float((signs * tips.twist_radpm) @ bend.qdot_mps)
    )
    lever = np.cross(bend.body_rate_radps, moved.position_body_m)
    lift_mps = np.array([0.0, 0.0, -camera.lift_gain * float(signs @ bend.qdot_mps)])
    return CameraExposure(moved, bend.body_rate_radps + wing_rate, lever, after_s, drift_mps + lift_mps)
