"""How a camera sits on its wing section: turned against the inertial sensor of the same section, by gravity.

The aircraft is held still in several attitudes before a board that does not move. The section's accelerometer feels
where up is in its axes, the camera sees how the board lies in its own, and up on the board is one unknown direction
``b``::

    camera_from_section @ up_section[k] = camera_from_board[k] @ b        for every attitude k

Five unknowns, two equations an attitude. Bending does not matter, because camera and sensor sit on the same section; an
accelerometer bias of 0.02 m/s^2 does (2 mrad), and turning the aircraft the other way round averages part of it.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from companion.core.stereo.geometry import axes_from_body
from companion.core.stereo.rotation import exp_rotation, log_rotation, skew
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Camera
from companion.records import Floats
from companion.units import GRAVITY_MPS2

LEAST_ATTITUDES = 4  # three unknown angles, and one attitude to judge by (choice)
_MAX_STEPS = 20  # Gauss-Newton steps at most (numerical)
_LARGEST_SIGMA_RAD = 0.02  # a worse mounting is not worth having (choice)


@dataclass(frozen=True, slots=True)
class Attitude:
    """One attitude at rest: unit vector up in the section's axes (3,), and the board as the camera sees it (3, 3)."""

    name: str
    up_section: Floats
    camera_from_board: Floats


@dataclass(frozen=True, slots=True)
class Mounting:
    """A camera's rotation against its section.

    Attributes
    ----------
    camera_from_section : (3, 3) float64
    sigma_rad : (3,) float64
        About the camera's axes, from the scatter of the attitudes; an accelerometer's bias is not in it.
    errors_rad : (k,) float64
        Angle between felt and seen up in each attitude.
    """

    camera_from_section: Floats
    sigma_rad: Floats
    errors_rad: Floats


def mount(attitudes: list[Attitude]) -> Mounting:
    """Solve for the mounting.

    Raises
    ------
    ConfigError
        Too few attitudes, or they differ about one axis alone.
    """
    if len(attitudes) < LEAST_ATTITUDES:
        raise ConfigError(
            f"{len(attitudes)} attitudes are too few: hold the aircraft still in {LEAST_ATTITUDES} or more"
        )
    felt = np.array([each.up_section for each in attitudes])
    boards = np.array([each.camera_from_board for each in attitudes])
    rotation, errors, slope = _solved(felt, boards)
    spread = np.linalg.svd(slope, compute_uv=False)
    free = max(2 * len(attitudes) - 5, 1)
    variance = float(errors @ errors) / free
    sigma = np.sqrt(variance * np.diag(np.linalg.pinv(slope.T @ slope, rcond=1e-9))[:3])
    angles = np.linalg.norm(errors.reshape(-1, 3), axis=1)
    if spread[4] < 0.01 * spread[0] or float(sigma.max()) > _LARGEST_SIGMA_RAD:
        raise ConfigError(
            "the attitudes do not determine the mounting: bank the aircraft both ways and pitch it too; "
            f"the attitude that fits worst: {attitudes[_worst(felt, boards)].name}"
        )
    return Mounting(rotation, sigma, angles)


def _worst(felt: Floats, boards: Floats) -> int:
    """The attitude without which the others agree best."""
    without = [_solved(np.delete(felt, k, axis=0), np.delete(boards, k, axis=0))[1] for k in range(len(felt))]
    return int(np.argmin([errors @ errors for errors in without]))


def _solved(felt: Floats, boards: Floats) -> tuple[Floats, Floats, Floats]:
    """Mounting (3, 3), what is left of up (3 k,), and its slope by small turns, by Gauss-Newton."""
    rotation, up = _start(felt, boards)
    for _ in range(_MAX_STEPS):
        errors, slope = _errors(rotation, up, felt, boards)
        step: Floats = np.asarray(np.linalg.lstsq(slope, errors, rcond=1e-9)[0], dtype=np.float64)
        rotation = exp_rotation(step[:3]) @ rotation
        up = exp_rotation(step[3:]) @ up
        if float(np.linalg.norm(step)) < 1e-12:
            break
    errors, slope = _errors(rotation, up, felt, boards)
    return rotation, errors, slope


