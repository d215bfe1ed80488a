"""Obstacle sectors: the nearest trusted distance in each of 72 directions; else clear or unknown.

Sector i is centred on 5 i degrees, clockwise from forward: sector 0 spans -2.5 to +2.5 degrees. ArduPilot
(AP_Proximity_MAV) takes ``i * increment + angle_offset`` for the bearing of element i, PX4 (ObstacleMath) half an
increment either side of it; so the message begins a whole number of sectors from straight ahead.
"""

from __future__ import annotations

import math

import numpy as np

from companion.core.stereo.consistency_gate import clears, nearest_supported, precise, surely_beyond
from companion.core.stereo.inverse_depth import consistent_if_explained
from companion.core.stereo.triangulation import Depths, RangeAxis
from companion.params.settings import Settings
from companion.records import Floats, ObstacleSectors

SECTORS = 72  # elements of MAVLink's OBSTACLE_DISTANCE
_WIDTH_RAD = 2.0 * np.pi / SECTORS  # by definition: a full turn over the sectors
# Steeper rays leave the height band long before the largest range, so they clear nothing (choice).
_LEVEL = 0.1
_ABOVE_M = 5.0  # above the body's origin, up to which a point is an obstacle (choice)
_BELOW_M = 5.0  # below the body's origin, down to which a point is an obstacle (choice)


def matched_sectors(
    depths: Depths,
    range_axis: RangeAxis,
    common_sigma_pm: float,
    t_host_ns: int,
    settings: Settings,
    attitude_rad: tuple[float, float] | None = None,
    turn_sigma_rad: float = math.inf,
) -> ObstacleSectors | None:
    """Sectors from the matches of one pair; None if their vertical parallaxes show that most of them are wrong.

    Parameters
    ----------
    depths : Depths
        Inverse depths of the matches.
    range_axis : RangeAxis
        Axis along which the depths count.
    common_sigma_pm : float
        One-sigma, at the image's middle, of the error of inverse depth that all matches share (bend, calibration), 1/m.
        A toe moves the slope x of a ray by ``1 + x^2``, so this sigma grows towards the edges.
    t_host_ns : int
        Time of the pair.
    settings : Settings
        Range limits and trust ratio.
    attitude_rad : tuple, optional
        Roll and pitch. With them bearing and height count from the horizon, so that in a bank the ground is no
        obstacle; without them they count from the body's axes.
    turn_sigma_rad : float
        One-sigma of the relative rotation, for the test of parallaxes; infinite: no test.
    """
    inliers = consistent_if_explained(depths, turn_sigma_rad)
    if inliers is None:
        return None
    inverse, along_wings = depths.inverse_pm[inliers], depths.tangent[inliers, 0]
    sigma = np.hypot(depths.sigma_pm[inliers], common_sigma_pm * (1.0 + along_wings**2))
    along = range_axis.axis + depths.tangent[inliers] @ range_axis.across
    level = np.eye(3) if attitude_rad is None else level_from_body(*attitude_rad)
    return sectors_of(along @ level.T, inverse, sigma, level @ range_axis.origin_m, t_host_ns, settings)


def level_from_body(roll_rad: float, pitch_rad: float) -> Floats:
    """Rotation (3, 3) to axes of the same heading whose z points down: aerospace sequence, without the yaw."""
    cr, sr, cp, sp = np.cos(roll_rad), np.sin(roll_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    return np.array([[cp, sr * sp, cr * sp], [0.0, cr, -sr], [-sp, sr * cp, cr * cp]])


def sectors_of(
    direction: Floats, inverse_pm: Floats, sigma_pm: Floats, origin_m: Floats, t_host_ns: int, settings: Settings
) -> ObstacleSectors:
    """Nearest obstacle per sector.

    Parameters
    ----------
    direction : (n, 3) float64
        Direction from the origin to each point, scaled so that the point is ``origin + direction / inverse``; body
        axes, levelled where the attitude is known.
    inverse_pm, sigma_pm : (n,) float64
        Inverse depth and its one-sigma; may be zero or negative for what is very far.
    origin_m : (3,) float64
        Origin of the depths, in the same axes.
    t_host_ns : int
        Time of the pair.
    settings : Settings
        Range limits and trust ratio.

    Returns
    -------
    ObstacleSectors
        A sector is known if at least two points agree on a trusted distance inside the height band. It is clear if at
        least three points lie beyond the largest range and none nearer was seen. All else is unknown, also sectors that
        are out of view or without texture.
    """
    slant = np.hypot(direction[:, 0], direction[:, 1])
    bearing = np.arctan2(direction[:, 1], direction[:, 0])
    sector = np.rint(bearing / _WIDTH_RAD).astype(np.int64) % SECTORS
    far = surely_beyond(inverse_pm, sigma_pm, slant, settings) & (np.abs(direction[:, 2]) < _LEVEL * slant)
    positive = np.where(inverse_pm > 0.0, inverse_pm, np.nan)
    points = origin_m + direction / positive[:, np.newaxis]
    distance = np.hypot(points[:, 0], points[:, 1])
    in_band = (points[:, 2] >= -_ABOVE_M) & (points[:, 2] <= _BELOW_M)
    in_range = (distance >= settings.min_range_m) & (distance <= settings.max_range_m)
    solid = in_band & in_range & precise(positive, sigma_pm, settings)
    nearest, sigma_m = np.zeros(SECTORS), np.zeros(SECTORS)
    for index in np.unique(sector[solid]):
        here = np.flatnonzero(solid & (sector == index))
        nearest[index], sigma_m[index] = nearest_supported(
            distance[here], distance[here] * sigma_pm[here] / positive[here]
        )
    occupied = nearest > 0.0
    far_support = clears(np.bincount(sector[far], minlength=SECTORS))
    obstructed = np.bincount(sector[in_band & (distance <= settings.max_range_m)], minlength=SECTORS) > 0
    clear = far_support & ~occupied & ~obstructed
    return ObstacleSectors(t_host_ns, nearest, sigma_m, occupied, clear, settings.min_range_m, settings.max_range_m)
