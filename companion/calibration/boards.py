"""Calibration boards in images: chessboard and ChArUco, corners to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.errors import ConfigError
from companion.records import Bytes, Floats, Ints

_DICTIONARY = cv2.aruco.DICT_4X4_250
_MARKER_SHARE = 0.75
LEAST_CORNERS = 12


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board.

    Attributes
    ----------
    kind : str
        "chessboard" or "charuco".
    squares : (int, int)
        Squares across and down; a chessboard has one inner corner less each way.
    square_m : float
        Side of a square.
    """

    kind: str
    squares: tuple[int, int]
    square_m: float

    def __post_init__(self) -> None:
        if self.kind not in ("chessboard", "charuco"):
            raise ConfigError(f"board '{self.kind}' is not known: chessboard or charuco")
        if min(self.squares) < 4 or not self.square_m > 0.0:
            raise ConfigError("a board needs at least 4 x 4 squares of positive size")

    @property
    def inner(self) -> tuple[int, int]:
        """Inner corners across and down."""
        return self.squares[0] - 1, self.squares[1] - 1

    def points_m(self) -> Floats:
        """Inner corners (n, 3) on the board, row by row, z = 0."""
        across, down = self.inner
        grid = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1).reshape(-1, 2)
        return np.column_stack([self.square_m * (grid + 1.0), np.zeros(len(grid))])

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board of this size, dictionary 4x4_250, markers three quarters of a square."""
        dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
        return cv2.aruco.CharucoBoard(self.squares, self.square_m, _MARKER_SHARE * self.square_m, dictionary)


@dataclass(frozen=True, slots=True)
class Corners:
    """Corners that were found: which of the board's (n,), and where (n, 2), px."""

    ids: Ints
    pixels: Floats


def find_corners(image: Bytes, board: Board) -> Corners | None:
    """Corners of the board in an image; None where it is not seen (a chessboard has to be seen whole)."""
    if board.kind == "charuco":
        return _charuco(image, board)
    seen, corners = cv2.findChessboardCornersSB(image, board.inner, flags=cv2.CALIB_CB_ACCURACY)
    if not seen:
        return None
    pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return Corners(np.arange(len(pixels)), _upright(pixels))


def common(left: Corners, right: Corners) -> Ints:
    """Ids of the corners that both cameras see."""
    return np.intersect1d(left.ids, right.ids)


def _upright(pixels: Floats) -> Floats:
    """A plain chessboard looks alike after half a turn; both cameras are to count from the corner nearer the top."""
    return pixels if pixels[0, 1] + 0.1 * pixels[0, 0] <= pixels[-1, 1] + 0.1 * pixels[-1, 0] else pixels[::-1].copy()


def _charuco(image: Bytes, board: Board) -> Corners | None:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.CharucoDetector(board.charuco(), cv2.aruco.CharucoParameters(), parameters)
    corners, ids, _, _ = detector.detectBoard(image)
    if ids is None or len(ids) < LEAST_CORNERS:
        return None
    return Corners(np.asarray(ids, dtype=np.int64).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 2))
