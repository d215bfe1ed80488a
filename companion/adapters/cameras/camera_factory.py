"""Camera pair of a ``--cameras`` option: ``kind:where`` becomes a picklable function that opens it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion.adapters.cameras.folder import FolderPair
from companion.adapters.cameras.oak import OakPair, OakReplayPair, OakSensor, OakTiming
from companion.adapters.cameras.paced import PacedPair, RecordedPair
from companion.adapters.cameras.video import CapturePair
from companion.adapters.clocks import MonotonicClock
from companion.adapters.triggers.oak import SoftLine
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Camera
from companion.ports import CameraPair

SPELLINGS = (
    "oak:CAM_B,CAM_C (one OAK device) or oak:<id>/CAM_A,<id>/CAM_A (one at each tip)",
    "v4l2:/dev/video0,/dev/video2 (left, right; numbers do too)",
    "folder:DIR (EuRoC layout: cam0 left, cam1 right)",
    "video:LEFT.avi,RIGHT.avi",
    "oak-replay:LEFT.avi,RIGHT.avi (through DepthAI's replay nodes)",
    "recording:FILE.mcap",
)
_UNDIVIDED = ("folder", "recording")  # kinds whose place is that of both cameras
_KINDS = tuple(spelling.partition(":")[0] for spelling in SPELLINGS)
_FREE_RUN_HZ = 30.0  # convention: the rate of most cameras


def parse_cameras(spelling: str, *, soft: bool = False) -> tuple[str, list[str]]:
    """Take one of :data:`SPELLINGS` apart into its kind and its places: left and right, or one for both.

    ``soft`` is whether the trigger is the DepthAI cameras' own.

    Raises
    ------
    ConfigError
        The spelling is none of these, or the software trigger is asked of other cameras than DepthAI's.
    """
    kind, colon, where = spelling.partition(":")
    if not colon or not where or kind not in _KINDS:
        raise ConfigError(f"--cameras {spelling}: not a camera pair; known are " + "; ".join(SPELLINGS))
    if soft and kind != "oak":
        raise ConfigError(f"--trigger oak fires DepthAI cameras only, not --cameras {spelling}")
    if kind in _UNDIVIDED:
        return kind, [where]
    words = [word.strip() for word in where.split(",")]
    if len(words) != 2 or not all(words):
        raise ConfigError(f"--cameras {spelling}: name the left and the right one, with a comma between")
    return kind, words


def camera_factory(
    spelling: str, airframe: Airframe, *, triggered: bool, soft: SoftLine | None = None
) -> Callable[[], CameraPair]:
    """Give what opens the pair, in whichever process uses it; files play at their own pace from then on.

    ``spelling`` is one of :data:`SPELLINGS`; size, exposure and row time are those of the airframe's cameras. With
    ``triggered`` exposures follow a trigger line, otherwise the cameras run free; ``soft`` is given where the trigger
    is the DepthAI cameras' own.

    Raises
    ------
    ConfigError
        The spelling is none of these, the airframe has no cameras or two that are exposed differently, or the software
        trigger is asked of other cameras than DepthAI's. What opening raises, the factory raises.
    """
    left, right = _cameras(airframe)
    kind, places = parse_cameras(spelling, soft=soft is not None)
    if kind == "oak":
        first, second = (_oak_sensor(word) for word in places)
        size_px = left.width_px, left.height_px
        return functools.partial(OakPair, first, second, size_px, _oak_timing(left, triggered), soft)
    if kind == "v4l2":
        return _v4l2(places, left, right, triggered=triggered)
    files = [Path(place) for place in places]
    if kind == "folder":
        return functools.partial(_paced, FolderPair, *files, **_times_ns(left))
    if kind == "video":
        return functools.partial(_paced, CapturePair, *files, **_times_ns(left))
    if kind == "oak-replay":
        first_file, second_file = files
        return functools.partial(OakReplayPair, first_file, second_file, _oak_timing(left, triggered))
    return functools.partial(_paced, RecordedPair, *files)


def _cameras(airframe: Airframe) -> tuple[Camera, Camera]:
    left, right = airframe.left_camera, airframe.right_camera
    if left is None or right is None:
        raise ConfigError(f"airframe '{airframe.name}' has no camera pair; leave --cameras out")
    if (left.exposure_s, left.row_time_s) != (right.exposure_s, right.row_time_s):
        raise ConfigError(
            f"airframe '{airframe.name}': exposure_s and row_time_s of left_camera and right_camera must be equal, "
            "both cameras are opened and stamped alike"
        )
    return left, right


def _oak_sensor(word: str) -> OakSensor:
    device, _, socket = word.rpartition("/")
    return OakSensor(device, socket)


def _oak_timing(camera: Camera, triggered: bool) -> OakTiming:
    return OakTiming(
        exposure_us=round(camera.exposure_s * 1e6),
        rate_hz=_FREE_RUN_HZ,
        external=triggered,
        row_time_ns=round(camera.row_time_s * 1e9),
    )


def _v4l2(words: list[str], left: Camera, right: Camera, *, triggered: bool) -> Callable[[], CameraPair]:
    """The driver stamps the end of the first row's exposure; from there back to the middle of the middle row's."""
    to_middle_s = 0.5 * left.row_time_s * (left.height_px - 1) - 0.5 * left.exposure_s
    first, second = (int(word) if word.isdecimal() else word for word in words)
    return functools.partial(
        CapturePair,
        first,
        second,
        **_times_ns(left),
        stamp_to_middle_ns=round(to_middle_s * 1e9),
        triggered=triggered,
        sizes_px=((left.width_px, left.height_px), (right.width_px, right.height_px)),
    )


def _paced(source: Callable[..., CameraPair], *files: Path, **times_ns: int) -> CameraPair:
    """Open a pair of files, which play at their own pace from now on."""
    return PacedPair(source(*files, **times_ns), MonotonicClock())


def _times_ns(camera: Camera) -> dict[str, Any]:
    return {"exposure_ns": round(camera.exposure_s * 1e9), "row_time_ns": round(camera.row_time_s * 1e9)}
