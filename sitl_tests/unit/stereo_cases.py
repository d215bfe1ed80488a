"""Airframes, deflections and exact matches for the ranging tests."""

from __future__ import annotations

import dataclasses

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.records import ClockName, Deflection, MatchSet, Side

FORWARD_AXES = ("y", "z", "x")


def nadir(**camera: object) -> Airframe:
    """The demo's airframe, with changes to both cameras."""
    airframe = load_airframe("nadir-2m")
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    return dataclasses.replace(
        airframe,
        left_camera=dataclasses.replace(airframe.left_camera, **camera),
        right_camera=dataclasses.replace(airframe.right_camera, **camera),
    )


def forward(**camera: object) -> Airframe:
    """The same aircraft with both cameras looking ahead."""
    return dataclasses.replace(nadir(axes=FORWARD_AXES, **camera), orientation=0)


def perfect_calibration(**camera: object) -> dict[str, object]:
    """Camera fields of a calibration without error."""
    return {"rotation_sigma_rad": 0.0, "focal_px": Uncertain(800.0, 0.0), **camera}


def bend(
    slope_rad: tuple[float, float] = (0.0, 0.0),
    q_m: tuple[float, float] = (0.0, 0.0),
    *,
    t_ns: int = 0,
    qdot_mps: tuple[float, float] = (0.0, 0.0),
    rate_radps: tuple[float, float, float] = (0.0, 0.0, 0.0),
    slope_sigma_rad: float = 0.0,
    correlation: float = 0.0,
) -> Deflection:
    """A deflection with the given slopes; ``slope_sigma_rad`` per tip, correlated between the tips as said."""
    covariance = np.zeros((6, 6))
    covariance[4:, 4:] = slope_sigma_rad**2 * np.array([[1.0, correlation], [correlation, 1.0]])
    return Deflection(
        t_ns, np.array(q_m), np.array(qdot_mps), np.array(slope_rad), covariance, np.array(rate_radps), 0, 0.0
    )


def raw_pixels(
    rig: Rig, points_m: np.ndarray, slope_rad: tuple[float, float], lift_m: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Exact raw pixels of points by both cameras of a bent wing."""
    return (
        rig.project(Side.LEFT, rig.pose(Side.LEFT, slope_rad[0], lift_m[0]), points_m),
        rig.project(Side.RIGHT, rig.pose(Side.RIGHT, slope_rad[1], lift_m[1]), points_m),
    )


def match_set(
    left_px: np.ndarray,
    right_px: np.ndarray,
    sigma_px: float = 0.1,
    *,
    mid_exposure_ns: tuple[int, int] = (0, 0),
    row_time_ns: int = 0,
) -> MatchSet:
    """Matches as vision hands them over."""
    return MatchSet(
        pair_id=3,
        plan_id=8,
        clocks=(ClockName.HOST, ClockName.HOST),
        mid_exposure_ns=np.array(mid_exposure_ns),
        exposure_ns=2_000_000,
        row_time_ns=row_time_ns,
        left_px=left_px,
        right_px=right_px,
        sigma_px=np.full(len(left_px), sigma_px),
        matched_host_ns=0,
    )


def ground_below(
    range_m: float, count: int, seed: int, tilt: tuple[float, float] = (0.0, 0.0), spread: float = 0.3
) -> np.ndarray:
    """Points on the plane z = range + tilt . (x, y) under the aircraft; the spread fills the common field of view."""
    random = np.random.default_rng(seed)
    x, y = (random.uniform(-fraction * spread, fraction * spread, count) * range_m for fraction in (0.9, 1.0))
    return np.column_stack([x, y, range_m + tilt[0] * x + tilt[1] * y])


def wall_ahead(range_m: float, count: int, seed: int) -> np.ndarray:
    """Points of a wall across the flight direction."""
    random = np.random.default_rng(seed)
    y, z = random.uniform(-0.3, 0.3, count) * range_m, random.uniform(-0.27, 0.27, count) * range_m
    return np.column_stack([np.full(count, range_m), y, z])
