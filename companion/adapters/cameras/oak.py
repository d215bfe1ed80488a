"""DepthAI (OAK) cameras, API version 3: one device with two sensors, or one device at each wingtip.

``dai.Clock`` is the host's monotonic clock and the library maps device stamps to it, so frames come on ``HOST``.
The library is imported when a device is opened: it takes 95 MB.
"""

from __future__ import annotations

import dataclasses
import datetime
import functools
import os
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.cameras.oak_soft import SoftTriggerReceiver, fire_queue
from companion.adapters.triggers.oak import SoftLine
from companion.errors import DeviceError, import_extra
from companion.records import PLAN_UNKNOWN, ClockName, Frame, Side

_POLL_S = 0.001  # chosen: a frame waits no longer than this, and the loop costs next to nothing


@dataclass(frozen=True, slots=True)
class OakSensor:
    """Where one camera is: the device's id or IP address ("" for the only one), and its socket ("CAM_B")."""

    device: str
    socket: str


@dataclass(frozen=True, slots=True)
class OakTiming:
    """Exposure settings of a sensor.

    With ``external`` exposures start with edges on the FSYNC line (1.8 V; the sensor has to be a global-shutter one
    with snapshots); without, the sensors run free and the frame nearest the plan is chosen.
    """

    exposure_us: int = 2000
    iso: int = 400
    rate_hz: float = 30.0
    external: bool = False
    row_time_ns: int = 0


class QueuePair:
    """Implements :class:`companion.ports.CameraPair` over the output queues of DepthAI pipelines, left and right."""

    def __init__(self, timing: OakTiming) -> None:
        self._dai, self._timing = library(), timing
        self._pipelines: dict[str, Any] = {}
        self._queues: list[Any] = []

    def poll(self, timeout_s: float) -> list[Frame]:
        """Frames that have arrived within the timeout; :class:`DeviceError` when a device is gone."""
        until = time.monotonic() + timeout_s
        while True:
            try:
                frames = [frame_of(image, side, self._timing, self._dai) for side, image in self._images()]
            except (RuntimeError, self._dai.MessageQueue.QueueException) as error:
                raise DeviceError(f"DepthAI camera: {error}") from error
            if frames or time.monotonic() >= until:
                return frames
            time.sleep(_POLL_S)

    def close(self) -> None:
        """Stop the pipelines, release the devices."""
        for pipeline in self._pipelines.values():
            pipeline.stop()

    def _images(self) -> list[tuple[Side, Any]]:
        """Images that have arrived, with their sides."""
        return [(side, image) for side, queue in zip(Side, self._queues, strict=True) for image in queue.tryGetAll()]

    def _start(self) -> None:
        for pipeline in self._pipelines.values():
            pipeline.start()


class OakPair(QueuePair):
    """One device with two sensors, or one device at each wingtip.

    Sensors of equal ``device`` are two of one device; ``size_px`` is width and height. With ``soft`` and
    ``timing.external`` the devices pull their FSYNC line themselves when they are told to.

    Raises
    ------
    DeviceError
        The library or a device is missing, a socket has no camera, or the FSYNC line cannot be an input.
    """

    def __init__(
        self,
        left: OakSensor,
        right: OakSensor,
        size_px: tuple[int, int],
        timing: OakTiming,
        soft: SoftLine | None = None,
    ) -> None:
        super().__init__(timing)
        self._soft = soft
        self._fire: list[Any] = []
        self._receiver: SoftTriggerReceiver | None = None
        try:
            for sensor in (left, right):
                self._queues.append(self._open(sensor, size_px))
            self._start()
            if soft is not None:
                self._receiver = SoftTriggerReceiver(soft, self._fire, self._dai)
        except DeviceError:
            self.close()
            raise
        except RuntimeError as error:
            self.close()
            raise DeviceError(f"DepthAI camera: {error}") from error

    def close(self) -> None:
        """Stop firing and the pipelines, release the devices."""
        if self._receiver is not None:
            self._receiver.close()
        super().close()

    def _open(self, sensor: OakSensor, size_px: tuple[int, int]) -> Any:
        dai = self._dai
        if sensor.device not in self._pipelines:
            device = dai.Device(dai.DeviceInfo(sensor.device)) if sensor.device else dai.Device()
            if self._timing.external and self._soft is None:
                listen_to_line(device, dai)
            self._pipelines[sensor.device] = untouched(dai.Pipeline(device), dai)
            if self._soft is not None:
                self._fire.append(fire_queue(self._pipelines[sensor.device], self._soft, dai))
        node = self._pipelines[sensor.device].create(dai.node.Camera)
        return camera_queue(node, sensor.socket, size_px, self._timing, dai)


