"""DepthAI (OAK) cameras, API version 3: one device with two sensors, or one device at each wingtip.

``dai.Clock`` is the host's monotonic clock and the library maps device stamps to it, so frames come on ``HOST``.
The library is imported when a device is opened: it takes 95 MB.
"""

from __future__ import annotations

import datetime
import importlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.errors import DeviceError
from companion.params.airframe import Camera
from companion.records import ClockName, Frame, Side

PLAN_UNKNOWN = -1
_POLL_S = 0.001


@dataclass(frozen=True, slots=True)
class OakSensor:
    """Where one camera is: the device's id or IP address ("" for the only one), and its socket ("CAM_B")."""

    device: str
    socket: str


@dataclass(frozen=True, slots=True)
class OakTiming:
    """How a sensor exposes.

    Attributes
    ----------
    external : bool
        Exposures start with edges on the FSYNC line (1.8 V; the sensor has to be a global-shutter one with snapshots).
        Without, the sensors run free and the frame nearest the plan is chosen.
    """

    exposure_us: int = 2000
    iso: int = 400
    rate_hz: float = 30.0
    external: bool = False
    row_time_ns: int = 0


class OakPair:
    """Implements :class:`companion.ports.CameraPair`.

    Parameters
    ----------
    left, right : OakSensor
        Equal ``device`` means one device with two sensors.
    size_px : tuple
        Width, height.
    timing : OakTiming
        Exposure and trigger.

    Raises
    ------
    DeviceError
        The library or a device is missing, or a socket has no camera.
    """

    def __init__(self, left: OakSensor, right: OakSensor, size_px: tuple[int, int], timing: OakTiming) -> None:
        self._dai, self._timing = library(), timing
        self._pipelines: dict[str, Any] = {}
        self._queues: list[Any] = []
        try:
            for sensor in (left, right):
                self._queues.append(self._open(sensor, size_px))
            for pipeline in self._pipelines.values():
                pipeline.start()
        except RuntimeError as error:
            self.close()
            raise DeviceError(f"DepthAI camera: {error}") from error

    def poll(self, timeout_s: float) -> list[Frame]:
        """Frames that have arrived within the timeout; :class:`DeviceError` when a device is gone."""
        until = time.monotonic() + timeout_s
        while True:
            try:
                frames = [
                    frame_of(image, side, self._timing, self._dai)
                    for side, queue in zip(Side, self._queues, strict=True)
                    for image in queue.tryGetAll()
                ]
            except RuntimeError as error:
                raise DeviceError(f"DepthAI camera: {error}") from error
            if frames or time.monotonic() >= until:
                return frames
            time.sleep(_POLL_S)

    def close(self) -> None:
        """Stop the pipelines, release the devices."""
        for pipeline in self._pipelines.values():
            pipeline.stop()

    def _open(self, sensor: OakSensor, size_px: tuple[int, int]) -> Any:
        dai = self._dai
        if sensor.device not in self._pipelines:
            device = dai.Device(dai.DeviceInfo(sensor.device)) if sensor.device else dai.Device()
            self._pipelines[sensor.device] = dai.Pipeline(device)
        socket = getattr(dai.CameraBoardSocket, sensor.socket, None)
        if socket is None:
            raise DeviceError(f"DepthAI has no camera socket '{sensor.socket}'; CAM_A, CAM_B, CAM_C ...")
        node = self._pipelines[sensor.device].create(dai.node.Camera).build(socket)
        configure(node.initialControl, self._timing, dai)
        output = node.requestOutput(size_px, dai.ImgFrame.Type.GRAY8, fps=self._timing.rate_hz)
        return output.createOutputQueue(maxSize=8, blocking=False)


def configure(control: Any, timing: OakTiming, dai: Any) -> None:
    """Set manual exposure, and the external trigger where it is wanted, on a ``CameraControl``."""
    control.setManualExposure(timing.exposure_us, timing.iso)
    if timing.external:
        control.setFrameSyncMode(dai.CameraControl.FrameSyncMode.INPUT)
        control.setExternalTrigger(1, 0)


def frame_of(image: Any, side: Side, timing: OakTiming, dai: Any) -> Frame:
    """Our record of a ``dai.ImgFrame``: middle of the exposure on the host's clock, exposure as reported."""
    middle: datetime.timedelta = image.getTimestamp(dai.CameraExposureOffset.MIDDLE)
    exposure: datetime.timedelta = image.getExposureTime()
    exposure_ns = _nanoseconds(exposure) or 1000 * timing.exposure_us
    return Frame(
        side=side,
        sequence=int(image.getSequenceNum()),
        clock=ClockName.HOST,
        mid_exposure_ns=_nanoseconds(middle),
        exposure_ns=exposure_ns,
        row_time_ns=timing.row_time_ns,
        plan_id=PLAN_UNKNOWN,
        image=np.ascontiguousarray(image.getCvFrame(), dtype=np.uint8),
    )


def camera_to_handler(handler: Any, socket: str, camera: Camera) -> None:
    """Write a calibrated lens into a ``dai.CalibrationHandler`` (then ``eepromToJsonFile`` or ``flashCalibration``)."""
    place = getattr(library().CameraBoardSocket, socket)
    focal, tall = camera.focal_px.value, camera.focal_px.value * camera.focal_ratio
    across, down = camera.principal_px
    matrix = [[focal, 0.0, across], [0.0, tall, down], [0.0, 0.0, 1.0]]
    handler.setCameraIntrinsics(place, matrix, camera.width_px, camera.height_px)
    handler.setDistortionCoefficients(place, [*camera.distortion, *([0.0] * (14 - len(camera.distortion)))])


def lens_from_handler(handler: Any, socket: str, size_px: tuple[int, int]) -> dict[str, Any]:
    """Read a lens as fields of :class:`companion.params.airframe.Camera`, for ``dataclasses.replace``.

    Raises
    ------
    DeviceError
        The device is not calibrated there, or its model has rational terms that ours does not.
    """
    place = getattr(library().CameraBoardSocket, socket)
    try:
        matrix = handler.getCameraIntrinsics(place, *size_px)
        bent = list(handler.getDistortionCoefficients(place))
    except RuntimeError as error:
        raise DeviceError(f"no calibration for {socket}: {error}") from error
    if any(abs(term) > 0.0 for term in bent[5:]):
        raise DeviceError(f"{socket} has a rational lens model; run 'spanwise calibrate stereo' for five terms")
    return {
        "focal": float(matrix[0][0]),
        "focal_ratio": float(matrix[1][1] / matrix[0][0]),
        "principal_px": (float(matrix[0][2]), float(matrix[1][2])),
        "distortion": tuple(float(term) for term in bent[:5]),
    }


def library() -> Any:
    """The ``depthai`` module; :class:`DeviceError` where it is not installed."""
    try:
        return importlib.import_module("depthai")
    except ImportError as error:
        raise DeviceError("DepthAI cameras need the depthai package, version 3") from error


def _nanoseconds(span: datetime.timedelta) -> int:
    return (span.days * 86400 + span.seconds) * 1_000_000_000 + span.microseconds * 1000
