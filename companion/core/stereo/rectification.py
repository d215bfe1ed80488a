"""Rectification that follows the wing: a common image frame for two cameras whose poses change with every shot.

The rectified frame has its x axis along the present baseline and looks along the mean view of both cameras. So a point
lies on the same row of both rectified images, and its disparity is ``focal * baseline / depth``. With the rest poses it
is the rigid rectification of a ground calibration.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.stereo.geometry import Lens, MountedCamera, Pose, Rig, epipolar_axes
from companion.records import Bytes, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Rectification:
    """One rectified frame.

    Attributes
    ----------
    rectified_from_body : (3, 3) float64
    left, right : Pose
        Camera poses for which it was made.
    matrix : (3, 3) float64
        Pinhole of both rectified images, px.
    size_px : tuple
        Width, height of the rectified images.
    baseline_m : float
        Distance of the centres of projection, m.
    """

    rectified_from_body: Floats
    left: Pose
    right: Pose
    matrix: Floats
    size_px: tuple[int, int]
    baseline_m: float

    @property
    def focal_px(self) -> float:
        """Focal length of the rectified images, px."""
        return float(self.matrix[0, 0])

    def rectified_from_camera(self, pose: Pose) -> Floats:
        """Rotation (3, 3) from the axes of a camera at ``pose`` to the rectified frame."""
        rotation: Floats = self.rectified_from_body @ pose.camera_from_body.T
        return rotation

    def to_rectified(self, camera: MountedCamera, pose: Pose, pixels: Floats) -> Floats:
        """Rectified pixels (n, 2) of raw pixels (n, 2)."""
        rays = camera.lens.unproject(pixels) @ self.rectified_from_camera(pose).T
        rectified: Floats = rays[:, :2] / rays[:, 2:] * self.focal_px + self.matrix[:2, 2]
        return rectified

    def to_raw(self, camera: MountedCamera, pose: Pose, rectified_px: Floats) -> Floats:
        """Raw pixels (n, 2) of rectified pixels (n, 2)."""
        rays = np.column_stack([(rectified_px - self.matrix[:2, 2]) / self.focal_px, np.ones(rectified_px.shape[0])])
        return camera.lens.project(rays @ self.rectified_from_camera(pose))

    def along_rows(self, camera: MountedCamera, pose: Pose, rectified_px: Floats) -> Floats:
        """Unit direction (n, 2) of the epipolar line, the rectified row, in the raw image."""
        step = np.array([0.5, 0.0])
        moved = self.to_raw(camera, pose, rectified_px + step) - self.to_raw(camera, pose, rectified_px - step)
        direction: Floats = moved / np.linalg.norm(moved, axis=1, keepdims=True)
        return direction


def rectification(rig: Rig, left: Pose, right: Pose) -> Rectification:
    """Build the rectified frame of two poses, with the mean focal length and the size of the left image."""
    baseline_m = float(np.linalg.norm(right.position_body_m - left.position_body_m))
    focal = 0.5 * (rig.left.lens.focal_px + rig.right.lens.focal_px)
    width, height = rig.left.lens.size_px
    matrix = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    return Rectification(epipolar_axes(left, right), left, right, matrix, (width, height), baseline_m)


def rest_rectification(rig: Rig) -> Rectification:
    """Rigid rectification of the ground calibration, for comparison and for airframes that do not bend."""
    return rectification(rig, rig.left.rest, rig.right.rest)


def rectify(frame: Rectification, camera: MountedCamera, pose: Pose, image: Bytes, level: int = 0) -> Bytes:
    """Resample a raw image into the rectified frame; both images are halved ``level`` times first.

    The float maps are built anew for each call, because each frame has a pose of its own.
    """
    map_x, map_y = rectification_maps(frame, camera.lens, pose, level)
    resampled: Bytes = cv2.remap(halved(image, level), map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return resampled


def halved(image: Bytes, level: int) -> Bytes:
    """The image smoothed and halved ``level`` times; its pixel i lies on pixel ``2^level i`` of the original."""
    for _ in range(level):
        image = cv2.pyrDown(image)
    return image


def rectify_pair(frame: Rectification, rig: Rig, left: Bytes, right: Bytes, level: int = 0) -> tuple[Bytes, Bytes]:
    """Both rectified images of a pair, at the poses that the frame was made for."""
    return rectify(frame, rig.left, frame.left, left, level), rectify(frame, rig.right, frame.right, right, level)


def rectification_maps(frame: Rectification, lens: Lens, pose: Pose, level: int = 0) -> tuple[Floats, Floats]:
    """Maps (rows, columns) of :func:`cv2.remap`, from rectified to raw pixels (of the image halved ``level`` times)."""
    factor = 0.5**level
    size = (-(-frame.size_px[0] // 2**level), -(-frame.size_px[1] // 2**level))
    maps: tuple[Floats, Floats] = cv2.initUndistortRectifyMap(
        scaled(lens.matrix, factor),
        lens.distortion,
        frame.rectified_from_camera(pose),
        scaled(frame.matrix, factor),
        size,
        cv2.CV_32FC1,
    )
    return maps


def scaled(matrix: Floats, factor: float) -> Floats:
    """Camera matrix (3, 3) of an image that was shrunk about its first pixel's centre, as ``cv2.pyrDown`` does."""
    smaller: Floats = matrix * np.array([[factor], [factor], [1.0]])
    return smaller
