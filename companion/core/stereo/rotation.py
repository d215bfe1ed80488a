"""Rotation algebra: Rodrigues' formula and its inverse, relative rotation of two cameras.

A rotation vector points along the axis and is as long as the angle. ``exp_rotation(v)`` turns vectors actively; when a
camera is turned by ``v`` relative to the body, body coordinates go to camera coordinates by ``exp_rotation(-v)``.
"""

from __future__ import annotations

import numpy as np

from companion.records import Floats

_LEAST_ANGLE_RAD = 1e-150  # sin(t)/t is 1 to the last digit below 1e-8, and its square is still a number (derived)


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

    With ``K = skew(vector)`` and ``t`` its angle, ``R = I + K sin(t)/t + K^2 (1 - cos t)/t^2``, where
    ``1 - cos t = 2 sin^2(t/2)`` keeps its precision at small angles. (Eq. 7 as printed is not a rotation and is not
    used.)

    Parameters
    ----------
    vector_rad : (..., 3) float64
        Axis times angle.

    Returns
    -------
    (..., 3, 3) float64
    """
    v = np.asarray(vector_rad, dtype=np.float64)
    # element by element: a single vector as floats takes a fifth of the time that arrays of one element do
    x, y, z = v.tolist() if v.ndim == 1 else (v[..., 0], v[..., 1], v[..., 2])
    t = np.maximum(np.sqrt(x * x + y * y + z * z), _LEAST_ANGLE_RAD)
    cosine, first, second = np.cos(t), np.sin(t) / t, 2.0 * (np.sin(0.5 * t) / t) ** 2  # K^2 = v v^T - t^2 I
    rotation = np.empty((*v.shape, 3))
    rotation[..., 0, 0], rotation[..., 1, 1] = cosine + second * (x * x), cosine + second * (y * y)
    rotation[..., 2, 2] = cosine + second * (z * z)
    rotation[..., 0, 1], rotation[..., 1, 0] = second * (x * y) - first * z, second * (x * y) + first * z
    rotation[..., 0, 2], rotation[..., 2, 0] = second * (x * z) + first * y, second * (x * z) - first * y
    rotation[..., 1, 2], rotation[..., 2, 1] = second * (y * z) - first * x, second * (y * z) + first * x
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
    quaternion = _quaternion(np.asarray(rotation, dtype=np.float64))
    axis, cosine = quaternion[..., :3], quaternion[..., 3:]
    sine = np.sqrt(np.sum(axis * axis, axis=-1, keepdims=True))
    per_sine = np.divide(2.0 * np.arctan2(sine, cosine), sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    vector: Floats = axis * per_sine
    return vector


def _quaternion(rotation: Floats) -> Floats:
    """Unit quaternion (..., 4) of a rotation, scalar last and not negative.

    With ``q`` the quaternion, ``4 q q^T`` is linear in the rotation; its row of the largest element of the diagonal is
    the one that loses nothing to rounding (Shepperd 1978).
    """
    r = rotation
    products = np.empty((*r.shape[:-2], 4, 4))
    diagonal = np.stack([r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]], axis=-1)
    trace = diagonal.sum(axis=-1, keepdims=True)
    products[..., :3, :3] = r + np.swapaxes(r, -1, -2)
    products[..., range(3), range(3)] = 1.0 - trace + 2.0 * diagonal
    twice = np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], axis=-1)
    products[..., 3, :3] = products[..., :3, 3] = twice
    products[..., 3, 3] = 1.0 + trace[..., 0]
    largest = np.concatenate([diagonal, trace], axis=-1).argmax(axis=-1)
    row = np.take_along_axis(products, largest[..., np.newaxis, np.newaxis], axis=-2)[..., 0, :]
    row = np.where(row[..., 3:] < 0.0, -row, row)
    quaternion: Floats = row / np.sqrt(np.sum(row * row, axis=-1, keepdims=True))
    return quaternion


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


def without_negative_eigenvalues(covariance: Floats) -> Floats:
    """Nearest positive semidefinite matrix (n, n) to a symmetric one: negative eigenvalues are set to 0."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
