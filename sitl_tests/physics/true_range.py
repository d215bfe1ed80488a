"""True ranges to a scene as a pair should read them, by following pixels of one camera into the other."""

from __future__ import annotations

import enum

import numpy as np

from companion.records import Floats
from companion.sim.vision.scene import PosedCamera, Scene


class TrueRangeProduct(enum.StrEnum):
    """Which range stands for a view (settings: RNG_PRODUCT)."""

    MEDIAN = "median"
    NEAREST = "nearest"
    CENTRE = "centre"


def overlap_depths_m(scene: Scene, left: PosedCamera, right: PosedCamera, grid: tuple[int, int] = (32, 24)) -> Floats:
    """True depths of what both cameras see, along the mean optical axis from between the cameras, (n,).

    A ``grid`` of left pixels is followed to the scene; what falls outside the right image is left out, what hides
    behind a nearer surface there is not.
    """
    width, height = left.camera.lens.size_px
    columns = (np.arange(grid[0]) + 0.5) * width / grid[0] - 0.5
    rows = (np.arange(grid[1]) + 0.5) * height / grid[1] - 0.5
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    points = left.points_ned_m(scene, pixels)
    points = points[np.isfinite(points[:, 0])]
    right_px = right.project(points)
    limits = np.array(right.camera.lens.size_px) - 0.5
    both = np.all((right_px > -0.5) & (right_px < limits), axis=1)
    axis = left.camera_from_ned[2] + right.camera_from_ned[2]
    middle = 0.5 * (left.centre_ned_m + right.centre_ned_m)
    return np.asarray((points[both] - middle) @ (axis / np.linalg.norm(axis)))


def true_range_m(
    scene: Scene, left: PosedCamera, right: PosedCamera, product: TrueRangeProduct = TrueRangeProduct.MEDIAN
) -> float:
    """The range that the named product should read, along the mean optical axis; infinite where nothing is seen."""
    depths = overlap_depths_m(scene, left, right)
    if not len(depths):
        return float("inf")
    if product is TrueRangeProduct.NEAREST:
        return float(np.min(depths))
    if product is TrueRangeProduct.MEDIAN:
        return float(np.median(depths))
    axis = left.camera_from_ned[2] + right.camera_from_ned[2]
    middle = 0.5 * (left.centre_ned_m + right.centre_ned_m)
    return float(scene.hit(middle, (axis / np.linalg.norm(axis))[None])[0])
