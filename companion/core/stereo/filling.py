"""Matches between the features of a forward pair: dense disparity, thinned to a grid and refined like any match.

The vision process knows no bend, and semi-global matching needs rows that agree. The bend of a forward pair is roll.
The features of the same pair show it to a tenth of a milliradian, so the rows are levelled by them first. The dense
search on small images only proposes places. Each place is then refined in the raw images, has a sigma of its own, and
is checked by matching back.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from companion.core.stereo.dense import DenseMatcher, Disparity, metric_pairs
from companion.core.stereo.geometry import Pose, Rig
from companion.core.stereo.least_magnitudes import least_magnitudes
from companion.core.stereo.rectification import Rectification, rectification, rectify_pair
from companion.core.stereo.rotation import exp_rotation
from companion.core.stereo.search import Search
from companion.records import Bytes, Floats, FramePair, MatchSet

_SMALL_WIDTH_PX = 160  # width of the images that are searched densely: speed (choice)
_STEP_PX = 32  # grid of proposed places in the raw image: speed (choice)
_LEAST_FEATURES = 12  # for two unknowns, and enough to outvote mismatches (choice)
_IRLS_STEPS = 8  # reweightings (choice)
_COARSE_RAD = 0.0003  # parallax of a good match, rad, below which all have equal weight (choice)
# Sigma of a disparity, px of the small images. Semi-global matching is biased toward whole pixels by a quarter of
# one. All points of a surface share that error, so it does not average out, and ranges use the refined matches of
# `metric_pairs` (choice).
_SIGMA_PX = 0.35
_BLOCK_PX = 16  # disparities are searched in blocks of so many (choice)


def filled(matches: MatchSet, pair: FramePair, rig: Rig, search: Search) -> MatchSet:
    """The matches of a pair, followed by those from dense disparity between them.

    With too few features to level the rows nothing is added.
    """
    poses = levelled(matches, rig, search)
    if poses is None:
        return matches
    left, right = pair.left.image, pair.right.image
    dense = _proposed(left, right, rig, search, rectification(rig, *poses))
    dense_matches = metric_pairs(dense, left, right, rig, _STEP_PX, matches.left_px)
    return dataclasses.replace(
        matches,
        left_px=np.concatenate([matches.left_px, dense_matches.left_px]),
        right_px=np.concatenate([matches.right_px, dense_matches.right_px]),
        sigma_px=np.concatenate([matches.sigma_px, dense_matches.sigma_px]),
        filled=len(dense_matches),
    )


def levelled(matches: MatchSet, rig: Rig, search: Search) -> tuple[Pose, Pose] | None:
    """The expected poses, turned against each other by the pitch and roll that make the features' rows agree.

    Each camera takes half of the rotation, as both wings bend. The fit has the least sum of magnitudes, so that wrong
    matches do not pull. None with too few matches. The parallax by a rotation is that of ``epipolar_geometry``.
    """
    if len(matches.sigma_px) < _LEAST_FEATURES:
        return None
    frame = rectification(rig, search.left, search.right)
    middle, focal = frame.matrix[:2, 2], frame.focal_px
    left = (frame.to_rectified(rig.left, search.left, matches.left_px) - middle) / focal
    right = (frame.to_rectified(rig.right, search.right, matches.right_px) - middle) / focal
    x, y = (0.5 * (left + right)).T
    parted, design = left[:, 1] - right[:, 1], np.column_stack([-(1.0 + y * y), x])
    turn = least_magnitudes(design, parted[:, np.newaxis], _COARSE_RAD, _IRLS_STEPS)[:, 0]
    half = 0.5 * frame.rectified_from_body.T @ np.array([turn[0], 0.0, turn[1]])
    return _turned(search.left, -half), _turned(search.right, half)


def _turned(pose: Pose, rotation_rad: Floats) -> Pose:
    return Pose(pose.camera_from_body @ exp_rotation(-rotation_rad), pose.position_body_m)


def _proposed(left: Bytes, right: Bytes, rig: Rig, search: Search, frame: Rectification) -> Disparity:
    """Dense disparity of the left image, at about :data:`_SMALL_WIDTH_PX` of width."""
    level = max(0, round(np.log2(left.shape[1] / _SMALL_WIDTH_PX)))
    first, count = _span(search, frame, 0.5**level)
    small = rectify_pair(frame, rig, left, right, level)
    # the matcher leaves out the first columns, where not all disparities lie inside the image
    wide = [cv2.copyMakeBorder(image, 0, 0, first + count, 0, cv2.BORDER_REPLICATE) for image in small]
    disparity = DenseMatcher(first, count).match_rectified(wide[0], wide[1])[:, first + count :]
    return Disparity(frame, disparity, _SIGMA_PX, level)


def _span(search: Search, frame: Rectification, scale: float) -> tuple[int, int]:
    """First disparity and number of disparities between the range limits, px of images of that scale."""
    bend = abs(float(frame.rectified_from_body[1, 0])) * search.bend_tolerance_rad
    shift = frame.focal_px * (bend + search.other_tolerance_rad)
    near, far = (frame.focal_px * frame.baseline_m / limit for limit in (search.min_range_m, search.max_range_m))
    first = int(np.floor((far - shift) * scale))
    blocks = -(-int(np.ceil((near + shift) * scale) - first) // _BLOCK_PX)
    return first, blocks * _BLOCK_PX
