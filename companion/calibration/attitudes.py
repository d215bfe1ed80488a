"""From a recording: the instants at which the aircraft was held still, what a section felt and what its camera saw."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import cv2
import numpy as np

from companion.calibration.boards import Board, Corners, find_corners
from companion.calibration.flight_modes import station_samples
from companion.calibration.mounting import Attitude
from companion.core.clock.bank import ClockBank
from companion.core.stereo.geometry import Lens, MountedCamera
from companion.core.stereo.rotation import exp_rotation
from companion.errors import ConfigError, RecordingError
from companion.params.airframe import Airframe
from companion.records import Bytes, ClockName, Floats, Frame, FramePair, Ints, Record, Side, Station, TimesyncReply

_AROUND_NS = 250_000_000  # chosen: samples about an image: short beside a hand's patience, long beside noise
_LEAST_SAMPLES = 10  # for a mean whose noise does not matter beside the bias (choice)
_STILL_MPS2 = 0.3  # chosen: standard deviation about the mean, any axis: noise and a steady hand pass
_STILL_RADPS = 0.02  # a hand-held aircraft at rest (choice)
_APART_RAD = 0.05  # chosen: 3 degrees; less is the same attitude again and teaches nothing
_FIT_PX = 1.0  # a board that fits worse was not seen still (choice)
_STATIONS = {Side.LEFT: Station.LEFT, Side.RIGHT: Station.RIGHT}


class Recorded(Protocol):
    """A recording that can be read twice."""

    @property
    def hub(self) -> ClockName:
        """The clock that is the host's."""
        ...

    def records(self) -> Iterable[Record]:
        """Everything in arrival order."""
        ...


def find_attitudes(
    recording: Recorded, airframe: Airframe, board: Board, side: Side
) -> tuple[list[Attitude], dict[str, str]]:
    """Attitudes of one section, named by the time since the first image; and those refused, with the reason.

    An attitude is refused once, where none of its images shows the board well; it has the reason of the first.

    Raises
    ------
    ConfigError
        The airframe has no such camera.
    RecordingError
        The recording has no image of it, or the section's sensor sends no three axes of acceleration.
    """
    camera = airframe.left_camera if side is Side.LEFT else airframe.right_camera
    if camera is None:
        raise ConfigError(f"airframe '{airframe.name}' has no {side.name.lower()} camera")
    lens = MountedCamera.from_record(side, camera, f"{side.name.lower()}_camera").lens
    stamps, values = station_samples(recording.records(), recording.hub)[_STATIONS[side]]
    _three_axes(values, side)
    attitudes: list[Attitude] = []
    refused: dict[str, tuple[Floats, str]] = {}
    first_ns = None
    for t_ns, frame in _frames(recording, side):
        first_ns = t_ns if first_ns is None else first_ns
        up = _up(stamps, values, t_ns)
        if up is None or any(_alike(up, each.up_section) for each in attitudes):
            continue
        name = f"{(t_ns - first_ns) * 1e-9:.1f} s"
        earlier = [refusal for refusal, (refused_up, _) in refused.items() if _alike(up, refused_up)]
        rotation, why = _seen_board(frame.image, board, lens)
        if rotation is not None:
            attitudes.append(Attitude(name, up, rotation))
            for refusal in earlier:
                del refused[refusal]
        elif not earlier:
            refused[name] = up, why
    if first_ns is None:
        raise RecordingError(
            f"no image of the {side.name.lower()} camera whose clock is synced is in the recording; "
            "record with --record-images"
        )
    return attitudes, {name: why for name, (_, why) in refused.items()}


def _three_axes(values: Floats, side: Side) -> None:
    """Refuse a sensor without three axes of acceleration: columns that were not sent are zero."""
    silent = [axis for axis, column in zip("xyz", values.T, strict=False) if not np.any(column)]
    if len(values) and silent:
        raise RecordingError(
            f"the {side.name.lower()} section's sensor sends no acceleration along {' and '.join(silent)}, and without "
            "it nothing tells where up is: calibrate the mounting with nodes of three axes"
        )


def _alike(up: Floats, other: Floats) -> bool:
    """Whether two directions of up (3,) are those of the same attitude."""
    return float(np.arccos(np.clip(up @ other, -1.0, 1.0))) < _APART_RAD


def _seen_board(image: Bytes, board: Board, lens: Lens) -> tuple[Floats | None, str]:
    """``camera_from_board`` (3, 3) and nothing, or None and why not."""
    corners = find_corners(image, board)
    if corners is None:
        return None, "still, but no board in the image"
    rotation, error_px = _board_rotation(corners, board, lens)
    if error_px > _FIT_PX:
        return None, f"the board fits the calibrated lens only to {error_px:.2f} px"
    return rotation, ""


def _frames(recording: Recorded, side: Side) -> Iterable[tuple[int, Frame]]:
    """Frames of one side with their mid-exposure on the host's clock."""
    bank = ClockBank()
    bank.identity(recording.hub)
    for record in recording.records():
        if isinstance(record, TimesyncReply):
            bank.exchange(record)
        frame = record
        if isinstance(record, FramePair):
            frame = record.left if side is Side.LEFT else record.right
        if isinstance(frame, Frame) and frame.side is side:
            answer = bank.to_host(frame.clock, np.array([frame.mid_exposure_ns]))
            if isinstance(answer, tuple):
                yield int(answer[0][0]), frame


def _up(stamps: Ints, values: Floats, t_ns: int) -> Floats | None:
    """Unit vector up in section axes around an instant; None where the aircraft moved or nothing was measured."""
    first, last = np.searchsorted(stamps, [t_ns - _AROUND_NS, t_ns + _AROUND_NS])
    near = values[first:last]
    if len(near) < _LEAST_SAMPLES:
        return None
    mean = near.mean(axis=0)
    moving = np.any(near[:, :3].std(axis=0) > _STILL_MPS2) or np.any(np.abs(mean[3:]) > _STILL_RADPS)
    return None if moving else mean[:3] / np.linalg.norm(mean[:3])


def _board_rotation(corners: Corners, board: Board, lens: Lens) -> tuple[Floats, float]:
    """``camera_from_board`` (3, 3), and the rms distance of the corners from it, px."""
    points = board.points_m()[corners.ids]
    _, turn, place = cv2.solvePnP(points, corners.pixels, lens.matrix, lens.distortion)
    rotation = exp_rotation(np.asarray(turn, dtype=np.float64).ravel())
    off = lens.project(points @ rotation.T + np.asarray(place, dtype=np.float64).ravel()) - corners.pixels
    return rotation, float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
