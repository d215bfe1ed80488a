"""The stereo rig: lenses, rest poses, and the pose of each camera when the wing bends.

Pixels are OpenCV's (column, row, integers at pixel centres); camera axes x right, y down, z forward; body axes FRD with
the origin of the airframe file. A rotation ``a_from_b`` takes coordinates in b to coordinates in a.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from companion.core.stereo.rotation import exp_rotation
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Camera
from companion.records import Floats, Side

_AXIS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_DISTORTION_TERMS = 5  # k1, k2, p1, p2, k3 (convention)
# measured: of 183 matches of level cameras 114 are left at 10 degrees, none at 20
_MOST_ROLL_RAD = np.radians(12.0)
_LEAST_ALONG = 0.5  # cosine of the look with the range axis: beyond 60 degrees hardly a lens sees the axis (choice)
_ORIENTATIONS = {0: "x", 2: "y", 4: "-x", 6: "-y", 24: "-z", 25: "z"}  # MAV_SENSOR_ORIENTATION (common.xml)
_HALF_STEP_PX = 0.5  # of the difference quotient of a lens (numerical)
_MOST_FOLD_PX = 0.1  # a round trip through a lens with an inverse is right to 1e-6 px (choice)
_MOST_SCALE_RATIO = 1.15  # measured: of 183 matches of equal pixels 30 are left at 1.25, none at 1.5
# A wingtip lens is mild; 50 fixed-point steps bring even a wide one to machine precision.
# numerical: steps at most, and a residual by which rounding rules
_UNDISTORT_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-14)


class Pose(NamedTuple):
    """Attitude and place of one camera at one instant.

    ``camera_from_body`` is (3, 3); ``position_body_m`` (3,) is the centre of projection in body axes.
    """

    camera_from_body: Floats
    position_body_m: Floats


def epipolar_axes(left: Pose, right: Pose) -> Floats:
    """Axes as rows (3, 3), body axes: x along the baseline, z the mean view across it, ``y = z cross x``."""
    apart = right.position_body_m - left.position_body_m
    x = apart / np.linalg.norm(apart)
    look = left.camera_from_body[2] + right.camera_from_body[2]
    z = look - (look @ x) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z])


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """Pinhole with OpenCV's five distortion terms k1, k2, p1, p2, k3.

    Attributes
    ----------
    matrix : (3, 3) float64
        Focal length and principal point, px.
    distortion : (5,) float64
    size_px : tuple
        Width, height.
    """

    matrix: Floats
    distortion: Floats
    size_px: tuple[int, int]

    @property
    def focal_px(self) -> float:
        """Focal length along the rows, px."""
        return float(self.matrix[0, 0])

    def project(self, points_m: Floats) -> Floats:
        """Pixels of points given in camera axes; NaN for points that are not in front of the camera.

        Parameters
        ----------
        points_m : (..., 3) float64
            Metres, camera axes.

        Returns
        -------
        (..., 2) float64
            Distorted pixels, inside the image or not.
        """
        points = np.asarray(points_m, dtype=np.float64)
        depth = np.where(points[..., 2:] > 0.0, points[..., 2:], np.nan)
        bent = self.distort(points[..., :2] / depth)
        pixels: Floats = bent * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]
        return pixels

    def unproject(self, pixels: Floats) -> Floats:
        """Rays in camera axes, with z = 1, of distorted pixels; the inverse of :meth:`project`.

        Parameters
        ----------
        pixels : (n, 2) float64
            Column, row.

        Returns
        -------
        (n, 3) float64
        """
        flat = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        rays = np.ones((flat.shape[0], 3))
        if flat.size:
            rays[:, :2] = cv2.undistortPoints(flat, self.matrix, self.distortion, criteria=_UNDISTORT_STOP)[:, 0]
        return rays

    def px_per_slope(self, pixels: Floats, along: Floats) -> Floats:
        """Pixels by which an image place moves per unit of its ray's slope: the focal length, less what the lens bends.

        Parameters
        ----------
        pixels : (n, 2) float64
            Column, row.
        along : (2,) float64
            Direction in the image, of unit length.

        Returns
        -------
        (n,) float64
        """
        if not self.distortion.any():
            return np.full(len(pixels), float(np.linalg.norm(along * self.matrix[[0, 1], [0, 1]])))
        moved = self.unproject(pixels + _HALF_STEP_PX * along) - self.unproject(pixels - _HALF_STEP_PX * along)
        per_slope: Floats = 2.0 * _HALF_STEP_PX / np.linalg.norm(moved, axis=1)
        return per_slope

    def distort(self, normalised: Floats) -> Floats:
        """Bend ideal image coordinates (x/z, y/z) as the lens does (Brown's model, as OpenCV defines it)."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = normalised[..., 0], normalised[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bent_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        bent_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack([bent_x, bent_y], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class MountedCamera:
    """One camera on its wing: lens, rest pose of the ground calibration, its share of the tip's turn and lift."""

    side: Side
    lens: Lens
    rest: Pose
    slope_gain: float
    lift_gain: float

    @classmethod
    def from_record(cls, side: Side, camera: Camera, name: str) -> MountedCamera:
        """Build from the airframe's record; :class:`ConfigError` names the key that makes no sense."""
        _check(camera, name)
        focal, tall = camera.focal_px.value, camera.focal_px.value * camera.focal_ratio
        matrix = np.array([[focal, 0.0, camera.principal_px[0]], [0.0, tall, camera.principal_px[1]], [0.0, 0.0, 1.0]])
        lens = Lens(matrix, np.array(camera.distortion), (camera.width_px, camera.height_px))
        _check_fold(lens, name)
        mounting = exp_rotation(-np.array(camera.rotation_rad))
        rest = Pose(mounting @ axes_from_body(camera.axes, f"{name}.axes"), np.array(camera.position_m))
        return cls(side, lens, rest, camera.slope_gain, camera.lift_gain)

    def turn_rad(self, slope_rad: float, twist_rad: float = 0.0) -> Floats:
        """Rotation vector (3,), body axes, by which the bent wing has turned this camera from its rest pose.

        Up-bend turns the left wing about +x and the right wing about -x; nose-up twist turns both about +y.
        """
        roll = slope_rad if self.side is Side.LEFT else -slope_rad
        return self.slope_gain * np.array([roll, twist_rad, 0.0])

    def pose(self, slope_rad: float, lift_m: float, twist_rad: float = 0.0) -> Pose:
        """Pose for a tip slope (up-bend positive), tip deflection (up positive) and tip twist (nose-up positive)."""
        camera_from_body = self.rest.camera_from_body @ exp_rotation(-self.turn_rad(slope_rad, twist_rad))
        return Pose(camera_from_body, self.rest.position_body_m + np.array([0.0, 0.0, -self.lift_gain * lift_m]))

    def project(self, pose: Pose, points_body_m: Floats) -> Floats:
        """Pixels (..., 2) of points (..., 3) in body axes; NaN behind the camera."""
        return self.lens.project((points_body_m - pose.position_body_m) @ pose.camera_from_body.T)

    def rays(self, pose: Pose, pixels: Floats) -> Floats:
        """Directions (n, 3) in body axes, of unit depth along the optical axis, through distorted pixels (n, 2)."""
        directions: Floats = self.lens.unproject(pixels) @ pose.camera_from_body
        return directions


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The left and right camera of one airframe."""

    left: MountedCamera
    right: MountedCamera

    @classmethod
    def from_airframe(cls, airframe: Airframe) -> Rig:
        """Build the rig, or raise :class:`ConfigError` when the airframe has no usable pair."""
        left_camera, right_camera = airframe.camera_pair
        left = MountedCamera.from_record(Side.LEFT, left_camera, "left_camera")
        right = MountedCamera.from_record(Side.RIGHT, right_camera, "right_camera")
        if left_camera.row_time_s != right_camera.row_time_s:
            raise ConfigError(
                f"airframe '{airframe.name}': row_time_s of the cameras differ; use the same sensor twice"
            )
        _check_pair(left, right, airframe.name)
        return cls(left, right)

    def camera(self, side: Side) -> MountedCamera:
        """The camera of a side."""
        return self.left if side is Side.LEFT else self.right

    def pose(self, side: Side, slope_rad: float, lift_m: float, twist_rad: float = 0.0) -> Pose:
        """Pose of one camera; see :meth:`MountedCamera.pose`."""
        return self.camera(side).pose(slope_rad, lift_m, twist_rad)

    def project(self, side: Side, pose: Pose, points_body_m: Floats) -> Floats:
        """Pixels (n, 2) of body points (n, 3); see :meth:`MountedCamera.project`."""
        return self.camera(side).project(pose, points_body_m)

    def slope_sigma_rad(self, side: Side, pixels: Floats, sigma_px: Floats) -> Floats:
        """One-sigma (n,), as a slope, of places (n, 2) in a camera's image whose sigma along the baseline is in px."""
        camera = self.camera(side)
        along = (camera.rest.camera_from_body @ (self.right.rest.position_body_m - self.left.rest.position_body_m))[:2]
        sigma_rad: Floats = sigma_px / camera.lens.px_per_slope(pixels, along / np.linalg.norm(along))
        return sigma_rad

    @property
    def baseline_m(self) -> float:
        """Distance of the two centres of projection at rest, m."""
        return float(np.linalg.norm(self.right.rest.position_body_m - self.left.rest.position_body_m))


def orientation_axis(orientation: int) -> Floats:
    """Body axis (3,) of a MAV_SENSOR_ORIENTATION; :class:`ConfigError` for one that is not along an axis."""
    if orientation not in _ORIENTATIONS:
        allowed = ", ".join(str(key) for key in sorted(_ORIENTATIONS))
        raise ConfigError(f"orientation {orientation} is not along a body axis; possible: {allowed}")
    name = _ORIENTATIONS[orientation]
    return (-1.0 if name.startswith("-") else 1.0) * np.array(_AXIS[name[-1]])


def check_orientation(rig: Rig, airframe: Airframe) -> None:
    """Raise :class:`ConfigError` for a range axis that neither camera sees: every pair would have too few matches."""
    look = rig.left.rest.camera_from_body[2] + rig.right.rest.camera_from_body[2]
    orientation_axis(airframe.orientation)
    along = {number: float(orientation_axis(number) @ look) for number in _ORIENTATIONS}
    if along[airframe.orientation] < _LEAST_ALONG * float(np.linalg.norm(look)):
        raise ConfigError(
            f"airframe '{airframe.name}': orientation {airframe.orientation} is not where the cameras look; "
            f"by their axes it is {max(along, key=lambda number: along[number])}"
        )


def axes_from_body(axes: tuple[str, str, str], where: str) -> Floats:
    """Rotation (3, 3) to a frame whose x, y and z point along the named body directions (``["y", "-x", "z"]``).

    Raises
    ------
    ConfigError
        A name is not one of x, y, z with an optional minus, or the three are not a right-handed frame.
    """
    rows = []
    for axis in axes:
        letter = axis.removeprefix("-")
        if letter not in _AXIS:
            raise ConfigError(f"{where}: '{axis}' is not one of x, y, z, -x, -y, -z")
        rows.append((-1.0 if axis.startswith("-") else 1.0) * np.array(_AXIS[letter]))
    matrix = np.stack(rows)
    if round(float(np.linalg.det(matrix))) != 1:
        raise ConfigError(
            f"{where}: {list(axes)} is not a right-handed frame; "
            'a camera looking down with its top forward is ["y", "-x", "z"], one looking forward ["y", "z", "x"]'
        )
    return matrix


def _check(camera: Camera, name: str) -> None:
    if camera.width_px <= 0 or camera.height_px <= 0:
        raise ConfigError(f"{name}: width_px and height_px must be positive")
    if camera.focal_px.value <= 0.0:
        raise ConfigError(f"{name}.focal_px must be positive, not {camera.focal_px.value:g}")
    if not camera.focal_ratio > 0.0:
        raise ConfigError(f"{name}.focal_ratio must be positive, not {camera.focal_ratio:g}")
    if len(camera.distortion) != _DISTORTION_TERMS:
        raise ConfigError(f"{name}.distortion needs 5 terms (k1, k2, p1, p2, k3), not {len(camera.distortion)}")


def _check_fold(lens: Lens, name: str) -> None:
    """Refuse a distortion that has no inverse in the corners: rays there would be finite and wrong."""
    width, height = lens.size_px
    corners = np.array([[x, y] for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)])
    off_px = np.linalg.norm(lens.project(lens.unproject(corners)) - corners, axis=1)
    worst_px = float(np.max(np.nan_to_num(off_px, nan=np.inf)))
    if worst_px > _MOST_FOLD_PX:
        raise ConfigError(
            f"{name}.distortion folds the image: rays through its corners come back {worst_px:.0f} px beside them; "
            "calibrate again with boards in the corners"
        )


