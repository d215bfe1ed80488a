"""Frames as ``foxglove.CompressedImage`` messages in JSON, with the fields of :class:`Frame` beside the image.

PNG is lossless, so vision can be replayed from it; JPEG is smaller and is not.
"""

from __future__ import annotations

import base64
import enum
from typing import Any

import cv2
import numpy as np

from companion.errors import RecordingError
from companion.records import Bytes, ClockName, Frame, Side

_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # chosen: 1 of 9: larger files, a fraction of the time
_GOOD_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 90]  # chosen: 90 of 100: a small file whose corners are whole


class ImageFormat(enum.StrEnum):
    """Format of stored images."""

    PNG = "png"
    JPEG = "jpeg"


_INTEGER = {"type": "integer"}
SCHEMA: dict[str, Any] = {
    "title": "foxglove.CompressedImage",
    "description": "A compressed image, with the exposure that companion.records.Frame tells",
    "type": "object",
    "properties": {
        "timestamp": {"type": "object", "title": "time", "properties": {"sec": _INTEGER, "nsec": _INTEGER}},
        "frame_id": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string"},
        "pair_id": {"anyOf": [_INTEGER, {"type": "null"}]},
        "side": _INTEGER,
        "sequence": _INTEGER,
        "clock": {"type": "string"},
        "mid_exposure_ns": _INTEGER,
        "exposure_ns": _INTEGER,
        "row_time_ns": _INTEGER,
        "plan_id": _INTEGER,
    },
}


def frame_to_plain(frame: Frame, pair_id: int | None, image_format: ImageFormat) -> dict[str, Any]:
    """Compress one frame; ``pair_id`` is None for a frame recorded alone."""
    options = _FAST_PNG if image_format is ImageFormat.PNG else _GOOD_JPEG
    good, data = cv2.imencode(f".{image_format}", frame.image, options)
    if not good:
        raise RecordingError(f"image of {frame.image.shape} cannot be compressed as {image_format}")
    seconds, nanoseconds = divmod(frame.mid_exposure_ns, 1_000_000_000)
    return {
        "timestamp": {"sec": seconds, "nsec": nanoseconds},
        "frame_id": f"{frame.side.name.lower()}_camera",
        "data": base64.b64encode(data.tobytes()).decode("ascii"),
        "format": str(image_format),
        "pair_id": pair_id,
        "side": int(frame.side),
        "sequence": frame.sequence,
        "clock": str(frame.clock),
        "mid_exposure_ns": frame.mid_exposure_ns,
        "exposure_ns": frame.exposure_ns,
        "row_time_ns": frame.row_time_ns,
        "plan_id": frame.plan_id,
    }


def grey_of(data: bytes) -> Bytes | None:
    """Decode an image of any usual format as (rows, columns) uint8; None where it cannot be read."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    except (cv2.error, MemoryError):  # sizes that no image has
        return None
    return None if image is None else np.ascontiguousarray(image, dtype=np.uint8)


def frame_from_plain(plain: dict[str, Any]) -> tuple[Frame, int | None]:
    """Give the frame and its pair id; raise RecordingError for an image that cannot be read."""
    image = grey_of(base64.b64decode(plain["data"]))
    if image is None:
        raise RecordingError(f"image {plain['sequence']} of {plain['frame_id']} cannot be read")
    frame = Frame(
        side=Side(plain["side"]),
        sequence=plain["sequence"],
        clock=ClockName(plain["clock"]),
        mid_exposure_ns=plain["mid_exposure_ns"],
        exposure_ns=plain["exposure_ns"],
        row_time_ns=plain["row_time_ns"],
        plan_id=plain["plan_id"],
        image=image,
    )
    return frame, plain["pair_id"]
