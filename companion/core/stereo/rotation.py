"""Rotation algebra: Rodrigues' formula and its inverse, relative rotation of two cameras.

A rotation vector points along the axis and is as long as the angle. ``exp_rotation(v)`` turns vectors actively; when a
camera is turned by ``v`` relative to the body, body coordinates go to camera coordinates by ``exp_rotation(-v)``.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from companion.records import Floats


def skew(vector: Floats) -> Floats:
    """Antisymmetric matrix with ``skew(a) @ b == cross(a, b)`` (seed paper, eq. 5).

    Parameters
    ----------
    vector : (..., 3) float64
        Any unit.

    Returns
    -------
    (..., 3, 3) float64
    """
    v = np.asarray(vector, dtype=np.float64)
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def exp_rotation(vector_rad: Floats) -> Floats:
    """Rotation matrix of a rotation vector by Rodrigues' formula (seed paper, eqs. 3 to 6).

    With ``K = skew(vector)`` and ``t`` its angle, ``R = I + K sin(t)/t + K^2 (1 - cos t)/t^2``. (Eq. 7 as printed is
    not a rotation and is not used.)

    Parameters
    ----------
    vector_rad : (..., 3) float64
        Axis times angle.

    Returns
    -------
    (..., 3, 3) float64
    """
    rotation: Floats = Rotation.from_rotvec(vector_rad).as_matrix()
    return rotation


def log_rotation(rotation: Floats) -> Floats:
    """Rotation vector of a rotation matrix, angle in [0, pi]; the inverse of :func:`exp_rotation`.

    Keeps full precision at 0 and near pi. At exactly pi the axis is known but its sign is not; one of the two is
    returned.

    Parameters
    ----------
    rotation : (..., 3, 3) float64
        A proper rotation; it is not made orthogonal first.

    Returns
    -------
    (..., 3) float64
        Radians.
    """
    vector: Floats = Rotation.from_matrix(rotation, assume_valid=True).as_rotvec()
    return vector


def relative_rotation(right_from_body: Floats, left_from_body: Floats) -> Floats:
    """Rotation that takes left camera coordinates to right camera coordinates, ``R = R_r R_l^T`` (seed paper, eq. 8).

    Parameters
    ----------
    right_from_body, left_from_body : (..., 3, 3) float64
        Attitudes of the two cameras.

    Returns
    -------
    (..., 3, 3) float64
    """
    relative: Floats = np.asarray(right_from_body) @ np.swapaxes(np.asarray(left_from_body), -1, -2)
    return relative
