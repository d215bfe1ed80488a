"""Epipolar frame of a rig, and the parallax that a wrong relative rotation leaves between matched rays.

In the epipolar frame (x along the baseline, z where the cameras look, y across) matched rays have equal slopes y if the
extrinsics are true. Let the cameras be turned against each other by ``phi`` (rad) more than is believed, each by half
of it, and let the true baseline point along ``(1, b_y, b_z)``. This leaves the parallax (in the terms of ``phi`` the
mean of both rays')

    ``y_l - y_r = -phi_x (1 + y^2) + phi_y x y + phi_z x + b_y d + b_z (x_r y_l - y_r x_l)``,   ``d = x_l - x_r``

Pitch ``phi_x`` and roll ``phi_z`` show strongly, yaw ``phi_y`` only through ``x y``, and the baseline only through
depth that varies. Yaw is the toe, whose error falsifies ranges. Its covariance says how weakly a pair shows it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.core.stereo.epipolar_states import BASELINE, LENS
from companion.core.stereo.geometry import Rig, epipolar_axes
from companion.core.stereo.lens_residual import LensAxes, across_lines, parallax_columns
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
    left = across_lines(turned.left, axes.left)
    residual_rad = _unexplained(turned, parallax_columns(left, across_lines(turned.right, axes.right)), state)
    # Columns are taken where the rays meet, for the left pixel is the feature and the right one its noisy match. At the
    # ray as measured, the same noise would be in columns and residual, and bias the radial terms in every pair.
    meeting = _meeting(turned, residual_rad)
    lens = parallax_columns(left, across_lines(meeting.right, axes.right))
    return residual_rad, np.concatenate([_turn_and_baseline_columns(meeting), lens], axis=1)


def _turned(rays: Rays, half: Floats) -> Rays:
    """The right rays turned by a rotation (3, 3), and the left ones by its inverse."""
    return replace(rays, left=rays.left @ half, right=rays.right @ half.T)


def _meeting(rays: Rays, parallax_rad: Floats) -> Rays:
    """Rays of which the right ones have larger slopes y by a parallax (n,): they meet the left ones."""
    right = rays.right.copy()
    right[:, 1] += parallax_rad * right[:, 2]
    return replace(rays, right=right)


def _unexplained(rays: Rays, lens: Floats, state: Floats) -> Floats:
    """Parallax (n,) of turned rays less what the baseline and the lenses explain; ``lens`` has their columns (n, 9)."""
    columns = _turn_and_baseline_columns(rays)
    apart = rays.right_m - rays.left_m
    toward = apart[:, 1:] / apart[:, :1] + state[BASELINE]
    y_l, y_r = rays.left[:, 1] / rays.left[:, 2], rays.right[:, 1] / rays.right[:, 2]
    unexplained: Floats = y_l - y_r - (toward * columns[:, BASELINE]).sum(axis=1) - lens @ state[LENS]
    return unexplained


def _turn_and_baseline_columns(rays: Rays) -> Floats:
    """Negative gradient (n, 5) of the unexplained parallax by pitch, yaw, roll, and the baseline's y and z."""
    x_l, y_l = rays.left[:, 0] / rays.left[:, 2], rays.left[:, 1] / rays.left[:, 2]
    x_r, y_r = rays.right[:, 0] / rays.right[:, 2], rays.right[:, 1] / rays.right[:, 2]
    per_turn = [-1.0 - 0.5 * (y_l**2 + y_r**2), 0.5 * (x_l * y_l + x_r * y_r), 0.5 * (x_l + x_r)]
    return np.stack([*per_turn, x_l - x_r, x_r * y_l - y_r * x_l], axis=1)
