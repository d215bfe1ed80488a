"""From matched pixels to inverse depths, which are finite and Gaussian even where rays are parallel or diverge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.stereo.exposure import CameraExposure
from companion.core.stereo.geometry import MountedCamera, Rig
from companion.core.stereo.rotation import exp_rotation
from companion.records import Bools, Floats, Ints, MatchSet

# least denominator of an inverse depth over the baseline: flatter rays say nothing of the range along the axis (choice)
_FLATTEST = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Matched rays in body axes: origins and directions (n, 3) of the left and the right camera."""

    left_m: Floats
    left: Floats
    right_m: Floats
    right: Floats

    @classmethod
    def stacked(cls, several: Sequence[Rays]) -> Rays:
        """All of several sets of rays, in their order."""
        return cls(
            np.concatenate([rays.left_m for rays in several]),
            np.concatenate([rays.left for rays in several]),
            np.concatenate([rays.right_m for rays in several]),
            np.concatenate([rays.right for rays in several]),
        )

    def at(self, index: Ints | Bools) -> Rays:
        """The rays of some matches, by their numbers (m,) or a mask (n,)."""
        return Rays(self.left_m[index], self.left[index], self.right_m[index], self.right[index])


@dataclass(frozen=True, slots=True, eq=False)
class RangeAxis:
    """Axis of the range, body axes: origin (3,), direction (3,), and two unit vectors across it (2, 3)."""

    origin_m: Floats
    axis: Floats
    across: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Depths:
    """Matches as inverse depths along a range axis.

    Attributes
    ----------
    inverse_pm : (n,) float64
        1 / depth along the axis, per metre; zero or negative for rays that do not meet in front.
    sigma_pm : (n,) float64
        Its one-sigma by matching, 1/m.
    tangent : (n, 2) float64
        Offset from the axis over depth, along two directions across it. A plane has an inverse depth linear in these.
    parallax_rad : (n,) float64
        Left minus right slope across the epipolar plane; zero for perfect matches and extrinsics.
    sigma_rad : (n,) float64
        One-sigma of a match, as a slope.
    """

    inverse_pm: Floats
    sigma_pm: Floats
    tangent: Floats
    parallax_rad: Floats
    sigma_rad: Floats


def match_rays(rig: Rig, exposures: tuple[CameraExposure, CameraExposure], matches: MatchSet) -> Rays:
    """Rays of every match, each at the instant when its row was exposed."""
    left_m, left = _rays(rig.left, exposures[0], matches.left_px, matches.row_time_ns)
    right_m, right = _rays(rig.right, exposures[1], matches.right_px, matches.row_time_ns)
    return Rays(left_m, left, right_m, right)


def range_axis_of_rig(rig: Rig, axis: Floats) -> RangeAxis:
    """RangeAxis along ``axis`` (3,) from midway between the cameras at rest, the origin of the range."""
    helper = np.array([0.0, 1.0, 0.0]) if abs(axis[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    first = helper - (helper @ axis) * axis
    first /= np.linalg.norm(first)
    middle = 0.5 * (rig.left.rest.position_body_m + rig.right.rest.position_body_m)
    return RangeAxis(middle, axis, np.stack([first, np.cross(axis, first)]))


def triangulate(rays: Rays, range_axis: RangeAxis, sigma_rad: Floats) -> Depths:
    """Inverse depth of each match along a range axis.

    In the epipolar frame of a match (x along its baseline B, z where the cameras look) the rays have slopes x_l and
    x_r. The point of closest approach lies at ``B / (x_l - x_r)`` along z. The difference of the slopes y is the
    vertical parallax. All results are quotients of terms linear in ``x_l - x_r``, and stay finite at zero.

    Parameters
    ----------
    rays : Rays
        Matched rays.
    range_axis : RangeAxis
        Axis and origin of the depth.
    sigma_rad : (n,) float64
        One-sigma of each disparity, as a slope.
    """
    apart = rays.right_m - rays.left_m
    baseline = np.sqrt(np.einsum("ij,ij->i", apart, apart))[:, np.newaxis]
    x = apart / baseline
    look = rays.left.sum(axis=0)
    z = look - (x @ look)[:, np.newaxis] * x
    z /= np.sqrt(np.einsum("ij,ij->i", z, z))[:, np.newaxis]
    y = z[:, [1, 2, 0]] * x[:, [2, 0, 1]] - z[:, [2, 0, 1]] * x[:, [1, 2, 0]]
    left_x, left_y = _slopes(rays.left, x, y, z)
    right_x, right_y = _slopes(rays.right, x, y, z)
    disparity = left_x - right_x
    pointing = z + left_x[:, np.newaxis] * x + 0.5 * (left_y + right_y)[:, np.newaxis] * y
    start = rays.left_m - range_axis.origin_m
    reach = baseline[:, 0] * (pointing @ range_axis.axis)
    scale = disparity * (start @ range_axis.axis) + reach
    scale = np.where(scale > _FLATTEST * baseline[:, 0], scale, np.nan)
    offset = disparity[:, np.newaxis] * start + baseline * pointing
    return Depths(
        inverse_pm=disparity / scale,
        sigma_pm=sigma_rad * reach / scale**2,
        tangent=(offset @ range_axis.across.T) / scale[:, np.newaxis],
        parallax_rad=left_y - right_y,
        sigma_rad=sigma_rad,
    )


def _slopes(rays: Floats, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
    along = np.einsum("ij,ij->i", rays, z)
    return np.einsum("ij,ij->i", rays, x) / along, np.einsum("ij,ij->i", rays, y) / along


def _rays(camera: MountedCamera, exposure: CameraExposure, pixels: Floats, row_time_ns: int) -> tuple[Floats, Floats]:
    """Origins and directions (n, 3) of pixels; rows are exposed in turn, the middle one at mid-exposure."""
    middle_row = 0.5 * (camera.lens.size_px[1] - 1)
    after_s = 1e-9 * row_time_ns * (pixels[:, 1] - middle_row)
    directions = camera.rays(exposure.pose, pixels)
    origins = exposure.pose.position_body_m + after_s[:, np.newaxis] * (exposure.velocity_mps + exposure.path_mps)
    if row_time_ns == 0:
        return origins, directions
    turned = exp_rotation(after_s[:, np.newaxis] * exposure.rate_radps)
    return origins, (turned @ directions[..., np.newaxis])[..., 0]
