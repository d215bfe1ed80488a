"""Sparse metric matches for long range: corners, epipolar search under the predicted bend, subpixel refinement, checks.

Nothing is resampled for the final position: features are refined in the raw images, and the moving extrinsics are
applied to the points later (:mod:`companion.core.stereo.ranging`). Only the coarse search works on small rectified
images.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.stereo.geometry import Rig
from companion.core.stereo.least_magnitudes import least_magnitudes
from companion.core.stereo.rectification import Rectification, halved, rectification, rectify_pair
from companion.core.stereo.refine import HALF_WINDOW, Refined, is_steep, refine
from companion.core.stereo.search import Band, Search, bands, seek
from companion.records import Bools, Bytes, Floats, FramePair, Ints, MatchSet, Side

# weakest corner over the strongest one's response, which grows as contrast squared: at OpenCV's usual 0.01 a glint or a
# marker displaced all features of hazy ground (choice)
_CORNER_QUALITY = 0.001
_CORNER_SPACING_PX = 14  # corners much nearer than a refinement window are not independent (choice)
BORDER_PX = HALF_WINDOW + 3
"""Distance from the border at which a patch and its interpolation taps fit in (derived)."""
_COARSE_WIDTH_PX = 320  # width of the images of the coarse search: speed (choice)
_COARSE_SCORE = 0.6  # least correlation of a right place at the coarse scale (choice)
FINE_SCORE = 0.85
"""Least correlation of two patches of the same texture (choice)."""
# 1 - correlation of the best place, plus a margin, must be below this share of that of any other place (choice)
_UNIQUENESS = 0.8
# share of the width, beside the edge (choice): texture that repeats at longer intervals has other features between
_EDGE_SHARE = 0.125
_SAME_PLACE_PX = 3.0  # at the coarse scale: two peaks this near are one (choice, as in search.py)
_UNIQUE_MARGIN = 0.02  # margin for the noise of perfect matches (choice)
# displacements left to right and back may differ by this: patches a fraction of a pixel apart on a slanted surface do
# (choice)
_RETURN_PX = 0.1
_RETURN_SIGMAS = 4.0  # and by so many sigmas: both matches have noise of their own (choice)
_SLOPE_PX = 5.0  # half the step of the difference quotient (numerical)
_LEAST_FOR_ROLL = 12  # for three unknowns, and enough to outvote mismatches (choice)
_ROLL_IRLS_STEPS = 5  # reweightings; roll only shapes the patch (choice)
COARSE_PX = 0.5
"""Accuracy of the coarse search (choice)."""


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Matched features in raw pixels: ``left_px``, ``right_px`` (n, 2), ``sigma_px`` (n,) along the epipolar line."""

    left_px: Floats
    right_px: Floats
    sigma_px: Floats

    def __len__(self) -> int:
        return len(self.sigma_px)


def match(
    left: Bytes, right: Bytes, rig: Rig, search: Search, most: int = 200, quality: float = _CORNER_QUALITY
) -> Matches:
    """Match features of a raw image pair.

    Parameters
    ----------
    left, right : (rows, columns) uint8
        Raw images.
    rig : Rig
        Lenses and mounting.
    search : Search
        Predicted poses, their tolerance and the range limits.
    most : int
        Largest number of features that are tried.
    quality : float
        The weakest corner that is tried, as a share of the strongest one's response.
    """
    frame = rectification(rig, search.left, search.right)
    level = max(0, round(np.log2(left.shape[1] / _COARSE_WIDTH_PX)))
    corners = _corners(left, 2 * most, level, quality)
    left_rectified = frame.to_rectified(rig.left, search.left, corners.astype(np.float64))
    band = bands(search, frame, left_rectified, Side.LEFT)
    chosen = np.flatnonzero(_reachable(band, frame))[:most]
    corners, left_rectified, band = corners[chosen], left_rectified[chosen], _rows(band, chosen)

    small = rectify_pair(frame, rig, left, right, level)
    coarse = seek(*small, left_rectified * 0.5**level, _scale(band, 0.5**level))
    distinct = _distinct(coarse.score, coarse.runner_up)
    beside = np.flatnonzero(distinct & _beside_edge(band, frame, coarse.position_px / 0.5**level))
    ends_px = left_rectified[beside] * 0.5**level, coarse.position_px[beside]
    distinct[beside] = _distinct_back(small, *ends_px, search, frame, level)
    right_rectified = coarse.position_px[distinct] / 0.5**level
    start = frame.to_raw(rig.right, search.right, right_rectified)
    along = frame.along_rows(rig.right, search.right, right_rectified)
    slopes = expected_slopes(frame, rig, corners[distinct], right_rectified)
    fine = refine(left, right, corners[distinct], start, along, slopes)
    good = fine.good & (fine.correlation > FINE_SCORE)
    good[good] = returned(left, right, fine, good, slopes)
    return Matches(fine.left_px[good], fine.right_px[good], fine.sigma_px[good])


