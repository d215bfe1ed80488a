"""Calibration boards in images: chessboard and ChArUco, corners to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.errors import ConfigError
from companion.records import Bytes, Floats, Ints

_DICTIONARY = cv2.aruco.DICT_4X4_250
_MARKERS = 250  # that the dictionary has (by definition): a board has one in every second square
_MARKER_FRACTION = 0.75  # of a square: the usual ChArUco print (choice)
_MARKER_PX = 25.0  # measured: side of the smallest marker that is read in most rendered views (README.md)
LEAST_CORNERS = 12  # four determine a pose; twelve leave residuals to judge it by (choice)
LEAST_SQUARES = 4  # either way: fewer have corners in too few lines to tell a lens by (choice)
MOST_SQUARES = 100  # either way: no print is finer (choice)
# half window of the saddle point's refinement, in squares: a marker begins an eighth of a square from a corner
_WINDOW_SQUARES = {"chessboard": 0.25, "charuco": 0.11}
_WINDOW_PX = (2, 11)  # half window of the corner refinement, least and most (choice)
_DOWNWARD = np.array([0.1, 1.0])  # chosen: level boards are told apart by their ends
# numerical: steps at most, px: far below a corner's noise
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-4)


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board.

    ``kind`` is "chessboard" or "charuco"; ``squares`` are counted across and down (a chessboard has one inner corner
    less each way), ``square_m`` is the side of one.
    """

    kind: str
    squares: tuple[int, int]
    square_m: float

    def __post_init__(self) -> None:
        if self.kind not in ("chessboard", "charuco"):
            raise ConfigError(f"board '{self.kind}' is not known: chessboard or charuco")
        if min(self.squares) < LEAST_SQUARES or not self.square_m > 0.0:
            raise ConfigError(f"a board needs at least {LEAST_SQUARES} x {LEAST_SQUARES} squares of positive size")
        across, down = self.squares
        markers = across * down // 2
        if self.kind == "charuco" and markers > _MARKERS:
            raise ConfigError(
                f"a ChArUco board of {across} x {down} squares has {markers} markers, and the dictionary 4x4_250 has "
                f"{_MARKERS}: at most {2 * _MARKERS + 1} squares"
            )

    @property
    def inner(self) -> tuple[int, int]:
        """Inner corners across and down."""
        return self.squares[0] - 1, self.squares[1] - 1

    def points_m(self) -> Floats:
        """Inner corners (n, 3) on the board, row by row, z = 0."""
        across, down = self.inner
        grid = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1).reshape(-1, 2)
        return np.column_stack([self.square_m * (grid + 1.0), np.zeros(len(grid))])

    def hint(self, focal_px: float) -> str:
        """Which board is looked for, and how near it has to be: for one whose board no image shows."""
        across, down = self.squares
        sought = f"sought is a {self.kind} of {across} x {down} squares of {self.square_m:g} m"
        if self.kind == "chessboard":
            return f"{sought}, whole in both images"
        square_px = _MARKER_PX / _MARKER_FRACTION
        away_m = self.square_m * focal_px / square_px
        return f"{sought}, which need {square_px:.0f} px: at most {away_m:.1f} m away with this lens"

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board of this size, dictionary 4x4_250, markers three quarters of a square."""
        dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
        return cv2.aruco.CharucoBoard(self.squares, self.square_m, _MARKER_FRACTION * self.square_m, dictionary)


@dataclass(frozen=True, slots=True)
class Corners:
    """Detected corners: their numbers on the board (n,), and places in the image (n, 2), px."""

    ids: Ints
    pixels: Floats


def find_corners(image: Bytes, board: Board) -> Corners | None:
    """Corners of the board in an image; None where it is not seen (a chessboard has to be seen whole)."""
    detected = _charuco(image, board) if board.kind == "charuco" else _chessboard(image, board)
    return None if detected is None else Corners(detected.ids, _refined(image, detected, board))


def common(left: Corners, right: Corners) -> Ints:
    """Ids (n,) of the corners that both cameras see, ascending."""
    return np.intersect1d(left.ids, right.ids)


def _upright(pixels: Floats, board: Board) -> Floats:
    """Corners numbered so that both cameras agree: of a board that looks alike after half a turn, from the upper end.

    A chessboard does where across and down are both odd or both even; else its colours tell its ends apart, and the
    detector's order, which follows them, stays however the board is turned.
    """
    return pixels if sum(board.squares) % 2 or begins_above(pixels) else pixels[::-1].copy()


def begins_above(pixels: Floats) -> bool:
    """Whether the first of a chessboard's corners (n, 2) lies nearer the top of the image than the last one."""
    first, last = pixels[0] @ _DOWNWARD, pixels[-1] @ _DOWNWARD
    return bool(first <= last)


def _refined(image: Bytes, detected: Corners, board: Board) -> Floats:
    """Saddle points by gradients (Foerstner): the detectors' own corners have twice the error, and a systematic one."""
    place = {int(number): index for index, number in enumerate(detected.ids)}
    across = board.inner[0]
    beside = [(i, place[n + 1]) for n, i in place.items() if (n + 1) % across and n + 1 in place]
    if not beside:
        return detected.pixels
    pairs = np.array(beside)
    square_px = float(np.median(np.linalg.norm(detected.pixels[pairs[:, 0]] - detected.pixels[pairs[:, 1]], axis=1)))
    half = int(np.clip(round(_WINDOW_SQUARES[board.kind] * square_px), *_WINDOW_PX))
    start = detected.pixels.astype(np.float32).reshape(-1, 1, 2)
    moved = np.asarray(cv2.cornerSubPix(image, start, (half, half), (-1, -1), _STOP), dtype=np.float64).reshape(-1, 2)
    return moved


def _chessboard(image: Bytes, board: Board) -> Corners | None:
    complete, corners = cv2.findChessboardCornersSB(image, board.inner)
    if not complete:
        return None
    pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return Corners(np.arange(len(pixels)), _upright(pixels, board))


def _charuco(image: Bytes, board: Board) -> Corners | None:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.CharucoDetector(board.charuco(), cv2.aruco.CharucoParameters(), parameters)
    corners, ids, _, _ = detector.detectBoard(image)
    if ids is None or len(ids) < LEAST_CORNERS:
        return None
    return Corners(np.asarray(ids, dtype=np.int64).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 2))
