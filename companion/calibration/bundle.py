"""Bundle adjustment of a stereo rig: both lenses, their relative pose and every board pose at once, with covariance.

Gauss-Newton on all corners of both cameras, damped where a step would not lower the error. The board poses are
eliminated (Schur complement), which leaves normal equations of the 24 shared parameters; their inverse, times the
variance of the residuals, is the covariance of lenses and pose together, so that what trades against what (focal length
against distance, principal point against rotation) is in every sigma.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.calibration.boards import Corners
from companion.records import Floats

LENS = 9  # fx, fy, cx, cy, k1, k2, p1, p2, k3 (by definition)
SHARED = 2 * LENS + 6  # two lenses, rotation and translation (by definition)
_MAX_STEPS = 30  # steps at most, refused ones too; it ends earlier once settled (numerical)
_FIRST_DAMPING = 1e-4  # of the unit diagonal, after a step that raised the error (numerical)
_DAMPING_FACTOR = 10.0  # damping grows by it after a step that raised the error, and shrinks after another (numerical)
_SETTLED = 1e-9  # relative step at which rounding rules (numerical)
_JACOBIAN_COLUMNS = np.r_[
    6:10, 10:15
]  # of projectPoints' derivatives: rotation, translation, focal, principal, distortion


@dataclass(frozen=True, slots=True)
class Bundle:
    """A rig fitted to views.

    Attributes
    ----------
    shared : (24,) float64
        Left lens (9), right lens (9), rotation vector (3, rad) and translation (3, m) from left to right coordinates.
    covariance : (24, 24) float64
    boards : (views, 6) float64
        Rotation vector and translation from the board to the left camera.
    residuals_px : list of (Floats, Floats)
        Seen minus projected, (n, 2) each, of left and right in every view.
    """

    shared: Floats
    covariance: Floats
    boards: Floats
    residuals_px: list[tuple[Floats, Floats]]

    def view_errors_px(self) -> Floats:
        """(views, 2) rms distance of the corners in the left and right image of each view."""
        return np.array([[np.sqrt(np.mean(np.sum(r**2, axis=1))) for r in pair] for pair in self.residuals_px])

    @property
    def error_px(self) -> float:
        """Rms distance of all corners."""
        everything = np.concatenate([residual for pair in self.residuals_px for residual in pair])
        return float(np.sqrt(np.mean(np.sum(everything**2, axis=1))))


def adjust(observed: list[tuple[Corners, Corners]], points_m: Floats, shared: Floats, boards: Floats) -> Bundle:
    """Fit from a start.

    Parameters
    ----------
    observed : list of (Corners, Corners)
        Left and right corners of each view; they need not be the same ones.
    points_m : (corners, 3) float64
        On the board, by corner id.
    shared, boards : float64
        Start, as in :class:`Bundle`.

    Raises
    ------
    numpy.linalg.LinAlgError
        The views leave a parameter open.
    """
    damping, least = 0.0, _squares(observed, points_m, shared, boards)
    for _ in range(_MAX_STEPS):
        normal, gradient, back = _normal_equations(observed, points_m, shared, boards)
        step = _scaled_solve(normal, gradient, damping)
        moves = np.array([inverse @ (g - cross.T @ step) for inverse, g, cross in back])
        squares = _squares(observed, points_m, shared + step, boards + moves)
        settled = float(np.max(np.abs(step / (np.abs(shared) + 1e-3)))) < _SETTLED
        if squares <= least or settled:
            shared, boards, least = shared + step, boards + moves, squares
            damping = damping / _DAMPING_FACTOR if damping > _FIRST_DAMPING else 0.0
        else:
            damping = max(_DAMPING_FACTOR * damping, _FIRST_DAMPING)
        if settled:
            break
    normal, _, _ = _normal_equations(observed, points_m, shared, boards)
    residuals = [tuple(_view(pair, points_m, shared, board)[0]) for pair, board in zip(observed, boards, strict=True)]
    count = sum(residual.size for pair in residuals for residual in pair)
    variance = least / max(count - SHARED - boards.size, 1)
    covariance = variance * _scaled_solve(normal, np.eye(SHARED))
    return Bundle(shared, covariance, boards, [(left, right) for left, right in residuals])


def _squares(observed: list[tuple[Corners, Corners]], points_m: Floats, shared: Floats, boards: Floats) -> float:
    """Sum of the squared residuals."""
    views = [_view(pair, points_m, shared, board)[0] for pair, board in zip(observed, boards, strict=True)]
    return float(sum(np.sum(residual**2) for pair in views for residual in pair))


def _normal_equations(
    observed: list[tuple[Corners, Corners]], points_m: Floats, shared: Floats, boards: Floats
) -> tuple[Floats, Floats, list[tuple[Floats, Floats, Floats]]]:
    """Reduced normal matrix and gradient of the shared parameters, and per view what gives its board's step back."""
    normal: Floats = np.zeros((SHARED, SHARED))
    gradient: Floats = np.zeros(SHARED)
    back: list[tuple[Floats, Floats, Floats]] = []
    for pair, board in zip(observed, boards, strict=True):
        errors, slopes = _view(pair, points_m, shared, board)
        error = np.concatenate([each.ravel() for each in errors])
        slope: Floats = np.concatenate(slopes)
        of_shared, of_board = slope[:, :SHARED], slope[:, SHARED:]
        inverse: Floats = np.asarray(np.linalg.inv(of_board.T @ of_board), dtype=np.float64)
        cross, board_gradient = of_shared.T @ of_board, of_board.T @ error
        normal += of_shared.T @ of_shared - cross @ inverse @ cross.T
        gradient += of_shared.T @ error - cross @ inverse @ board_gradient
        back.append((inverse, board_gradient, cross))
    return normal, gradient, back