def _check_pair(left: MountedCamera, right: MountedCamera, name: str) -> None:
    apart = right.rest.position_body_m - left.rest.position_body_m
    if apart[1] <= 0.0:
        raise ConfigError(f"airframe '{name}': left_camera must have the smaller position_m y (body y points right)")
    look_left, look_right = left.rest.camera_from_body[2], right.rest.camera_from_body[2]
    if float(look_left @ look_right) < np.cos(np.radians(45.0)):
        raise ConfigError(f"airframe '{name}': the cameras look more than 45 degrees apart, they share no view")
    baseline = apart / np.linalg.norm(apart)
    if abs(float(baseline @ (look_left + look_right))) / 2.0 > np.cos(np.radians(30.0)):
        raise ConfigError(f"airframe '{name}': the cameras look along their baseline, no range can be measured")
    _check_alike(left, right, name)


def _check_alike(left: MountedCamera, right: MountedCamera, name: str) -> None:
    """Refuse cameras whose images cannot be matched: rolled against each other, or of another scale."""
    axes = epipolar_axes(left.rest, right.rest)
    rows = [axes @ camera.rest.camera_from_body[0] for camera in (left, right)]
    turned_rad = np.subtract(*(np.arctan2(row[1], row[0]) for row in rows))
    roll_rad = abs(float(np.arctan2(np.sin(turned_rad), np.cos(turned_rad))))
    if roll_rad > _MOST_ROLL_RAD:
        raise ConfigError(
            f"airframe '{name}': the cameras are rolled by {np.degrees(roll_rad):.0f} degrees against each other, and "
            f"are not matched beyond {np.degrees(_MOST_ROLL_RAD):.0f}; mount both the same way up, and give "
            "axes and rotation_rad as mounted"
        )
    ratios = np.diag(left.lens.matrix)[:2] / np.diag(right.lens.matrix)[:2]
    ratio = float(np.max(np.maximum(ratios, 1.0 / ratios)))
    if ratio > _MOST_SCALE_RATIO:
        raise ConfigError(
            f"airframe '{name}': the focal lengths of the cameras differ by a factor of {ratio:.2f}, and images are "
            f"not matched beyond {_MOST_SCALE_RATIO:g}; use the same lens twice, or scale the larger images down"
        )
