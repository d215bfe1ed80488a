"""Corrected ranges, the rotation between the cameras, and obstacles around the vehicle."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.records.vocabulary import Bools, Floats, Reject


@dataclass(frozen=True, slots=True)
class CorrectedRange:
    """A range at mid-exposure, corrected for the bend, with everything that tells how far to trust it.

    ``toe_rad`` is the relative rotation that was taken out (positive: axes diverge, the raw range reads short);
    ``rigid_range_m`` is what the ground calibration alone would have said (0 where it has no finite answer).
    ``range_m`` is 0 where the pair has no finite answer, ``toe_sigma_rad`` where it had too little to correct at all.
    """

    pair_id: int
    plan_id: int
    t_host_ns: int
    orientation: int
    range_m: float
    sigma_m: float
    toe_rad: float
    toe_sigma_rad: float
    rigid_range_m: float
    matches: int
    trusted: bool
    reject: Reject | None


@dataclass(frozen=True, slots=True)
class RelativeRotation:
    """Rotation of the right camera against the left beyond the tracked bend, from one pair's matches.

    Rotation vectors in the epipolar frame: x along the baseline (pitch), y across it (yaw: the toe of a pair), z where
    the cameras look (roll). Yaw is seen weakly in distant flat scenes; the covariances say how weakly.

    Attributes
    ----------
    rotation_rad, covariance : (3,), (3, 3) float64
        At this exposure, what the tracker's fast part has wrong included: the pair is corrected by this.
    slow_rad, slow_covariance : (3,), (3, 3) float64
        The slow part alone (static bend, thermal set, mounting), carried from pair to pair.
    parallax_scale : float
        How much more the matches scatter across the epipolar lines than their sigmas say; 0 where none were used.
    lens : (9,) float64
        Residual of the lenses, left minus right: relative focal length, first radial term, keystone x and y, thin prism
        x and y; means of the radial terms and of the keystones (:mod:`companion.core.stereo.lens_residual`).
    flow : int
        Features whose motion since an earlier left image told of the rotation too.
    """

    pair_id: int
    t_host_ns: int
    rotation_rad: Floats
    covariance: Floats
    slow_rad: Floats
    slow_covariance: Floats
    matches: int
    parallax_scale: float
    lens: Floats = field(default_factory=lambda: np.zeros(9))
    flow: int = 0


@dataclass(frozen=True, slots=True)
class NoRange:
    """Alive, but without a range to trust: what goes out instead of an old number."""

    at_host_ns: int
    orientation: int
    reject: Reject


@dataclass(frozen=True, slots=True)
class ObstacleSectors:
    """Nearest obstacle in each of 72 sectors of 5 degrees, clockwise from forward, body FRD.

    ``distance_m`` is meaningful where ``known``; ``clear`` marks sectors that were looked at and found empty.
    """

    t_host_ns: int
    distance_m: Floats
    sigma_m: Floats
    known: Bools
    clear: Bools
    min_m: float
    max_m: float