def airframe_with_mounting(base: Airframe, left: Mounting, right: Mounting) -> Airframe:
    """The base airframe with both cameras turned together, as their sections' sensors say.

    The rotation between the cameras is left as it is: a stereo calibration knows it ten times better than gravity. The
    right camera's place turns with them about the left one, for that calibration knows it in the left camera's axes.

    Raises
    ------
    ConfigError
        The base has no cameras.
    """
    left_camera, right_camera = base.camera_pair
    before = [_rest(left_camera, "left"), _rest(right_camera, "right")]
    right_from_left = before[1] @ before[0].T
    left_from_section = left.camera_from_section
    implied_from_section = right_from_left.T @ right.camera_from_section
    middle = exp_rotation(0.5 * log_rotation(implied_from_section @ left_from_section.T)) @ left_from_section
    turned = [
        dataclasses.replace(camera, rotation_rad=_rotation(camera, rest, name))
        for camera, rest, name in ((left_camera, middle, "left"), (right_camera, right_from_left @ middle, "right"))
    ]
    left_m = np.array(left_camera.position_m)
    apart_m = middle.T @ before[0] @ (np.array(right_camera.position_m) - left_m)
    x, y, z = (float(entry) for entry in left_m + apart_m)
    right_turned = dataclasses.replace(turned[1], position_m=(x, y, z))
    sigma_rad = _pair_sigma_rad(base, left, right)
    return dataclasses.replace(base, left_camera=turned[0], right_camera=right_turned, pair_sigma_rad=sigma_rad)


def _pair_sigma_rad(base: Airframe, left: Mounting, right: Mounting) -> float:
    """Sigma of a turn of both cameras: half of either section's error, by its scatter and its accelerometer's bias."""
    biases_rad = [sensor.accel_bias_sigma_mps2 / GRAVITY_MPS2 for sensor in (base.left, base.right)]
    scatters_rad = [float(np.sqrt(np.mean(mounting.sigma_rad**2))) for mounting in (left, right)]
    return 0.5 * math.hypot(*biases_rad, *scatters_rad)


def disagreement_rad(base: Airframe, left: Mounting, right: Mounting) -> float:
    """Angle between the relative rotation that both mountings imply and that of the base's stereo calibration."""
    left_camera, right_camera = base.camera_pair
    calibrated = _rest(right_camera, "right") @ _rest(left_camera, "left").T
    implied = right.camera_from_section @ left.camera_from_section.T
    return float(np.linalg.norm(log_rotation(implied @ calibrated.T)))


def _rest(camera: Camera, name: str) -> Floats:
    return exp_rotation(-np.array(camera.rotation_rad)) @ axes_from_body(camera.axes, f"{name}_camera.axes")


def _rotation(camera: Camera, rest: Floats, name: str) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in -log_rotation(rest @ axes_from_body(camera.axes, f"{name}_camera.axes").T))
    return x, y, z


def _start(felt: Floats, boards: Floats) -> tuple[Floats, Floats]:
    """Nullspace of the equations taken as linear in the nine entries of the rotation and the three of up."""
    rows = [np.hstack([np.kron(np.eye(3), u), -board]) for u, board in zip(felt, boards, strict=True)]
    null = np.linalg.svd(np.vstack(rows))[2][-1]
    matrix = null[:9].reshape(3, 3)
    sign = 1.0 if np.linalg.det(matrix) > 0.0 else -1.0
    u, _, v = np.linalg.svd(sign * matrix)
    rotation: Floats = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    up = np.mean(np.einsum("kji,jl,kl->ki", boards, rotation, felt), axis=0)
    return rotation, up / np.linalg.norm(up)


def _errors(rotation: Floats, up: Floats, felt: Floats, boards: Floats) -> tuple[Floats, Floats]:
    """Felt minus seen up (3 k,), camera axes, and what a small turn of the mounting and of up on the board changes."""
    turned, observed = felt @ rotation.T, boards @ up
    slope = np.concatenate([skew(turned), -boards @ skew(up)], axis=2)
    return (turned - observed).ravel(), slope.reshape(-1, 6)
