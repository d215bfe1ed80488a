"""Calibrates a stereo rig from views of a board: lenses, relative pose, the sigma of each, bad views by name."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from companion.calibration.boards import LEAST_CORNERS, Board, Corners, common, find_corners
from companion.calibration.bundle import LENS, Bundle, adjust, camera_matrix
from companion.core.stereo.rotation import log_rotation
from companion.errors import ConfigError
from companion.records import Bytes, Floats, Ints, Side

_NAMED = 5  # refused views in the sentence of an error (choice)
LEAST_VIEWS = 6  # nine lens terms a camera need three views; six leave residuals to judge by (choice)
_OUTLIER = 3.0  # times the median reprojection error of the views (choice)
_HARMLESS_PX = 0.15  # a view that fits so well stays, whatever the others do (choice)
_LARGEST_FOCAL_SIGMA = 0.05  # of the focal length; tilted boards leave a thousandth (choice)
_LARGEST_ERROR_PX = 2.0  # corners are found to a tenth; beyond it the fit is none (choice)
CELLS = 4  # a side, of the grid by which image coverage is judged (choice)
_FAR_M = 60.0  # where the toe is what counts (choice)
# numerical: steps at most, and a gain by which rounding rules
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10)
_UNDETERMINED = (
    "the views do not determine the lenses: tilt the board by 20 degrees and more, to all sides, near and far, "
    "and show it in all of the image"
)


@dataclass(frozen=True, slots=True)
class BoardView:
    """One pair of images in which both cameras see the board."""

    name: str
    left: Corners
    right: Corners


@dataclass(frozen=True, slots=True)
class LensFit:
    """One lens: ``values`` and ``sigmas`` (9,) of fx, fy, cx, cy, k1, k2, p1, p2, k3."""

    values: Floats
    sigmas: Floats


@dataclass(frozen=True, slots=True)
class RigFit:
    """A calibrated pair.

    Attributes
    ----------
    lenses : (LensFit, LensFit)
    rotation_rad, rotation_sigma_rad : (3,) float64
        Rotation vector that takes left camera coordinates to right ones.
    translation_m, translation_sigma_m : (3,) float64
        ``X_right = R X_left + translation``.
    error_px : float
        Rms distance between seen and projected corners, both cameras.
    views : list of str
        What was used.
    bundle : Bundle
        The fit itself: joint covariance, board poses, residuals of each view in the order of ``views``.
    size_px : (int, int)
        Width and height of the images.
    rejected : dict of str to str
        What was not, and why.
    unseen : dict of str to list of str
        Parts of each image in which no corner was ever seen: where the next views should go.
    """

    lenses: tuple[LensFit, LensFit]
    rotation_rad: Floats
    rotation_sigma_rad: Floats
    translation_m: Floats
    translation_sigma_m: Floats
    error_px: float
    views: list[str]
    rejected: dict[str, str]
    unseen: dict[str, list[str]]
    bundle: Bundle
    size_px: tuple[int, int]


def toe_sigma_rad(fit: RigFit) -> float:
    """Sigma of what the calibration leaves in far ranges, as relative toe: ``B`` times that of an inverse range.

    Rotation and principal points hang together; their joint covariance says what is left of both, averaged over the
    middle of the image, where a range's features lie.
    """
    shared, size = fit.bundle.shared, np.array(fit.size_px, dtype=np.float64)
    left_px = np.array([[x, y] for x in (0.35, 0.5, 0.65) for y in (0.35, 0.5, 0.65)]) * size
    baseline_m = float(np.linalg.norm(fit.translation_m))
    apart_m = fit.translation_m[:2]  # along the rows of a pair side by side, along the columns of one turned upright
    right_px, along = left_px + shared[0] * apart_m / _FAR_M, apart_m / np.linalg.norm(apart_m)
    by = np.empty(len(shared))
    for k, sigma in enumerate(np.sqrt(np.diag(fit.bundle.covariance))):
        step = np.zeros(len(shared))
        step[k] = 1e-2 * max(float(sigma), 1e-12)
        beyond, before = (_inverse_range_pm(shared + turn * step, left_px, right_px, along) for turn in (1.0, -1.0))
        by[k] = float((beyond - before).mean()) / (2.0 * step[k])
    return baseline_m * math.sqrt(max(float(by @ fit.bundle.covariance @ by), 0.0))


def _inverse_range_pm(shared: Floats, left_px: Floats, right_px: Floats, along: Floats) -> Floats:
    """1/Z of left pixels (n, 2) whose place along a direction (2,) of the right image is known, (n,)."""
    x_left, x_right = (
        cv2.undistortPoints(pixels[:, None], camera_matrix(lens), lens[4:])[:, 0]
        for pixels, lens in ((left_px, shared[:9]), (right_px, shared[9:18]))
    )
    turn = np.asarray(cv2.Rodrigues(shared[18:21])[0], dtype=np.float64)
    ahead = np.column_stack([x_left, np.ones(len(x_left))]) @ turn.T
    moved, place = shared[21:24], x_right @ along
    return np.asarray((place * ahead[:, 2] - ahead[:, :2] @ along) / (moved[:2] @ along - place * moved[2]))


def find_views(pairs: list[tuple[str, Bytes, Bytes]], board: Board) -> tuple[list[BoardView], dict[str, str]]:
    """Look for the board in named image pairs; give the views, and the names of the others, with the reason.

    A copy of an earlier image, bit for bit, teaches nothing and would make every sigma smaller.
    """
    views, rejected = [], {}
    earlier: dict[bytes, str] = {}
    for name, left_image, right_image in pairs:
        left, right = find_corners(left_image, board), find_corners(right_image, board)
        if left is None or right is None:
            missing = [side for side, corners in (("left", left), ("right", right)) if corners is None]
            rejected[name] = f"board not found in the {' and '.join(missing)} image"
        elif len(common(left, right)) < LEAST_CORNERS:
            rejected[name] = f"the cameras share only {len(common(left, right))} corners"
        else:
            digests = [hashlib.sha256(image.tobytes()).digest() for image in (left_image, right_image)]
            copied = [earlier[digest] for digest in digests if digest in earlier]
            if copied:
                rejected[name] = f"an image is that of {copied[0]}, bit for bit"
                continue
            earlier |= dict.fromkeys(digests, name)
            views.append(BoardView(name, left, right))
    return views, rejected


def calibrate_rig(
    views: list[BoardView],
    board: Board,
    size_px: tuple[int, int],
    rejected: dict[str, str] | None = None,
    focal_px: tuple[float, float] | None = None,
) -> RigFit:
    """Calibrate both lenses and their relative pose; views that fit much worse than the others are left out, by name.

    ``views`` come from :func:`find_views`; ``size_px`` is width and height; ``rejected`` are views that were refused
    before; ``focal_px``, of the left and the right camera, is believed roughly, and a second start of the search.

    Raises
    ------
    ConfigError
        Fewer than six usable views, or the views do not determine the lenses.
    """
    try:
        return _calibrated(views, board, size_px, rejected, focal_px)
    except (np.linalg.LinAlgError, cv2.error) as error:  # of corners that all lie in a row
        raise ConfigError(_UNDETERMINED) from error


def _calibrated(
    views: list[BoardView],
    board: Board,
    size_px: tuple[int, int],
    rejected: dict[str, str] | None,
    focal_px: tuple[float, float] | None,
) -> RigFit:
    refused = dict(rejected or {})
    while True:
        if len(views) < LEAST_VIEWS:
            reasons = "; ".join(f"{name}: {why}" for name, why in [*refused.items()][:_NAMED]) or "none"
            raise ConfigError(f"{len(views)} usable views are too few, {LEAST_VIEWS} are needed; refused: {reasons}")
        alone = [_lens(views, side, board, size_px, focal_px[side] if focal_px else None) for side in Side]
        bad = _worst([lens.errors_px for lens in alone], "reprojection error {:.2f} px in the {} image, usual {:.2f}")
        bundle = None if bad else _bundle(views, board, alone, size_px)
        if bundle is not None:
            bad = _worst(
                list(bundle.view_errors_px().T),
                "the cameras disagree, {:.2f} px in the {} image, usual {:.2f}: "
                "board or camera moved between the exposures",
            )
            if bad is None:
                break
        if bad is not None:
            refused[views[bad[0]].name] = bad[1]
            views = [view for index, view in enumerate(views) if index != bad[0]]
    if not _determined(bundle):
        raise ConfigError(_UNDETERMINED)
    sigma = np.sqrt(np.diag(bundle.covariance))
    first, second, pose = (slice(0, LENS), slice(LENS, 2 * LENS), slice(2 * LENS, None))
    lenses = (LensFit(bundle.shared[first], sigma[first]), LensFit(bundle.shared[second], sigma[second]))
    vector, sigmas = bundle.shared[pose], sigma[pose]
    unseen = {side.name.lower(): uncovered(views, side, size_px) for side in Side}
    names = [view.name for view in views]
    return RigFit(
        lenses, vector[:3], sigmas[:3], vector[3:], sigmas[3:], bundle.error_px, names, refused, unseen, bundle, size_px
    )


def _determined(bundle: Bundle) -> bool:
    """Whether the fit is finite, fits, and knows its focal lengths: a board that is not tilted leaves them open."""
    variance, focal = np.diag(bundle.covariance), [0, 1, LENS, LENS + 1]
    if not (np.all(np.isfinite(bundle.shared)) and np.all(variance >= 0.0) and np.all(np.isfinite(variance))):
        return False
    focal_px, sigma_px = bundle.shared[focal], np.sqrt(variance[focal])
    return bool(np.all(sigma_px <= _LARGEST_FOCAL_SIGMA * focal_px)) and bundle.error_px <= _LARGEST_ERROR_PX


@dataclass(frozen=True, slots=True)
class _Alone:
    """A lens calibrated without the other one: where the bundle starts."""

    matrix: Floats
    bent: Floats
    boards: Floats
    errors_px: Floats


def _lens(views: list[BoardView], side: Side, board: Board, size_px: tuple[int, int], focal_px: float | None) -> _Alone:
    """The lens by itself: views tilted by a few degrees have a false minimum, so the better of two starts counts."""
    corners = [view.left if side is Side.LEFT else view.right for view in views]
    grid = board.points_m().astype(np.float32)
    points = [grid[each.ids] for each in corners]
    pixels = [each.pixels.astype(np.float32).reshape(-1, 1, 2) for each in corners]
    starts = [(np.eye(3), 0)]
    if focal_px is not None:
        centre_px = 0.5 * (np.array(size_px) - 1.0)
        starts.append((camera_matrix(np.array([focal_px, focal_px, *centre_px])), cv2.CALIB_USE_INTRINSIC_GUESS))
    fits = [
        cv2.calibrateCameraExtended(points, pixels, size_px, start, np.zeros(5), flags=flags, criteria=_STOP)
        for start, flags in starts
    ]
    _, matrix, bent, turns, places, _, _, errors = min(fits, key=lambda fit: float(fit[0]))
    poses = np.array([np.concatenate([t.ravel(), p.ravel()]) for t, p in zip(turns, places, strict=True)])
    return _Alone(
        np.asarray(matrix, dtype=np.float64),
        np.asarray(bent, dtype=np.float64).ravel()[:5],
        poses,
        np.asarray(errors, dtype=np.float64).ravel(),
    )


def _worst(errors_px: list[Floats], text: str) -> tuple[int, str] | None:
    """The view that fits worst, if it does not belong to the others, and why in words."""
    outliers: list[tuple[float, int, str]] = []
    for side, errors in zip(Side, errors_px, strict=True):
        usual, worst = float(np.median(errors)), int(np.argmax(errors))
        if errors[worst] > max(_OUTLIER * usual, _HARMLESS_PX):
            outliers.append((float(errors[worst]), worst, text.format(errors[worst], side.name.lower(), usual)))
    return max(outliers)[1:] if outliers else None


def _bundle(views: list[BoardView], board: Board, alone: list[_Alone], size_px: tuple[int, int]) -> Bundle:
    start = [np.concatenate([each.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], each.bent]) for each in alone]
    observed = [(view.left, view.right) for view in views]
    return adjust(
        observed, board.points_m(), np.concatenate([*start, _relative(views, board, alone, size_px)]), alone[0].boards
    )


def _relative(views: list[BoardView], board: Board, alone: list[_Alone], size_px: tuple[int, int]) -> Floats:
    """Rotation vector and translation (6,) from left to right, lenses held."""
    grid = board.points_m().astype(np.float32)
    shared = [common(view.left, view.right) for view in views]
    pixels = [
        [_of(corners, ids) for corners, ids in zip([getattr(view, side) for view in views], shared, strict=True)]
        for side in ("left", "right")
    ]
    _, _, _, _, _, rotation, translation, _, _ = cv2.stereoCalibrate(
        [grid[ids] for ids in shared], pixels[0], pixels[1], alone[0].matrix, alone[0].bent, alone[1].matrix,
        alone[1].bent, size_px, flags=cv2.CALIB_FIX_INTRINSIC, criteria=_STOP,
    )  # fmt: skip
    vector = log_rotation(np.asarray(rotation, dtype=np.float64))
    return np.concatenate([vector, np.asarray(translation, dtype=np.float64).ravel()])


def _of(corners: Corners, ids: Ints) -> npt.NDArray[np.float32]:
    """Pixels of some corners, as OpenCV wants them."""
    place = {int(number): index for index, number in enumerate(corners.ids)}
    return corners.pixels[[place[int(number)] for number in ids]].astype(np.float32).reshape(-1, 1, 2)


def uncovered(views: list[BoardView], side: Side, size_px: tuple[int, int]) -> list[str]:
    """Cells of the image, 4 by 4, in which no corner of any view lies."""
    covered = {cell for view in views for cell in cells(view.left if side is Side.LEFT else view.right, size_px)}
    everything = [(column, row) for row in range(CELLS) for column in range(CELLS)]
    return [f"column {c + 1}, row {r + 1} of {CELLS}" for c, r in everything if (c, r) not in covered]


def cells(corners: Corners, size_px: tuple[int, int]) -> set[tuple[int, int]]:
    """(column, row) of the cells that hold corners."""
    each = np.clip((corners.pixels / np.array(size_px) * CELLS).astype(int), 0, CELLS - 1)
    return {(int(column), int(row)) for column, row in each}
