"""Pairs through OpenCV: two V4L2 cameras live, or two video files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from companion.errors import DeviceError
from companion.records import PLAN_UNKNOWN, Bytes, ClockName, Frame, Side

_BUFFERS = 4  # convention: frames that OpenCV lets a V4L2 driver hold
_APART_NS = 8_000_000  # chosen: as of two frames that are no pair (core/stereo/pairing.py)


class CapturePair:
    """Implements :class:`companion.ports.CameraPair` over two ``cv2.VideoCapture``.

    A V4L2 camera's stamp is the driver's, on the host's monotonic clock, when the frame began to arrive: the end of the
    exposure, to which ``stamp_to_middle_ns`` (negative) leads back. A frame without a stamp is an error, never "now".

    ``left`` and ``right`` are device numbers, device paths or files. The stamps are on ``clock``: HOST for devices, the
    hub's name for files. ``start_ns`` is added to every stamp of a file, whose stamps begin at 0. A ``triggered`` pair
    gives no frames while nothing triggers it; it is gone when its devices are. Devices are
    asked for images of ``sizes_px`` (width and height, left and right), files have theirs.
    """

    def __init__(
        self,
        left: int | str | Path,
        right: int | str | Path,
        *,
        clock: ClockName = ClockName.HOST,
        exposure_ns: int = 0,
        row_time_ns: int = 0,
        stamp_to_middle_ns: int = 0,
        start_ns: int = 0,
        triggered: bool = False,
        sizes_px: tuple[tuple[int, int], tuple[int, int]] | None = None,
    ) -> None:
        if triggered:  # else OpenCV waits 10 s for a frame; read when a device is opened
            os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")
        self._devices = [Path(f"/dev/video{source}" if isinstance(source, int) else source) for source in (left, right)]
        self._triggered = triggered
        self._clock, self._exposure_ns, self._row_time_ns = clock, exposure_ns, row_time_ns
        self._shift_ns = stamp_to_middle_ns + start_ns
        self._captures = [_opened(source) for source in (left, right)]
        self._live = not any(isinstance(source, Path) or Path(str(source)).is_file() for source in (left, right))
        if self._live and sizes_px is not None:
            for capture, size_px in zip(self._captures, sizes_px, strict=True):
                _ask_for_size(capture, size_px)
        self._sequence = [0, 0]

    def poll(self, timeout_s: float) -> list[Frame]:  # noqa: ARG002 - OpenCV waits for the frame itself
        """The next frame of both, and of a live camera that is behind the other the next ones; none at a file's end.

        A frame that one camera misses stays in the other's driver. Were it not fetched, all later pairs would be older
        by a frame. Where the wait for a trigger ends between the two, the frame of one alone.

        Raises
        ------
        DeviceError
            A live camera gives no more frames, or frames without a stamp.
        """
        grabbed = [side for side in Side if self._grab(side)]
        if len(grabbed) < len(Side):
            return [self._frame(side) for side in grabbed] if self._live else []
        frames = [self._frame(side) for side in Side]
        newest = list(frames)
        for _ in range(_BUFFERS if self._live else 0):
            behind = min(Side, key=lambda side: newest[side].mid_exposure_ns)
            apart_ns = newest[1 - behind].mid_exposure_ns - newest[behind].mid_exposure_ns
            if apart_ns <= _APART_NS or not self._grab(behind):
                break
            newest[behind] = self._frame(behind)
            frames.append(newest[behind])
        return frames

    def close(self) -> None:
        """Release both."""
        for capture in self._captures:
            capture.release()

    def _grab(self, side: Side) -> bool:
        grabbed = self._captures[side].grab()
        if not grabbed and self._live and not (self._triggered and all(device.exists() for device in self._devices)):
            raise DeviceError(f"camera {side.name.lower()} gives no more frames")
        return bool(grabbed)

    def _frame(self, side: Side) -> Frame:
        capture = self._captures[side]
        stamp_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        read, image = capture.retrieve()
        if not read or (self._live and stamp_ns <= 0):
            raise DeviceError(f"camera {side.name.lower()} gave a frame without {'stamp' if read else 'image'}")
        self._sequence[side] += 1
        return Frame(
            side=side,
            sequence=self._sequence[side] - 1,
            clock=self._clock,
            mid_exposure_ns=stamp_ns + self._shift_ns,
            exposure_ns=self._exposure_ns,
            row_time_ns=self._row_time_ns,
            plan_id=PLAN_UNKNOWN,
            image=_grey(image),
        )


def _opened(source: int | str | Path) -> Any:
    capture = cv2.VideoCapture(source if isinstance(source, int) else str(source))
    if not capture.isOpened():
        raise DeviceError(f"cannot open camera or video {source}")
    return capture


def _ask_for_size(capture: Any, size_px: tuple[int, int]) -> None:
    """Ask a device for a size, or OpenCV has it at 640 x 480; what it gives instead is seen in its images."""
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])


def _grey(image: Any) -> Bytes:
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(grey, dtype=np.uint8)