def camera_matrix(lens: Floats) -> Floats:
    """(3, 3) camera matrix of a lens, whose first four numbers are fx, fy, cx, cy in px."""
    return np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])


def _view(
    pair: tuple[Corners, Corners], points_m: Floats, shared: Floats, board: Floats
) -> tuple[list[Floats], list[Floats]]:
    """Residuals (n, 2) of left and right, and derivatives (2 n, 24 + 6) of the projections."""
    turned = cv2.composeRT(board[:3], board[3:], shared[2 * LENS : 2 * LENS + 3], shared[2 * LENS + 3 :])
    poses = (board, np.concatenate([turned[0].ravel(), turned[1].ravel()]))
    errors, slopes = [], []
    for side, (corners, pose) in enumerate(zip(pair, poses, strict=True)):
        lens = shared[side * LENS : (side + 1) * LENS]
        pixels, slope = cv2.projectPoints(points_m[corners.ids], pose[:3], pose[3:], camera_matrix(lens), lens[4:])
        errors.append(corners.pixels - np.asarray(pixels, dtype=np.float64).reshape(-1, 2))
        jacobian = np.zeros((len(slope), SHARED + 6))
        jacobian[:, side * LENS : (side + 1) * LENS] = slope[:, _JACOBIAN_COLUMNS]
        of_pose = slope[:, :6]
        if side:
            by_board, by_rig = _chain(turned)
            jacobian[:, 2 * LENS : SHARED] = of_pose @ by_rig
            of_pose = of_pose @ by_board
        jacobian[:, SHARED:] = of_pose
        slopes.append(jacobian)
    return errors, slopes


def _chain(turned: tuple[Floats, ...]) -> tuple[Floats, Floats]:
    """Derivatives (6, 6) of the board's pose in the right camera by its pose in the left one, and by the rig's."""
    r_r1, r_t1, r_r2, r_t2, t_r1, t_t1, t_r2, t_t2 = turned[2:]
    return np.block([[r_r1, r_t1], [t_r1, t_t1]]), np.block([[r_r2, r_t2], [t_r2, t_t2]])


def _scaled_solve(normal: Floats, wanted: Floats, damping: float = 0.0) -> Floats:
    """Solve with rows and columns scaled to a unit diagonal: pixels, radians and metres differ by orders."""
    diagonal = np.diag(normal)
    if not np.all(diagonal > 0.0):
        raise np.linalg.LinAlgError("a parameter that no residual depends on")
    scale = 1.0 / np.sqrt(diagonal)
    scaled = normal * np.outer(scale, scale) + damping * np.eye(len(normal))
    solved = np.linalg.solve(scaled, (wanted.T * scale).T)
    answer: Floats = (solved.T * scale).T
    return answer
