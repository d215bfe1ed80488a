"""Rolling shutters of cameras that fly: rows of one feature differ between bent cameras, and so do their places."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.stereo.exposure import TipMotion, exposures
from companion.core.stereo.geometry import Pose, Rig
from companion.core.stereo.triangulation import match_rays, range_axis_of_rig, triangulate
from companion.params.airframe import Airframe
from companion.records import Floats, Side
from sitl_tests.unit.stereo_cases import bend, forward, ground_below, match_set, nadir, wall_ahead

ROW_NS, MIDDLE_ROW = 40_000, 239.5
TRIM_M, RATE_MPS = 0.015, 0.12
VELOCITY_MPS = np.array([20.0, 3.0, -2.0])


def _rolling_pixels(airframe: Airframe, side: Side, points_m: Floats) -> Floats:
    """Pixels (n, 2) of points (n, 3), body axes of mid-exposure: each at its own row's instant, by iteration."""
    rig, slope_radpm = Rig.from_airframe(airframe), airframe.wing.symmetric.slope_factor_radpm.value
    pixels = np.full((len(points_m), 2), MIDDLE_ROW)
    for _ in range(8):
        for index, row in enumerate(pixels[:, 1].copy()):
            t_s = 1e-9 * ROW_NS * (row - MIDDLE_ROW)
            lift_m = TRIM_M + RATE_MPS * t_s
            pose = rig.pose(side, slope_radpm * lift_m, lift_m)
            flown = Pose(pose.camera_from_body, pose.position_body_m + VELOCITY_MPS * t_s)
            pixels[index] = rig.project(side, flown, points_m[index])
    return pixels


@pytest.mark.parametrize("looks", ["down", "ahead"])
def test_rows_of_a_camera_that_flies_meet_at_the_true_depth_without_parallax(looks: str) -> None:
    """At 0.02 rad of slope the rows differ by up to three: 2.4 mm of flight, which looks like a toe."""
    airframe = nadir() if looks == "down" else forward()
    points_m = ground_below(60.0, 40, 3) if looks == "down" else wall_ahead(60.0, 40, 3)
    depth_m = points_m[:, 2] if looks == "down" else points_m[:, 0]
    rig, slope = Rig.from_airframe(airframe), airframe.wing.symmetric.slope_factor_radpm.value * TRIM_M
    wing = bend((slope, slope), (TRIM_M, 0.0), qdot_mps=(RATE_MPS, 0.0))
    moving = exposures(rig, TipMotion.from_airframe(airframe), wing, wing, VELOCITY_MPS)
    matches = match_set(*(_rolling_pixels(airframe, side, points_m) for side in Side), row_time_ns=ROW_NS)
    axis = np.array([0.0, 0.0, 1.0]) if looks == "down" else np.array([1.0, 0.0, 0.0])
    depths = triangulate(match_rays(rig, moving, matches), range_axis_of_rig(rig, axis), matches.sigma_px / 800.0)
    # a rotation vector at constant rate is the pose at constant slope rate but for the order of 1e-8
    np.testing.assert_allclose(depths.parallax_rad, 0.0, atol=1e-7)
    np.testing.assert_allclose(1.0 / depths.inverse_pm, depth_m, rtol=1e-5)