def match_pair(pair: FramePair, rig: Rig, search: Search, matched_host_ns: int) -> MatchSet:
    """Match a frame pair and give the record that the estimation reads (and that is recorded for replay)."""
    matches = match(pair.left.image, pair.right.image, rig, search)
    return MatchSet(
        pair_id=pair.pair_id,
        plan_id=pair.left.plan_id,
        clocks=(pair.left.clock, pair.right.clock),
        mid_exposure_ns=np.array([pair.left.mid_exposure_ns, pair.right.mid_exposure_ns], dtype=np.int64),
        exposure_ns=pair.left.exposure_ns,
        row_time_ns=pair.left.row_time_ns,
        left_px=matches.left_px,
        right_px=matches.right_px,
        sigma_px=matches.sigma_px,
        matched_host_ns=matched_host_ns,
    )


def _corners(image: Bytes, most: int, level: int, quality: float) -> Ints:
    """Column and row of the strongest corners (n, 2), best first, away from the border.

    The search in the halved image is ten times faster. Texture over the window is needed, not a sharp corner.
    """
    small = halved(image, level)
    border = -(-BORDER_PX // 2**level)
    mask = np.zeros_like(small)
    mask[border:-border, border:-border] = 1
    spacing = _CORNER_SPACING_PX / 2**level
    corners = cv2.goodFeaturesToTrack(small, most, quality, spacing, mask=mask, blockSize=5)
    if corners is None:
        return np.empty((0, 2), dtype=np.int64)
    pixels: Ints = np.rint(corners.reshape(-1, 2)).astype(np.int64) * 2**level
    return pixels


def _reachable(band: Band, frame: Rectification) -> Bools:
    width, height = frame.size_px
    inside = (band.right >= BORDER_PX) & (band.left < width - BORDER_PX)
    return inside & (band.bottom >= BORDER_PX) & (band.top < height - BORDER_PX)


def expected_slopes(frame: Rectification, rig: Rig, left_px: Ints, right_rectified_px: Floats) -> Floats:
    """Growth (n, 2, 2) of each match's displacement per pixel, at one depth: lenses, expected bend, unexpected roll.

    ``right_rectified_px`` (n, 2) are the coarse matches in the rectified right image.
    """
    left_rectified = frame.to_rectified(rig.left, frame.left, left_px.astype(np.float64))
    moved = right_rectified_px - left_rectified
    roll = _roll(left_rectified, moved[:, 1])
    turn = np.array([[0.0, -roll], [roll, 0.0]])
    sides = []
    for step in (np.array([_SLOPE_PX, 0.0]), np.array([0.0, _SLOPE_PX])):
        neighbours = (
            frame.to_rectified(rig.left, frame.left, left_px + step),
            frame.to_rectified(rig.left, frame.left, left_px - step),
        )
        ends = [
            frame.to_raw(rig.right, frame.right, point + moved + (point - left_rectified) @ turn.T)
            for point in neighbours
        ]
        sides.append((ends[0] - ends[1]) / (2.0 * _SLOPE_PX))
    slopes: Floats = np.stack(sides, axis=-1) - np.eye(2)
    return slopes


def _roll(points_px: Floats, down_px: Floats) -> float:
    """Unexpected roll, rad: slope of the matches' vertical displacement along the rows.

    Depth moves a match along its row alone. The fit has the least sum of magnitudes, for coarse matches are right to
    half a pixel, and some are wrong.
    """
    if len(points_px) < _LEAST_FOR_ROLL:
        return 0.0
    design = np.column_stack([points_px, np.ones(len(points_px))])
    return float(least_magnitudes(design, down_px[:, np.newaxis], COARSE_PX, _ROLL_IRLS_STEPS)[0, 0])


def returned(left: Bytes, right: Bytes, fine: Refined, chosen: Bools, slopes: Floats) -> Bools:
    """Whether the match of a right patch, refined in the left image, gives the same displacement (left-right check).

    ``chosen`` (n,) marks the k matches of ``fine`` to check; the result is (k,). ``slopes`` are (n, 2, 2).
    """
    left_px, right_px = fine.left_px[chosen], fine.right_px[chosen]
    centres_px = np.rint(right_px).astype(np.int64)
    expected = left_px + (centres_px - right_px)
    along = np.tile([1.0, 0.0], (len(centres_px), 1))
    steep, back_slopes = is_steep(slopes[chosen]), -slopes[chosen]
    back_slopes[steep] = np.linalg.inv(np.eye(2) + slopes[chosen][steep]) - np.eye(2)
    back = refine(right, left, centres_px, expected, along, back_slopes, iterations=2)
    apart = (back.right_px - back.left_px) - (left_px - right_px)
    # the way back is measured at another point of the patch, where a steep displacement is another one
    apart[steep] -= np.einsum("nij,nj->ni", back_slopes[steep], (back.left_px - right_px)[steep])
    gap = np.linalg.norm(apart, axis=1)
    alike: Bools = back.good & (gap < _RETURN_PX + _RETURN_SIGMAS * fine.sigma_px[chosen])
    return alike


def _distinct(score: Floats, runner_up: Floats) -> Bools:
    distinct: Bools = (score > _COARSE_SCORE) & (1.0 - score + _UNIQUE_MARGIN < _UNIQUENESS * (1.0 - runner_up))
    return distinct


def _beside_edge(band: Band, frame: Rectification, found_px: Floats) -> Bools:
    """Whether a place (n, 2) was found near an edge beyond which the band goes on, where the true place may be.

    At an image's edge a row of windows matched one window too far: the place that is as good is not in the picture.
    """
    width, height = frame.size_px
    near_px = _EDGE_SHARE * width
    column, row = found_px.T
    beside: Bools = (band.left < 0.0) & (column < near_px) | (band.right > width - 1.0) & (column > width - near_px)
    beside |= (band.top < 0.0) & (row < near_px) | (band.bottom > height - 1.0) & (row > height - near_px)
    return beside


def _distinct_back(
    small: tuple[Bytes, Bytes], left_px: Floats, right_px: Floats, search: Search, frame: Rectification, level: int
) -> Bools:
    """Whether places (n, 2) in the small right image are most like those of the small left one that led to them."""
    band = bands(search, frame, right_px / 0.5**level, Side.RIGHT)
    back = seek(small[1], small[0], right_px, _scale(band, 0.5**level))
    returned_px = np.abs(back.position_px - left_px).max(axis=1)
    alike: Bools = (returned_px < _SAME_PLACE_PX) & (back.score > back.runner_up + _UNIQUE_MARGIN)
    return alike


def _scale(band: Band, factor: float) -> Band:
    return Band(band.left * factor, band.right * factor, band.top * factor, band.bottom * factor)


def _rows(band: Band, index: Ints) -> Band:
    return Band(band.left[index], band.right[index], band.top[index], band.bottom[index])
