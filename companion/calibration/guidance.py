"""Advice on a set of board views: missing image coverage, tilts, distances, number."""

from __future__ import annotations

import cv2
import numpy as np

from companion.calibration.boards import Board, Corners, begins_above
from companion.calibration.stereo_rig import CELLS, BoardView, cells
from companion.records import Floats, Side

ENOUGH_VIEWS = 20  # OpenCV's usual advice, 10 to 20
_ENOUGH_CELLS = 12  # chosen: of the 16 of each image; corners may stay empty
_TILT = 0.06  # relative change of scale across the board: about 10 degrees at arm's length (choice)
_TILTED_VIEWS = 2  # each way: one may be refused (choice)
_DISTANCES = 1.4  # chosen: farthest over nearest: tells focal length from distance
_NEW_PX = 0.06  # of the image width: how far a board has to move to be another view (choice)

_ROWS = ("top", "upper middle", "lower middle", "bottom")
_COLUMNS = ("left", "left of the middle", "right of the middle", "right")
_TILTS = (
    (0, 1.0, "its left edge toward the cameras"),
    (0, -1.0, "its right edge toward the cameras"),
    (1, 1.0, "its top toward the cameras"),
    (1, -1.0, "its bottom toward the cameras"),
)


def advice(views: list[BoardView], board: Board, size_px: tuple[int, int], wanted: int = ENOUGH_VIEWS) -> list[str]:
    """Sentences that say what to do next, the most useful one first; none when the set is complete.

    ``views`` are those taken so far, of ``wanted``; ``size_px`` is width and height.
    """
    said = [text for side in Side if (text := _missing_cells(views, side, size_px))]
    if views:
        tilt = np.array([perspective(view.left, board) for view in views])
        for axis, sign, text in _TILTS:
            if int(np.sum(sign * tilt[:, axis] > _TILT)) < _TILTED_VIEWS:
                said.append(f"tilt the board, {text}")
        reach = [_square_px(view.left, board) for view in views]
        if max(reach) < _DISTANCES * min(reach):
            said.append("vary the distance: some views nearer, some farther")
    if len(views) < wanted:
        said.append(f"{wanted - len(views)} more views")
    return said


def is_new(view: BoardView, others: list[BoardView], size_px: tuple[int, int]) -> bool:
    """Whether a view differs from all others: its corners lie elsewhere, or the board stands at another angle."""
    return all(_apart(view.left, other.left) > _NEW_PX * size_px[0] for other in others)


def perspective(corners: Corners, board: Board) -> Floats:
    """(2,) how the board's scale in the image falls from its left to its right edge, and from top to bottom.

    From the homography board -> image, whose denominator ``1 + a x + b y`` grows with depth. A chessboard that counts
    from its lower end has its edges as they are seen.
    """
    inner = board.points_m()[:, :2]
    centred = (inner - inner.mean(axis=0))[corners.ids]
    homography, _ = cv2.findHomography(centred.astype(np.float32), corners.pixels.astype(np.float32))
    if homography is None:
        return np.zeros(2)
    extent = inner.max(axis=0) - inner.min(axis=0)
    falls: Floats = np.asarray(homography[2, :2] / homography[2, 2] * extent, dtype=np.float64)
    return -falls if board.kind == "chessboard" and not begins_above(corners.pixels) else falls


def _missing_cells(views: list[BoardView], side: Side, size_px: tuple[int, int]) -> str:
    covered = {cell for view in views for cell in cells(view.left if side is Side.LEFT else view.right, size_px)}
    if len(covered) >= _ENOUGH_CELLS:
        return ""
    missing = [(row, column) for row in range(CELLS) for column in range(CELLS) if (column, row) not in covered]
    row, column = missing[0]
    more = f" and {len(missing) - 1} more parts" if len(missing) > 1 else ""
    return f"bring the board to the {_ROWS[row]} {_COLUMNS[column]} of the {side.name.lower()} image{more}"


def _square_px(corners: Corners, board: Board) -> float:
    """Mean side of a square in the image."""
    points = board.points_m()[corners.ids, :2]
    spread = np.sqrt(np.sum(np.var(corners.pixels, axis=0)) / np.sum(np.var(points, axis=0)))
    return float(spread * board.square_m)


def _apart(first: Corners, second: Corners) -> float:
    """Rms distance of the corners that two views share, px; infinite where they share none."""
    shared, in_first, in_second = np.intersect1d(first.ids, second.ids, return_indices=True)
    if not len(shared):
        return float("inf")
    return float(np.sqrt(np.mean(np.sum((first.pixels[in_first] - second.pixels[in_second]) ** 2, axis=1))))
