"""A calibration board that somebody holds before the cameras: drawn, moved about, seen through both lenses.

The rig stands on the ground, its wing at rest. Boards are drawn here once more, by OpenCV's generator (ChArUco) or as
plain squares, and share no code with what finds them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.stereo.geometry import MountedCamera, Rig
from companion.core.stereo.rotation import exp_rotation
from companion.records import Bytes, Floats, Side
from companion.sim.vision.texture import Image32

_TEXELS = 48  # per square: eight for each bit of a marker (choice)
_SOFT_TEXELS = 1.2  # print and paper soften an edge by about a texel (choice)
_PAPER, _WALL = 235.0, 120.0  # chosen: grey levels of white paper in daylight, and of a wall behind it
_INK = 15.0  # grey level of printed black in daylight (choice)
_NOISE = 1.5  # grey levels rms, an 8-bit machine-vision sensor (choice)
_TILT_RAD, _ROLL_RAD = 0.5, 0.2  # chosen: as people tilt a board, 29 degrees, and turn it, 11 degrees
_REACH = 1.6  # chosen: farthest over nearest distance: more than the guide asks for
_STILL_FRAMES = 3  # chosen: that a person holds the board still: enough for the guide to take it
_INSIDE = {"chessboard": 1.05, "charuco": 0.8}  # how much of the board has to be in both images


@dataclass(frozen=True, slots=True)
class ShownBoard:
    """Calibration board: "chessboard" or "charuco" (4x4_250, markers of 3/4 of a square), squares across and down."""

    kind: str
    squares: tuple[int, int]
    square_m: float

    @property
    def size_m(self) -> Floats:
        """(2,) width and height, without margin."""
        return self.square_m * np.array(self.squares, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class BoardPose:
    """Where the board is: its own coordinates (x across, y down, from its first corner) go to the left camera's.

    ``X = exp(turn_rad) X_board + place_m``.
    """

    turn_rad: Floats
    place_m: Floats


class BoardRenderer:
    """Images of a held board by both cameras of a rig."""

    def __init__(self, rig: Rig, board: ShownBoard, seed: int) -> None:
        self._board, self._seed = board, seed
        self._cameras = rig.left, rig.right
        self._print = _printed(board)
        self._rays = [_rays(camera) for camera in self._cameras]
        left, right = rig.left.rest, rig.right.rest
        self._right_from_left = right.camera_from_body @ left.camera_from_body.T
        self.right_in_left_m: Floats = left.camera_from_body @ (right.position_body_m - left.position_body_m)

    def render(self, side: Side, held: BoardPose, shot: int) -> Bytes:
        """Image (rows, columns); ``shot`` chooses the noise."""
        rotation, place_m = exp_rotation(held.turn_rad), held.place_m
        if side is Side.RIGHT:
            rotation = self._right_from_left @ rotation
            place_m = self._right_from_left @ (place_m - self.right_in_left_m)
        on_board_m = _meet(self._rays[side] @ rotation, rotation.T @ place_m)
        width, height = self._cameras[side].lens.size_px
        texel = on_board_m / self._board.square_m * _TEXELS + (_TEXELS - 0.5)  # the margin is one square wide
        where = texel.astype(np.float32).reshape(height, width, 2)
        image = cv2.remap(self._print, where, None, cv2.INTER_LINEAR, borderValue=_WALL)
        noise = np.random.default_rng([self._seed, side, shot, 0xB0A2]).standard_normal(image.shape, dtype=np.float32)
        return np.asarray(cv2.add(image, _NOISE * noise, dtype=cv2.CV_8U))


def board_poses(board: ShownBoard, rig: Rig, seed: int) -> Iterator[BoardPose]:
    """Where somebody holds the board, exposure by exposure, without end: still for three, one on the way, and again.

    Places are spread over what both cameras see, tilts to both sides, distances over a factor of 1.6. A chessboard is
    kept whole within both images; a ChArUco board may stick out.
    """
    rng = np.random.default_rng([seed, 0xB0A3])
    before = _hold(board, rig, rng)
    while True:
        held = _hold(board, rig, rng)
        yield BoardPose(0.5 * (before.turn_rad + held.turn_rad), 0.5 * (before.place_m + held.place_m))
        for _ in range(_STILL_FRAMES):
            yield held
        before = held


def _hold(board: ShownBoard, rig: Rig, rng: np.random.Generator) -> BoardPose:
    left, right = rig.left.rest, rig.right.rest
    apart_m = left.camera_from_body @ (right.position_body_m - left.position_body_m)
    field = np.array(rig.left.lens.size_px) / np.diag(rig.left.lens.matrix)[:2]  # image size over distance
    inside_m = _INSIDE[board.kind] * board.size_m
    depth_m = float(np.max((np.abs(apart_m[:2]) + inside_m) / field)) * _REACH ** rng.uniform()
    free_m = np.maximum(field * depth_m - np.abs(apart_m[:2]) - inside_m, 0.0)
    # the edges of the images are where lenses bend most, and where chance seldom leads
    where = np.sign(rng.uniform(-1.0, 1.0, 2)) * rng.uniform(size=2) ** 0.5
    middle_m = np.append(0.5 * apart_m[:2] + 0.5 * where * free_m, depth_m)
    turn_rad = rng.uniform(-1.0, 1.0, 3) * np.array([_TILT_RAD, _TILT_RAD, _ROLL_RAD])
    return BoardPose(turn_rad, middle_m - exp_rotation(turn_rad) @ np.append(0.5 * board.size_m, 0.0))


def _printed(board: ShownBoard) -> Image32:
    """The print with a margin of one square, edges a little soft."""
    across, down = board.squares
    if board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
        sheet = cv2.aruco.CharucoBoard(board.squares, board.square_m, 0.75 * board.square_m, dictionary)
        inner = sheet.generateImage((_TEXELS * across, _TEXELS * down))
    else:
        dark = np.add.outer(np.arange(down), np.arange(across)) % 2 == 0
        inner = np.kron(np.where(dark, 0, 255).astype(np.uint8), np.ones((_TEXELS, _TEXELS), np.uint8))
    sheet_255 = np.pad(np.asarray(inner, dtype=np.float32), _TEXELS, constant_values=255.0)
    soft = cv2.GaussianBlur(sheet_255, (0, 0), _SOFT_TEXELS)
    return np.asarray(_INK + (_PAPER - _INK) / 255.0 * soft, dtype=np.float32)


def _rays(camera: MountedCamera) -> Floats:
    width, height = camera.lens.size_px
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    return camera.lens.unproject(np.column_stack([columns.ravel(), rows.ravel()]))


def _meet(rays: Floats, origin_m: Floats) -> Floats:
    """Where rays (n, 3), board axes, that leave the camera meet the board's plane, (n, 2); far off behind the camera.

    ``origin_m`` is the board's origin as seen from the camera, in board axes.
    """
    closing = np.where(np.abs(rays[:, 2]) < 1e-9, 1e-9, rays[:, 2])
    factors = origin_m[2] / closing
    met: Floats = np.where(factors[:, np.newaxis] > 0.0, factors[:, np.newaxis] * rays - origin_m, 1e6)[:, :2]
    return met
