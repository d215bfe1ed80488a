"""A stereo calibration between our airframe and a DepthAI device's handler or its JSON file.

A handler holds lenses per socket and the pose of one camera seen from the other: ``p_right = R p_left + t``, ``t`` in
centimetres. Our right camera takes it; the left one stays where the airframe has it.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from companion.adapters.cameras.oak import board_socket, library
from companion.errors import DeviceError
from companion.params.airframe import Camera, Uncertain
from companion.records import Floats

_M_PER_CM = 0.01  # DepthAI keeps translations in centimetres
_OUR_TERMS = 5  # k1 k2 p1 p2 k3, OpenCV's five
_THEIR_TERMS = 14  # length of DepthAI's distortion list
_AXIS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def handler_of(path: Path) -> Any:
    """Open a calibration file as ``eepromToJsonFile`` writes it; :class:`DeviceError` where it is none."""
    try:
        return library().CalibrationHandler(str(path.absolute()))
    except RuntimeError as error:
        raise DeviceError(f"{path}: not a DepthAI calibration: {error}") from error


def cameras_from_handler(handler: Any, sockets: tuple[str, str], left: Camera, right: Camera) -> tuple[Camera, Camera]:
    """Our two cameras with the handler's lenses, and the right one where the handler says it is.

    ``handler`` is the CalibrationHandler of a device, or :func:`handler_of` a file; ``sockets`` names the left and the
    right camera, as "CAM_B", "CAM_C". Size, axes and the left one's pose stay as the airframe has them.

    Raises
    ------
    DeviceError
        The device is not calibrated there, or its lens model is another than ours, or has terms that ours has not.
    """
    left, right = (_with_lens(handler, socket, camera) for socket, camera in zip(sockets, (left, right), strict=True))
    try:
        pose = np.array(handler.getCameraExtrinsics(*(_place(socket) for socket in sockets)), dtype=np.float64)
    except RuntimeError as error:
        raise DeviceError(f"no relative pose of {sockets[0]} and {sockets[1]}: {error}") from error
    right_from_body = pose[:3, :3] @ _camera_from_body(left)
    apart_m = -right_from_body.T @ pose[:3, 3] * _M_PER_CM
    turned, _ = cv2.Rodrigues((right_from_body @ _axes_from_body(right).T).T)
    x, y, z = (float(entry) for entry in np.asarray(turned).ravel())
    px, py, pz = (float(entry) for entry in np.array(left.position_m) + apart_m)
    return left, dataclasses.replace(right, rotation_rad=(x, y, z), position_m=(px, py, pz))


def cameras_to_handler(handler: Any, sockets: tuple[str, str], left: Camera, right: Camera) -> None:
    """Write our pair into a handler (then ``eepromToJsonFile`` or ``Device.flashCalibration``)."""
    for socket, camera in zip(sockets, (left, right), strict=True):
        focal, tall = camera.focal_px.value, camera.focal_px.value * camera.focal_ratio
        across, down = camera.principal_px
        matrix = [[focal, 0.0, across], [0.0, tall, down], [0.0, 0.0, 1.0]]
        handler.setCameraIntrinsics(_place(socket), matrix, camera.width_px, camera.height_px)
        terms = [*camera.distortion, *([0.0] * (_THEIR_TERMS - len(camera.distortion)))]
        handler.setDistortionCoefficients(_place(socket), terms)
    right_from_body = _camera_from_body(right)
    turn = right_from_body @ _camera_from_body(left).T
    shift_cm = -right_from_body @ (np.array(right.position_m) - np.array(left.position_m)) / _M_PER_CM
    handler.setCameraExtrinsics(
        _place(sockets[0]), _place(sockets[1]), turn.tolist(), shift_cm.tolist(), shift_cm.tolist()
    )


def _with_lens(handler: Any, socket: str, camera: Camera) -> Camera:
    try:
        matrix = handler.getCameraIntrinsics(_place(socket), camera.width_px, camera.height_px)
        bent = [float(term) for term in handler.getDistortionCoefficients(_place(socket))]
        model = handler.getDistortionModel(_place(socket))
    except RuntimeError as error:
        raise DeviceError(f"no calibration for {socket}: {error}") from error
    if model != library().CameraModel.Perspective:
        raise DeviceError(f"{socket} has a lens model of another kind ({model.name}); run 'spanwise calibrate stereo'")
    if any(abs(term) > 0.0 for term in bent[_OUR_TERMS:]):
        raise DeviceError(f"{socket} has a rational lens model; run 'spanwise calibrate stereo' for five terms")
    k1, k2, p1, p2, k3 = [*bent[:_OUR_TERMS], *([0.0] * (_OUR_TERMS - len(bent)))]
    return dataclasses.replace(
        camera,
        focal_px=Uncertain(float(matrix[0][0]), camera.focal_px.sigma),
        focal_ratio=float(matrix[1][1] / matrix[0][0]),
        principal_px=(float(matrix[0][2]), float(matrix[1][2])),
        distortion=(k1, k2, p1, p2, k3),
    )


def _place(socket: str) -> Any:
    return board_socket(socket, library())


def _camera_from_body(camera: Camera) -> Floats:
    turned, _ = cv2.Rodrigues(-np.array(camera.rotation_rad, dtype=np.float64))
    attitude: Floats = np.asarray(turned, dtype=np.float64) @ _axes_from_body(camera)
    return attitude


def _axes_from_body(camera: Camera) -> Floats:
    signs = [-1.0 if axis.startswith("-") else 1.0 for axis in camera.axes]
    return np.array([sign * np.array(_AXIS[axis[-1]]) for sign, axis in zip(signs, camera.axes, strict=True)])
