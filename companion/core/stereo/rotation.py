"""Rotation algebra: Rodrigues' formula and its inverse, relative rotation of two cameras.

A rotation vector points along the axis and is as long as the angle. ``exp_rotation(v)`` turns vectors actively; when a
camera is turned by ``v`` relative to the body, body coordinates go to camera coordinates by ``exp_rotation(-v)``.
"""

from __future__ import annotations

import numpy as np

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

    With ``K = skew(vector)`` and ``t`` its angle, ``R = I + K sin(t)/t + K^2 (1 - cos t)/t^2``; both quotients are
    written as sinc so that nothing is lost at ``t = 0``. (Eq. 7 as printed is not a rotation and is not used.)

    Parameters
    ----------
    vector_rad : (..., 3) float64
        Axis times angle.

    Returns
    -------
    (..., 3, 3) float64
    """
    vector = np.asarray(vector_rad, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1)[..., np.newaxis, np.newaxis]
    k = skew(vector)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    rotation: Floats = np.eye(3) + first * k + second * (k @ k)
    return rotation


def log_rotation(rotation: Floats) -> Floats:
    """Rotation vector of a rotation matrix, angle in [0, pi]; the inverse of :func:`exp_rotation`.

    Goes by the unit quaternion, taken from the largest column of ``4 q q^T`` (Shepperd's choice), which keeps full
    precision at 0 and near pi. At exactly pi the axis is known but its sign is not; one of the two is returned.

    Parameters
    ----------
    rotation : (..., 3, 3) float64
        A proper rotation.

    Returns
    -------
    (..., 3) float64
        Radians.
    """
    outer = _quaternion_outer(np.asarray(rotation, dtype=np.float64))
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    quaternion = np.take_along_axis(outer, best[..., np.newaxis, np.newaxis], axis=-1)[..., 0]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion = np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)
    scalar, imaginary = quaternion[..., :1], quaternion[..., 1:]
    length = np.linalg.norm(imaginary, axis=-1, keepdims=True)
    tiny = length < np.finfo(np.float64).tiny
    stretch = np.where(tiny, 2.0, 2.0 * np.arctan2(length, scalar) / np.where(tiny, 1.0, length))
    vector: Floats = imaginary * stretch
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


def turn_small(vectors: Floats, angle_rad: Floats) -> Floats:
    """First-order rotation of vectors by a small rotation vector: ``v + angle x v``, in error by ``angle^2 / 2``.

    Parameters
    ----------
    vectors, angle_rad : (..., 3) float64
        What is turned, and the rotation vector.

    Returns
    -------
    (..., 3) float64
    """
    turned: Floats = vectors + np.cross(angle_rad, vectors)
    return turned


def _quaternion_outer(r: Floats) -> Floats:
    """``4 q q^T`` of the unit quaternion ``q = (w, x, y, z)`` of a rotation matrix."""
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    outer = np.empty((*r.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1.0 + xx + yy + zz
    outer[..., 1, 1] = 1.0 + xx - yy - zz
    outer[..., 2, 2] = 1.0 - xx + yy - zz
    outer[..., 3, 3] = 1.0 - xx - yy + zz
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        outer[..., 0, i + 1] = outer[..., i + 1, 0] = r[..., k, j] - r[..., j, k]
        outer[..., i + 1, j + 1] = outer[..., j + 1, i + 1] = r[..., i, j] + r[..., j, i]
    return outer
