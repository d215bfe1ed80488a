"""Features of a left image found again in the left image of the pair before.

No wing state and no velocity is known here, so pyramidal Lucas-Kanade (Bouguet 2000, OpenCV) finds the place.
Subpixel position, its sigma and the check by matching back are those of every match (:mod:`refine`).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from companion.core.stereo.flow import LONGEST_NS
from companion.core.stereo.least_magnitudes import least_magnitudes
from companion.core.stereo.matching import BORDER_PX, COARSE_PX, FINE_SCORE, returned
from companion.core.stereo.refine import refine
from companion.records import Bools, Bytes, Floats, Flow, FramePair, Ints, MatchSet

_LEVELS = 5  # of the pyramid: 21 px at the coarsest level are a third of a VGA image (choice)
_WINDOW_PX = 21  # convention: the window that OpenCV's Lucas-Kanade has by default
_LEAST_FOR_SHAPE = 12  # for three unknowns of either axis, and enough to outvote mismatches (choice)
_SHAPE_IRLS_STEPS = 5  # reweightings; the result only shapes the patch (choice)


@dataclass(frozen=True, slots=True, eq=False)
class EarlierView:
    """Left image of the pair before: (rows, columns) uint8."""

    pair_id: int
    mid_exposure_ns: int
    image: Bytes


def flow_since(earlier: EarlierView, pair: FramePair, matches: MatchSet) -> Flow | None:
    """Find the features of a matched pair in the earlier left image; None if that is too old, or of another size.

    Parameters
    ----------
    earlier : EarlierView
        Left image of the pair before, by the same camera.
    pair : FramePair
        The pair.
    matches : MatchSet
        Its features, without dense filling. Their left places are searched.
    """
    passed_ns = pair.left.mid_exposure_ns - earlier.mid_exposure_ns
    if not 0 < passed_ns <= LONGEST_NS or earlier.image.shape != pair.left.image.shape or not len(matches.sigma_px):
        return None
    centres = np.rint(matches.left_px).astype(np.int64)
    start, tracked = _coarse(pair.left.image, earlier.image, centres)
    size = np.array(pair.left.image.shape[::-1])
    inside = tracked & np.all((centres >= BORDER_PX) & (centres < size - BORDER_PX), axis=1)
    index = np.flatnonzero(inside)
    if not len(index):
        return None
    moved_px = start[index] - centres[index]
    slopes = np.tile(_shape(centres[index].astype(np.float64), moved_px), (len(index), 1, 1))
    fine = refine(pair.left.image, earlier.image, centres[index], start[index], _along(moved_px), slopes)
    good = fine.good & (fine.correlation > FINE_SCORE)
    good[good] = returned(pair.left.image, earlier.image, fine, good, slopes)
    # the feature's place in the later image is that of its match, a pixel or two from this patch's centre of weight
    offset_px = matches.left_px[index] - fine.left_px
    earlier_px = fine.right_px + offset_px + np.einsum("nij,nj->ni", slopes, offset_px)
    return Flow(earlier.pair_id, index[good], earlier_px[good], fine.sigma_px[good])


def _coarse(later: Bytes, earlier: Bytes, centres: Ints) -> tuple[Floats, Bools]:
    """Places (n, 2) in the earlier image, right to about a pixel, and a mask (n,) of those found."""
    points = centres.astype(np.float32).reshape(-1, 1, 2)
    window = (_WINDOW_PX, _WINDOW_PX)
    places, status, _ = cv2.calcOpticalFlowPyrLK(later, earlier, points, None, winSize=window, maxLevel=_LEVELS)
    start: Floats = places.reshape(-1, 2).astype(np.float64)
    return start, (status.ravel() > 0) & np.isfinite(start).all(axis=1)


def _along(moved: Floats) -> Floats:
    """Unit direction (n, 2) of each displacement; along the rows where nothing moved."""
    length = np.linalg.norm(moved, axis=1)[:, np.newaxis]
    along: Floats = np.where(length > 0.0, moved / np.maximum(length, 1e-9), np.array([1.0, 0.0]))
    return along


def _shape(points_px: Floats, moved_px: Floats) -> Floats:
    """Growth (2, 2) of the displacement per pixel to the right and per pixel down, by least sum of magnitudes."""
    if len(points_px) < _LEAST_FOR_SHAPE:
        return np.zeros((2, 2))
    design = np.column_stack([points_px - points_px.mean(axis=0), np.ones(len(points_px))])
    return least_magnitudes(design, moved_px, COARSE_PX, _SHAPE_IRLS_STEPS)[:2].T
