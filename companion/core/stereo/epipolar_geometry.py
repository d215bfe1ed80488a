"""Epipolar frame of a rig, and the parallax that a wrong relative rotation leaves between matched rays.

In the epipolar frame (x along the baseline, z where the cameras look, y across) matched rays have equal slopes y if the
extrinsics are true. Let the cameras be turned against each other by ``phi`` (rad) more than is believed, each by half
of it, and let the true baseline point along ``(1, b_y, b_z)``. This leaves the parallax (in the terms of ``phi`` the
mean of both rays')

    ``y_l - y_r = -phi_x (1 + y^2) + phi_y x y + phi_z x + b_y d + b_z (x_r y_l - y_r x_l)``,   ``d = x_l - x_r``

Where the baseline as flown is tilted, slopes x show too (EXTRINSICS.md). Pitch ``phi_x`` and roll ``phi_z`` show
strongly, yaw ``phi_y`` only through ``x y``, and the baseline only through depth that varies. Yaw is the toe, whose
error falsifies ranges. Its covariance says how weakly a pair shows it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.core.stereo.epipolar_states import BASELINE, LENS
from companion.core.stereo.geometry import Rig, epipolar_axes
from companion.core.stereo.lens_residual import LensAxes, parallax_columns, slope_errors
from companion.core.stereo.rotation import exp_rotation
from companion.core.stereo.triangulation import Rays
from companion.records import Floats


def epipolar_frame(rig: Rig) -> Floats:
    """Rotation (3, 3) from body axes to the rig's epipolar frame at rest."""
    return epipolar_axes(rig.left.rest, rig.right.rest)


def in_frame(rays: Rays, frame_from_body: Floats) -> Rays:
    """Express rays in another frame, ``frame_from_body`` (3, 3)."""
    arrays = (rays.left_m, rays.left, rays.right_m, rays.right)
    return Rays(*(np.asarray(array @ frame_from_body.T, dtype=np.float64) for array in arrays))


def parallax(epipolar_rays: Rays, axes: LensAxes, state: Floats) -> tuple[Floats, Floats]:
    """Parallax (n,) of rays that a state (14,) leaves unexplained, and its negative gradient by the state (n, 14).

    Parameters
    ----------
    epipolar_rays : Rays
        Matched rays in the epipolar frame.
    axes : LensAxes
        Axes of both cameras, in the epipolar frame.
    state : (14,) float64
        Pitch, yaw, roll of the right camera against the left (rad), direction of the baseline y and z (rad), terms of
        the lens residual. Each camera has half of the rotation: a bend turns both, and the baseline stays.
    """
    half = exp_rotation(0.5 * state[:3])
    turned, axes = _turned(epipolar_rays, half), axes.turned(half)
    apart = turned.right_m - turned.left_m
    toward = apart[:, 1:] / apart[:, :1] + state[BASELINE]
    left_errors = slope_errors(turned.left, axes.left)
    lenses = _lens_columns(_across_lines(turned, toward), left_errors, slope_errors(turned.right, axes.right))
    residual_rad = _unexplained(turned, toward, lenses @ state[LENS])
    # Columns are taken where the rays meet, for the left pixel is the feature and the right one its noisy match. At the
    # ray as measured, the same noise would be in columns and residual, and bias the radial terms in every pair.
    meeting = _meeting(turned, residual_rad)
    across = _across_lines(meeting, toward)
    lenses = _lens_columns(across, left_errors, slope_errors(meeting.right, axes.right))
    return residual_rad, np.concatenate([_turn_columns(across, meeting), _baseline_columns(meeting), lenses], axis=1)


def _turned(rays: Rays, half: Floats) -> Rays:
    """The right rays turned by a rotation (3, 3), and the left ones by its inverse."""
    return replace(rays, left=rays.left @ half, right=rays.right @ half.T)


def _meeting(rays: Rays, parallax_rad: Floats) -> Rays:
    """Rays of which the right ones have larger slopes y by a parallax (n,): they meet the left ones."""
    right = rays.right.copy()
    right[:, 1] += parallax_rad * right[:, 2]
    return replace(rays, right=right)


def _unexplained(rays: Rays, toward: Floats, lenses: Floats) -> Floats:
    """Parallax (n,) of turned rays less that by baselines along ``(1, toward)`` (n, 2) and by the lenses (n,)."""
    (_, y_l), (_, y_r) = _slopes(rays.left), _slopes(rays.right)
    unexplained: Floats = y_l - y_r - (toward * _baseline_columns(rays)).sum(axis=1) - lenses
    return unexplained


def _baseline_columns(rays: Rays) -> Floats:
    """Negative gradient (n, 2) of the unexplained parallax by the baseline's y and z."""
    (x_l, y_l), (x_r, y_r) = _slopes(rays.left), _slopes(rays.right)
    return np.stack([x_l - x_r, x_r * y_l - y_r * x_l], axis=1)


def _turn_columns(across: tuple[Floats, Floats], rays: Rays) -> Floats:
    """Negative gradient (n, 3) of the unexplained parallax by pitch, yaw and roll, half of it in each camera."""
    left, right = across
    turned = left @ _per_turn(*_slopes(rays.left)) + right @ _per_turn(*_slopes(rays.right))
    return np.asarray(0.5 * turned[:, 0])


def _lens_columns(across: tuple[Floats, Floats], left_errors: Floats, right_errors: Floats) -> Floats:
    """Negative gradient (n, 9) of the unexplained parallax by the lenses' terms, of their slopes' errors (n, 2, 6)."""
    left, right = across
    return parallax_columns((left @ left_errors)[:, 0], (right @ right_errors)[:, 0])


def _across_lines(rays: Rays, toward: Floats) -> tuple[Floats, Floats]:
    """Parallax (n, 1, 2) per unit of either slope of the left ray, and, with the other sign, of the right one.

    Cameras that expose at two instants have a baseline that points ahead or back, by ``toward`` (n, 2) per unit of its
    length along x: then slopes x show across the epipolar lines as well.
    """
    (x_l, y_l), (x_r, y_r), (t_y, t_z) = _slopes(rays.left), _slopes(rays.right), toward.T
    left = np.stack([t_z * y_r - t_y, 1.0 - t_z * x_r], axis=1)
    right = np.stack([t_z * y_l - t_y, 1.0 - t_z * x_l], axis=1)
    return left[:, np.newaxis], right[:, np.newaxis]


def _per_turn(x: Floats, y: Floats) -> Floats:
    """Change (n, 2, 3) of slopes (n,) of rays by a small turn about each axis."""
    return np.stack([np.stack([-x * y, 1.0 + x**2, -y], axis=1), np.stack([-1.0 - y**2, x * y, x], axis=1)], axis=1)


def _slopes(rays: Floats) -> tuple[Floats, Floats]:
    """Slopes x and y (n,) of rays (n, 3)."""
    return rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
