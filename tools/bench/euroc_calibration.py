"""Reads a camera pair's calibration from the ``sensor.yaml`` files of EuRoC's layout."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from companion.errors import DeviceError
from companion.params.airframe import Camera, Uncertain, Vector3
from companion.records import Floats

_FORWARD_AXES = ("y", "z", "x")
_RADTAN = 4  # number of coefficients of the EuRoC format's radial-tangential model


@dataclass(frozen=True, slots=True)
class _Sensor:
    body_from_camera: Floats
    position_m: Floats
    size_px: tuple[int, int]
    intrinsics_px: Floats
    distortion: Floats


def euroc_cameras(folder: Path) -> tuple[Camera, Camera]:
    """Left and right camera of a folder with ``cam0/sensor.yaml`` and ``cam1/sensor.yaml``.

    The body axes that result are those of a forward-looking left camera without any rotation of its own: x its optical
    axis, y along its rows, z along its columns, origin midway between the cameras.

    Raises
    ------
    DeviceError
        A file is missing or has no pinhole camera with radial-tangential distortion.
    """
    left, right = (_read(folder / name / "sensor.yaml") for name in ("cam0", "cam1"))
    camera_from_frd = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    frd_from_body = camera_from_frd.T @ left.body_from_camera.T
    middle = 0.5 * (left.position_m + right.position_m)
    right_from_left = right.body_from_camera.T @ left.body_from_camera
    # records: the rotation vector turns the camera from its nominal axes, coordinates the other way round
    turned, _ = cv2.Rodrigues(right_from_left.T)
    x, y, z = (float(entry) for entry in np.asarray(turned).ravel())
    return (
        _camera(left, frd_from_body @ (left.position_m - middle), (0.0, 0.0, 0.0)),
        _camera(right, frd_from_body @ (right.position_m - middle), (x, y, z)),
    )


def _camera(sensor: _Sensor, position_m: Floats, rotation_rad: Vector3) -> Camera:
    focal, tall, across, down = (float(entry) for entry in sensor.intrinsics_px)
    k1, k2, p1, p2 = (float(entry) for entry in sensor.distortion)
    x, y, z = (float(entry) for entry in position_m)
    return Camera(
        width_px=sensor.size_px[0],
        height_px=sensor.size_px[1],
        focal_px=Uncertain(focal, 0.3),
        principal_px=(across, down),
        position_m=(x, y, z),
        axes=_FORWARD_AXES,
        rotation_rad=rotation_rad,
        distortion=(k1, k2, p1, p2, 0.0),
        focal_ratio=tall / focal,
    )


def _read(path: Path) -> _Sensor:
    if not path.is_file():
        raise DeviceError(f"{path}: no such file")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        transform = _numbers(storage.getNode("T_BS").getNode("data"))
        size, focal = _numbers(storage.getNode("resolution")), _numbers(storage.getNode("intrinsics"))
        distortion = _numbers(storage.getNode("distortion_coefficients"))
    finally:
        storage.release()
    if len(transform) != 16 or len(size) != 2 or len(focal) != 4 or len(distortion) != _RADTAN:
        raise DeviceError(f"{path}: needs T_BS, resolution, intrinsics and four radial-tangential coefficients")
    matrix = transform.reshape(4, 4)
    return _Sensor(matrix[:3, :3], matrix[:3, 3], (math.floor(size[0]), math.floor(size[1])), focal, distortion)


def _numbers(node: cv2.FileNode) -> Floats:
    return np.array([node.at(i).real() for i in range(node.size())], dtype=np.float64)
