"""Dense disparity for obstacle sectors: semi-global matching on images rectified for the poses of this pair.

OpenCV's ``StereoSGBM`` runs in its one-pass three-way mode, with subpixel steps of 1/16 px and a left-right check.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.stereo.geometry import Rig
from companion.core.stereo.matching import Matches, expected_slopes, returned
from companion.core.stereo.rectification import Rectification
from companion.core.stereo.refine import HALF_WINDOW, refine
from companion.records import Bools, Bytes, Floats

_BLOCK = 5  # px; OpenCV's usual block
_STEPS_PER_PX = 16.0  # OpenCV's fixed point of disparity
_LEFT_RIGHT_PX = 1  # OpenCV's usual left-right check
_UNIQUENESS_PERCENT = 10  # OpenCV's usual value
_SPECKLE_AREA_PX = 60  # smaller islands of disparity are mismatches (choice)
# Mean absolute horizontal slope of brightness, grey levels per pixel, below which a place has no texture (choice).
_LEAST_TEXTURE = 3.0
_TEXTURE_WINDOW_PX = 11  # about two matching blocks (choice)
_METRIC_SCORE = 0.85  # convention: the score that sparse matches need (FINE_SCORE in matching.py)
_CLOSE_PX = 20.0  # side of a refinement window: nearer places show the same texture (derived)


@dataclass(frozen=True, slots=True, eq=False)
class Disparity:
    """Dense disparity of a rectified pair.

    Attributes
    ----------
    frame : Rectification
        Rectified frame of the disparity.
    disparity_px : (rows, columns) float32
        Left column minus right column; NaN where there is no trusted match.
    sigma_px : float
        One-sigma of each disparity.
    level : int
        Number of times that the images were halved first; disparities are in halved pixels.
    """

    frame: Rectification
    disparity_px: Floats
    sigma_px: float
    level: int = 0


class DenseMatcher:
    """Semi-global matcher for a fixed span of disparities.

    Parameters
    ----------
    first_px : int
        Smallest disparity.
    count : int
        Number of disparities, a multiple of 16.
    """

    def __init__(self, first_px: int = 0, count: int = 64) -> None:
        self.semi_global = cv2.StereoSGBM.create(
            minDisparity=first_px,
            numDisparities=count,
            blockSize=_BLOCK,
            P1=8 * _BLOCK**2,
            P2=32 * _BLOCK**2,
            disp12MaxDiff=_LEFT_RIGHT_PX,
            uniquenessRatio=_UNIQUENESS_PERCENT,
            speckleWindowSize=_SPECKLE_AREA_PX,
            speckleRange=1,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )
        self._first_px = first_px

    def match_rectified(self, left: Bytes, right: Bytes) -> Floats:
        """Disparity (rows, columns) float32 of a rectified pair, NaN where unknown."""
        steps = self.semi_global.compute(left, right)
        disparity: Floats = steps.astype(np.float32) / np.float32(_STEPS_PER_PX)
        disparity[(steps < _STEPS_PER_PX * self._first_px) | ~textured(left)] = np.nan
        return disparity


def textured(image: Bytes) -> Bools:
    """Mask (rows, columns) of places with texture along the rows; a smooth place would match anything."""
    slope = cv2.convertScaleAbs(cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=1), alpha=0.5)
    mean = cv2.boxFilter(slope, cv2.CV_32F, (_TEXTURE_WINDOW_PX, _TEXTURE_WINDOW_PX))
    enough: Bools = mean > _LEAST_TEXTURE
    return enough


def raw_pairs(dense: Disparity, rig: Rig, step_px: int) -> tuple[Floats, Floats, Floats]:
    """Thin a dense disparity to raw pixel pairs.

    Parameters
    ----------
    dense : Disparity
        Disparity of the rectified pair.
    rig : Rig
        Lenses.
    step_px : int
        Spacing of the grid that is kept, in the raw image.

    Returns
    -------
    tuple
        Left and right raw pixels (n, 2) and sigma (n,), px.
    """
    left, right = _rectified_pairs(dense, step_px)
    left_px = dense.frame.to_raw(rig.left, dense.frame.left, left)
    right_px = dense.frame.to_raw(rig.right, dense.frame.right, right)
    return left_px, right_px, np.full(len(left), dense.sigma_px * 2.0**dense.level)


def metric_pairs(
    dense: Disparity, left: Bytes, right: Bytes, rig: Rig, step_px: int, excluded_px: Floats | None = None
) -> Matches:
    """Refine a thinned dense disparity in the raw images: matches fit for ranging between the features.

    Parameters
    ----------
    dense : Disparity
        Disparity of the rectified pair.
    left, right : (rows, columns) uint8
        The raw pair.
    rig : Rig
        Lenses.
    step_px : int
        Spacing of the grid that is kept, in the raw image.
    excluded_px : (m, 2) float64, optional
        Left raw pixels near which no match is wanted: those of the features.
    """
    left_px, right_px, _ = raw_pairs(dense, rig, step_px)
    frame, right_rectified = dense.frame, _rectified_pairs(dense, step_px)[1]
    centres_px = np.rint(left_px).astype(np.int64)
    margin = HALF_WINDOW + 3
    inside = np.all((centres_px >= margin) & (centres_px < np.array([left.shape[1], left.shape[0]]) - margin), axis=1)
    if excluded_px is not None:
        apart_px = np.linalg.norm(left_px[:, np.newaxis] - excluded_px[np.newaxis], axis=-1)
        inside &= np.all(apart_px > _CLOSE_PX, axis=1)
    along = frame.along_rows(rig.right, frame.right, right_rectified[inside])
    slopes = expected_slopes(frame, rig, centres_px[inside], right_rectified[inside])
    fine = refine(left, right, centres_px[inside], (right_px + centres_px - left_px)[inside], along, slopes)
    good = fine.good & (fine.correlation > _METRIC_SCORE)
    good[good] = returned(left, right, fine, good, slopes)
    return Matches(fine.left_px[good], fine.right_px[good], fine.sigma_px[good])


def _rectified_pairs(dense: Disparity, step_px: int) -> tuple[Floats, Floats]:
    """Rectified left and right pixels (n, 2) of a grid's known disparities."""
    scale, step = 2.0**dense.level, max(step_px >> dense.level, 1)
    height, width = dense.disparity_px.shape
    rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    disparity = dense.disparity_px[rows, columns].astype(np.float64)
    finite = np.isfinite(disparity)
    left = np.column_stack([columns[finite], rows[finite]]).astype(np.float64)
    return scale * left, scale * (left - np.column_stack([disparity[finite], np.zeros(len(left))]))