class OakReplayPair(QueuePair):
    """Two video files through DepthAI's own replay nodes, on a pipeline without a device, at their own pace.

    Everything behind the queues is the same as with a device. The two nodes keep no common time; frames of
    equal number get the left one's stamp. The pace is ``timing.rate_hz``; after the last image :meth:`poll` says that
    the videos have ended.

    Raises
    ------
    DeviceError
        The library or a file is missing.
    """

    def __init__(self, left: Path, right: Path, timing: OakTiming) -> None:
        super().__init__(timing)
        dai = self._dai
        pipeline = untouched(dai.Pipeline(createImplicitDevice=False), dai)
        self._pipelines["replay"] = pipeline
        self._waiting: dict[int, Frame] = {}
        # with its last image the library closes a queue and what still waits in it is lost: each is taken as it comes
        self._arrived: deque[tuple[Side, Any]] = deque()
        for side, path in zip(Side, (left, right), strict=True):
            if not path.is_file():
                raise DeviceError(f"{path}: no such video")
            node = pipeline.create(dai.node.ReplayVideo)
            node.setReplayVideoFile(path)
            node.setOutFrameType(dai.ImgFrame.Type.GRAY8)
            node.setFps(timing.rate_hz)
            node.setLoop(False)
            queue = node.out.createOutputQueue(maxSize=1, blocking=False)
            queue.addCallback(functools.partial(self._take, side))
            self._queues.append(queue)
        try:
            self._start()
        except RuntimeError as error:
            raise DeviceError(f"DepthAI replay: {error}") from error

    def poll(self, timeout_s: float) -> list[Frame]:
        """Pairs of which both frames have been played within the timeout."""
        frames: list[Frame] = []
        for frame in super().poll(timeout_s):
            other = self._waiting.pop(frame.sequence, None)
            if other is None:
                self._waiting[frame.sequence] = frame
                continue
            left, right = sorted((frame, other), key=lambda image: image.side)
            frames += [left, dataclasses.replace(right, mid_exposure_ns=left.mid_exposure_ns)]
        return frames

    def _take(self, side: Side, image: Any) -> None:
        self._arrived.append((side, image))

    def _images(self) -> list[tuple[Side, Any]]:
        ended = any(queue.isClosed() for queue in self._queues)
        arrived = [self._arrived.popleft() for _ in range(len(self._arrived))]
        if ended and not arrived:
            raise DeviceError("DepthAI replay: the videos have ended")
        return arrived


def camera_queue(node: Any, socket: str, size_px: tuple[int, int], timing: OakTiming, dai: Any) -> Any:
    """Set up a camera node and give the queue of its grey images; :class:`DeviceError` for an unknown socket."""
    built = node.build(board_socket(socket, dai))
    configure(built.initialControl, timing, dai)
    output = built.requestOutput(size_px, dai.ImgFrame.Type.GRAY8, fps=timing.rate_hz)
    return output.createOutputQueue(maxSize=8, blocking=False)


def board_socket(name: str, dai: Any) -> Any:
    """A camera's socket by its name; :class:`DeviceError` for an unknown one."""
    place = getattr(dai.CameraBoardSocket, name, None)
    if place is None:
        raise DeviceError(f"DepthAI has no camera socket '{name}'; CAM_A, CAM_B, CAM_C ...")
    return place


def listen_to_line(device: Any, dai: Any) -> None:
    """Make the device's FSYNC pin an input; :class:`DeviceError` where it refuses (no such pin, or none connected)."""
    done, why = device.setExternalFrameSyncRole(dai.ExternalFrameSyncRole.SLAVE)
    if not done:
        raise DeviceError(f"DepthAI camera does not listen to the FSYNC line: {why}")


def configure(control: Any, timing: OakTiming, dai: Any) -> None:
    """Set manual exposure, and the external trigger where it is wanted, on a ``CameraControl``."""
    control.setManualExposure(timing.exposure_us, timing.iso)
    if timing.external:
        control.setFrameSyncMode(dai.CameraControl.FrameSyncMode.INPUT)
        control.setExternalTrigger(1, 0)


def frame_of(image: Any, side: Side, timing: OakTiming, dai: Any) -> Frame:
    """Our record of a ``dai.ImgFrame``: middle of the exposure on the host's clock, exposure as reported.

    The library's stamp is the end of the exposure, of a rolling shutter that of the first row's: its maker says so at
    github.com/luxonis/depthai/issues/795, no such sensor was connected. Half the rows lead from the middle of the first
    row's exposure to that of the middle row's, which a :class:`companion.records.Frame` is stamped by.
    """
    middle: datetime.timedelta = image.getTimestamp(dai.CameraExposureOffset.MIDDLE)
    exposure: datetime.timedelta = image.getExposureTime()
    exposure_ns = _nanoseconds(exposure) or 1000 * timing.exposure_us
    pixels = np.ascontiguousarray(image.getCvFrame(), dtype=np.uint8)
    return Frame(
        side=side,
        sequence=int(image.getSequenceNum()),
        clock=ClockName.HOST,
        mid_exposure_ns=_nanoseconds(middle) + timing.row_time_ns * (pixels.shape[0] - 1) // 2,
        exposure_ns=exposure_ns,
        row_time_ns=timing.row_time_ns,
        plan_id=PLAN_UNKNOWN,
        image=pixels,
    )


def untouched(pipeline: Any, dai: Any) -> Any:
    """The pipeline with DepthAI's automatic calibration disabled.

    Where a calibrated pair of cameras is in it, DepthAI 3.6 and later would put a node in that calibrates when the
    pipeline starts, and writes the result to the device. On a wing that bends it would calibrate the bend.
    """
    pipeline.setAutoCalibrationMode(dai.Pipeline.AutoCalibrationMode.OFF)
    return pipeline


def library() -> Any:
    """The ``depthai`` module, with telemetry off unless the user turns it on (``DEPTHAI_TELEMETRY=1``).

    Raises
    ------
    DeviceError
        It is not installed.
    """
    os.environ.setdefault("DEPTHAI_TELEMETRY", "0")  # read when it is imported
    return import_extra("depthai", "OAK cameras", "oak", DeviceError)


def _nanoseconds(span: datetime.timedelta) -> int:
    return (span.days * 86400 + span.seconds) * 1_000_000_000 + span.microseconds * 1000
