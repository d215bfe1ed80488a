"""A wide lens bends: a pixel at its edge is a larger angle, and a match there says less."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.stereo.geometry import Rig
from companion.core.stereo.triangulation import Rays, range_axis_of_rig, triangulate
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.params.files import load_airframe
from companion.records import Side

WIDE = (-0.3, 0.1, 0.0, 0.0, -0.015)
SIGMA_PX, DRAWS = 0.1, 4000


def _with_lenses(focal_px: float, right_focal_px: float, distortion: tuple[float, ...]) -> Airframe:
    def lens(side: Side, camera: Camera) -> Camera:
        focal = Uncertain(focal_px if side is Side.LEFT else right_focal_px)
        return dataclasses.replace(camera, focal_px=focal, distortion=distortion)

    return load_airframe("forward-2m").with_cameras(lens)


@pytest.mark.parametrize("lenses", [(400.0, 400.0, WIDE), (400.0, 440.0, WIDE), (800.0, 720.0, (0.0,) * 5)])
@pytest.mark.parametrize("place_m", [(30.0, 0.0, 0.0), (30.0, 9.0, 5.0), (30.0, 16.0, 0.0)])
def test_the_sigma_of_a_match_is_that_of_its_place_in_the_image(
    lenses: tuple[float, float, tuple[float, ...]], place_m: tuple[float, float, float]
) -> None:
    """Noise is in the right image's pixels; 4,000 draws tell a sigma to 1.1 %."""
    rig = Rig.from_airframe(_with_lenses(*lenses))
    rests = (rig.left.rest, rig.right.rest)
    left_px, right_px = (rig.project(side, rests[side], np.array([place_m])) for side in Side)
    noisy_px = right_px + np.random.default_rng(5).normal(0.0, SIGMA_PX, (DRAWS, 2))
    left = np.repeat(rig.left.rays(rests[0], left_px), DRAWS, axis=0)
    rays = Rays(
        np.tile(rests[0].position_body_m, (DRAWS, 1)), left,
        np.tile(rests[1].position_body_m, (DRAWS, 1)), rig.right.rays(rests[1], noisy_px),
    )  # fmt: skip
    stated = rig.slope_sigma_rad(Side.RIGHT, noisy_px, np.full(DRAWS, SIGMA_PX))
    depths = triangulate(rays, range_axis_of_rig(rig, np.array([1.0, 0.0, 0.0])), stated)
    assert np.std(depths.inverse_pm) == pytest.approx(np.mean(depths.sigma_pm), rel=0.05)
