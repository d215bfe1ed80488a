"""Band of the other image in which a feature may lie, and the coarse search in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.stereo.geometry import Pose, Rig
from companion.core.stereo.rectification import Rectification
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Bools, Bytes, Floats, Ints, Side

HALF_TEMPLATE = 5  # px at the coarse scale: 11 x 11 patches (choice)
# A second peak nearer than this to the best one is the same peak (choice).
_SAME_PEAK_PX = 3
_BEND_SIGMAS = 3.0  # of gusts and of trim bend, whose sigmas are added (choice)


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Predicted poses of a pair at exposure, their tolerance and the range limits.

    Attributes
    ----------
    left, right : Pose
        Predicted poses.
    min_range_m, max_range_m : float
        Range limits, m.
    bend_tolerance_rad : float
        Largest error of the predicted relative rotation about the body's x axis (both tips' bending).
    other_tolerance_rad : float
        The same about any axis, for mounting, twist and unmodelled causes.
    """

    left: Pose
    right: Pose
    min_range_m: float
    max_range_m: float
    bend_tolerance_rad: float
    other_tolerance_rad: float = 0.0015


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """For each point of one rectified image, the rectangle of the other in which its match must lie, px: (n,) each."""

    left: Floats
    right: Floats
    top: Floats
    bottom: Floats


@dataclass(frozen=True, slots=True, eq=False)
class CoarseMatches:
    """Best place (n, 2) of each template, px, its correlation (n,) and the best correlation elsewhere in the band."""

    position_px: Floats
    score: Floats
    runner_up: Floats


def trim_search(rig: Rig, airframe: Airframe, settings: Settings) -> Search:
    """Search around trim bend, for when only the airframe is known; the band allows gusts and 1 g either way."""
    wing = airframe.wing
    slope = wing.symmetric.slope_factor_radpm.value * wing.trim_bend_m.value
    spread_m = _BEND_SIGMAS * (wing.gust.deflection_rms_m.value + wing.trim_bend_m.sigma) + wing.bend_per_g_m.value
    tolerance = 2.0 * wing.symmetric.slope_factor_radpm.value * spread_m
    return expected_search(rig, settings, (slope, slope), (wing.trim_bend_m.value,) * 2, tolerance)


def expected_search(
    rig: Rig, settings: Settings, slope_rad: tuple[float, float], lift_m: tuple[float, float], bend_tolerance_rad: float
) -> Search:
    """Search around predicted slopes and deflections of the left and right tip."""
    left = rig.pose(Side.LEFT, slope_rad[0], lift_m[0])
    right = rig.pose(Side.RIGHT, slope_rad[1], lift_m[1])
    return Search(left, right, settings.min_range_m, settings.max_range_m, bend_tolerance_rad)


def bands(search: Search, frame: Rectification, points_px: Floats, of: Side) -> Band:
    """Bands in the other image for full-resolution rectified points (n, 2) of one side.

    A small relative rotation (a, b, c) about the rectified axes moves image points by
    ``(b (1 + x^2) - a x y - c y, -a (1 + y^2) + b x y + c x)`` times the focal length.
    """
    bend = np.abs(frame.rectified_from_body @ np.array([search.bend_tolerance_rad, 0.0, 0.0]))
    a, b, c = bend + search.other_tolerance_rad
    x, y = np.abs((points_px - frame.matrix[:2, 2]) / frame.focal_px).T
    shift = frame.focal_px * (b * (1.0 + x * x) + a * x * y + c * y)
    rows = frame.focal_px * (a * (1.0 + y * y) + b * x * y + c * x)
    near = frame.focal_px * frame.baseline_m / search.min_range_m + shift
    far = frame.focal_px * frame.baseline_m / search.max_range_m - shift
    column, row = points_px.T
    if of is Side.LEFT:
        return Band(column - near, column - far, row - rows, row + rows)
    return Band(column + far, column + near, row - rows, row + rows)


def seek(template_image: Bytes, other_image: Bytes, points_px: Floats, band: Band) -> CoarseMatches:
    """Best normalised correlation of the patch around each point within its band.

    Parameters
    ----------
    template_image, other_image : (rows, columns) uint8
        Rectified images of equal scale.
    points_px : (n, 2) float64
        Patch centres.
    band : Band
        Bands in pixels of ``other_image``.
    """
    n = len(points_px)
    centre = np.rint(points_px).astype(int)
    lower = np.maximum(np.stack([np.floor(band.left), np.floor(band.top)], axis=1).astype(int), HALF_TEMPLATE)
    size = np.array([other_image.shape[1], other_image.shape[0]])
    upper = np.minimum(
        np.stack([np.ceil(band.right), np.ceil(band.bottom)], axis=1).astype(int), size - 1 - HALF_TEMPLATE
    )
    usable = _usable(centre, lower, upper, size)
    position, score, runner_up = np.full((n, 2), np.nan), np.full(n, -1.0), np.full(n, -1.0)
    h = HALF_TEMPLATE
    boxes = np.column_stack([centre, lower, upper]).tolist()
    for i in np.flatnonzero(usable).tolist():
        x, y, x0, y0, x1, y1 = boxes[i]
        template = template_image[y - h : y + h + 1, x - h : x + h + 1]
        strip = other_image[y0 - h : y1 + h + 1, x0 - h : x1 + h + 1]
        scores = cv2.matchTemplate(strip, template, cv2.TM_CCOEFF_NORMED)
        _, score[i], _, (column, row) = cv2.minMaxLoc(scores)
        position[i] = x0 + column + _vertex(scores[row], column), y0 + row + _vertex(scores[:, column], row)
        scores[:, max(column - _SAME_PEAK_PX, 0) : column + _SAME_PEAK_PX + 1] = -1.0
        runner_up[i] = cv2.minMaxLoc(scores)[1]
    # the template was centred on whole pixels; the match is moved to the point itself
    return CoarseMatches(position + (points_px - centre), score, runner_up)


def _usable(centre: Ints, lower: Ints, upper: Ints, size: Ints) -> Bools:
    inside = np.all((centre >= HALF_TEMPLATE) & (centre < size - HALF_TEMPLATE), axis=1)
    usable: Bools = inside & np.all(upper >= lower, axis=1)
    return usable


def _vertex(values: Floats, at: int) -> float:
    """Offset of the top of the parabola through a maximum and its neighbours, px; 0 at an end."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, top, after = values[at - 1 : at + 2].tolist()
    bend = before - 2.0 * top + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0
