"""Calibrates a stereo rig from views of a board: lenses, relative pose, the sigma of each, bad views by name."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np

from companion.calibration.boards import LEAST_CORNERS, Board, Corners, common, find_corners
from companion.core.stereo.geometry import axes_from_body
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.records import Bytes, Floats, Side

LEAST_VIEWS = 6
_OUTLIER = 3.0  # times the median reprojection error of the views
_HARMLESS_PX = 0.15
_CELLS = 4
_GROUPS = 6
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10)


@dataclass(frozen=True, slots=True)
class View:
    """One pair of images in which both cameras see the board."""

    name: str
    left: Corners
    right: Corners


@dataclass(frozen=True, slots=True)
class LensFit:
    """One lens: ``values`` and ``sigmas`` (9,) of fx, fy, cx, cy, k1, k2, p1, p2, k3; errors of each view, px."""

    values: Floats
    sigmas: Floats
    view_errors_px: Floats

    @property
    def matrix(self) -> Floats:
        """(3, 3) camera matrix."""
        fx, fy, cx, cy = self.values[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


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
    views : list of str
        What was used.
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


def find_views(pairs: list[tuple[str, Bytes, Bytes]], board: Board) -> tuple[list[View], dict[str, str]]:
    """Look for the board in named image pairs; give the views, and the names of those without, with the reason."""
    views, rejected = [], {}
    for name, left_image, right_image in pairs:
        left, right = find_corners(left_image, board), find_corners(right_image, board)
        if left is None or right is None:
            missing = [side for side, found in (("left", left), ("right", right)) if found is None]
            rejected[name] = f"board not found in the {' and '.join(missing)} image"
        elif len(common(left, right)) < LEAST_CORNERS:
            rejected[name] = f"the cameras share only {len(common(left, right))} corners"
        else:
            views.append(View(name, left, right))
    return views, rejected


def calibrate_rig(
    views: list[View], board: Board, size_px: tuple[int, int], rejected: dict[str, str] | None = None
) -> RigFit:
    """Calibrate both lenses and their relative pose; views that fit much worse than the others are left out, by name.

    Parameters
    ----------
    views : list of View
        From :func:`find_views`.
    board : Board
        What they show.
    size_px : tuple
        Width, height.
    rejected : dict, optional
        Views that were refused before.

    Raises
    ------
    ConfigError
        Fewer than six usable views.
    """
    refused = dict(rejected or {})
    while True:
        if len(views) < LEAST_VIEWS:
            raise ConfigError(f"{len(views)} usable views are too few, {LEAST_VIEWS} are needed; refused: {refused}")
        lenses = (_lens(views, Side.LEFT, board, size_px), _lens(views, Side.RIGHT, board, size_px))
        bad = _worst(lenses)
        if bad is None:
            break
        refused[views[bad[0]].name] = bad[1]
        views = [view for index, view in enumerate(views) if index != bad[0]]
    pose, error = _relative(views, board, lenses, size_px)
    sigma = _jackknife([_whole(some, board, size_px) for some in _without_a_group(views)])
    unseen = {side.name.lower(): _uncovered(views, side, size_px) for side in Side}
    names = [view.name for view in views]
    return RigFit(lenses, pose[:3], sigma[:3], pose[3:], sigma[3:], error, names, refused, unseen)


def airframe_with_rig(base: Airframe, fit: RigFit) -> Airframe:
    """The base airframe with calibrated lenses; the left camera keeps its mounting, the right one follows from it.

    Raises
    ------
    ConfigError
        The base has no cameras.
    """
    if base.left_camera is None or base.right_camera is None:
        raise ConfigError(f"airframe '{base.name}' has no cameras to calibrate")
    left = _with_lens(base.left_camera, fit.lenses[0])
    right = _with_lens(base.right_camera, fit.lenses[1])
    left_from_body = exp_rotation(-np.array(left.rotation_rad)) @ axes_from_body(left.axes, "left_camera.axes")
    right_from_left = exp_rotation(fit.rotation_rad)
    turned = right_from_left @ left_from_body @ axes_from_body(right.axes, "right_camera.axes").T
    x, y, z = (float(entry) for entry in -log_rotation(turned))
    centre_left = -right_from_left.T @ fit.translation_m
    px, py, pz = (float(entry) for entry in np.array(left.position_m) + left_from_body.T @ centre_left)
    sigma = float(np.sqrt(np.mean(fit.rotation_sigma_rad**2) / 2.0))  # each camera is given half of the variance
    right = dataclasses.replace(right, rotation_rad=(x, y, z), position_m=(px, py, pz), rotation_sigma_rad=sigma)
    return dataclasses.replace(
        base, left_camera=dataclasses.replace(left, rotation_sigma_rad=sigma), right_camera=right
    )


def _with_lens(camera: Camera, fit: LensFit) -> Camera:
    fx, fy, cx, cy, *bent = (float(value) for value in fit.values)
    return dataclasses.replace(
        camera,
        focal_px=Uncertain(fx, float(fit.sigmas[0])),
        focal_ratio=fy / fx,
        principal_px=(cx, cy),
        distortion=tuple(bent),
    )


def _lens(views: list[View], side: Side, board: Board, size_px: tuple[int, int]) -> LensFit:
    corners = [view.left if side is Side.LEFT else view.right for view in views]
    grid = board.points_m().astype(np.float32)
    points = [grid[each.ids] for each in corners]
    pixels = [each.pixels.astype(np.float32).reshape(-1, 1, 2) for each in corners]
    _, matrix, bent, _, _, sigmas, _, errors = cv2.calibrateCameraExtended(
        points, pixels, size_px, np.eye(3), np.zeros(5), criteria=_STOP
    )
    values = np.concatenate([[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], np.ravel(bent)[:5]])
    return LensFit(
        values.astype(np.float64),
        np.asarray(np.ravel(sigmas)[:9], dtype=np.float64),
        np.asarray(np.ravel(errors), dtype=np.float64),
    )


def _worst(lenses: tuple[LensFit, LensFit]) -> tuple[int, str] | None:
    """The view that fits worst, if it does not belong to the others."""
    found: list[tuple[float, int, str]] = []
    for side, lens in zip(Side, lenses, strict=True):
        errors = lens.view_errors_px
        limit = max(_OUTLIER * float(np.median(errors)), _HARMLESS_PX)
        worst = int(np.argmax(errors))
        if errors[worst] > limit:
            usual = float(np.median(errors))
            text = f"reprojection error {errors[worst]:.2f} px in the {side.name.lower()} image, usual {usual:.2f}"
            found.append((float(errors[worst]), worst, text))
    return max(found)[1:] if found else None


def _relative(
    views: list[View], board: Board, lenses: tuple[LensFit, LensFit], size_px: tuple[int, int]
) -> tuple[Floats, float]:
    """Rotation vector and translation (6,) from left to right, and the reprojection error, px."""
    grid = board.points_m().astype(np.float32)
    points, pixels = [], ([], [])  # type: ignore[var-annotated]
    for view in views:
        shared = common(view.left, view.right)
        points.append(grid[shared])
        for store, seen in zip(pixels, (view.left, view.right), strict=True):
            place = {int(number): index for index, number in enumerate(seen.ids)}
            rows = seen.pixels[[place[int(number)] for number in shared]]
            store.append(rows.astype(np.float32).reshape(-1, 1, 2))
    error, _, _, _, _, rotation, translation, _, _ = cv2.stereoCalibrate(
        points, pixels[0], pixels[1], lenses[0].matrix, lenses[0].values[4:], lenses[1].matrix, lenses[1].values[4:],
        size_px, flags=cv2.CALIB_FIX_INTRINSIC, criteria=_STOP,
    )  # fmt: skip
    vector = log_rotation(np.asarray(rotation, dtype=np.float64))
    return np.concatenate([vector, np.asarray(translation, dtype=np.float64).ravel()]), float(error)


def _whole(views: list[View], board: Board, size_px: tuple[int, int]) -> Floats:
    """Relative pose (6,) from scratch: lenses and all, so that its scatter holds the lenses' uncertainty too."""
    lenses = (_lens(views, Side.LEFT, board, size_px), _lens(views, Side.RIGHT, board, size_px))
    return _relative(views, board, lenses, size_px)[0]


def _without_a_group(views: list[View]) -> list[list[View]]:
    return [[view for k, view in enumerate(views) if k % _GROUPS != group] for group in range(_GROUPS)]


def _jackknife(answers: list[Floats]) -> Floats:
    """Standard deviation of the whole from the estimates that leave out one group of views each."""
    each, n = np.array(answers), len(answers)
    sigma: Floats = np.sqrt((n - 1) * np.mean((each - each.mean(axis=0)) ** 2, axis=0))
    return sigma


def _uncovered(views: list[View], side: Side, size_px: tuple[int, int]) -> list[str]:
    pixels = np.concatenate([(view.left if side is Side.LEFT else view.right).pixels for view in views])
    cell = np.clip((pixels / np.array(size_px) * _CELLS).astype(int), 0, _CELLS - 1)
    seen = {(int(column), int(row)) for column, row in cell}
    everything = [(column, row) for row in range(_CELLS) for column in range(_CELLS)]
    return [f"column {c + 1}, row {r + 1} of {_CELLS}" for c, r in everything if (c, r) not in seen]
