"""Matches of a forward pair whose cameras a bent wing rolls against each other, held against a plane of known depth."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from companion.core.stereo.geometry import MountedCamera, Pose, Rig
from companion.core.stereo.matching import Matches, match
from companion.core.stereo.search import expected_search
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Bytes, Floats

DEPTH_M = 40.0
GREY_SIGMA = 1.5
TEXTURE_PX = 2048


def matched(roll_rad: float) -> tuple[Matches, Floats]:
    """Matches of a textured plane ahead, and what each right point misses the true one by, px (n, 2)."""
    rig = Rig.from_airframe(load_airframe("forward-2m"))
    random = np.random.default_rng(7)
    texture = cv2.GaussianBlur(random.standard_normal((TEXTURE_PX, TEXTURE_PX)).astype(np.float32), (0, 0), 2.0)
    texture = 128.0 + 40.0 * texture / texture.std()
    search = expected_search(rig, Settings(), (roll_rad / 2.0,) * 2, (0.0, 0.0), 0.004)

    def image(camera: MountedCamera, pose: Pose) -> Bytes:
        width, height = camera.lens.size_px
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
        scale = 0.9 * camera.lens.matrix[0, 0] / DEPTH_M
        at = (scale * on_plane(camera, pose, pixels)[:, 1:] + TEXTURE_PX / 2).astype(np.float32)
        columns, rows = (np.ascontiguousarray(values_px.reshape(height, width)) for values_px in at.T)
        grey = cv2.remap(texture, columns, rows, cv2.INTER_CUBIC) + GREY_SIGMA * random.standard_normal((height, width))
        return np.clip(np.rint(grey), 0, 255).astype(np.uint8)

    matches = match(image(rig.left, search.left), image(rig.right, search.right), rig, search)
    true_px = rig.right.project(search.right, on_plane(rig.left, search.left, matches.left_px))
    return matches, matches.right_px - true_px


def on_plane(camera: MountedCamera, pose: Pose, pixels: Floats) -> Floats:
    rays = camera.rays(pose, pixels)
    depth = (DEPTH_M - pose.position_body_m[0]) / rays[:, 0]
    points: Floats = pose.position_body_m + rays * depth[:, np.newaxis]
    return points


@pytest.mark.parametrize("roll_rad", [0.1, 0.3])
def test_an_expected_roll_costs_neither_matches_nor_accuracy(roll_rad: float) -> None:
    """Taken to first order, a patch's shape lost 6 of 7 matches at 0.3 rad and a quarter of the accuracy at 0.1."""
    level, level_px = matched(0.0)
    rolled, rolled_px = matched(roll_rad)
    assert len(rolled) > 0.85 * len(level)
    assert np.median(rolled.sigma_px) < 1.1 * np.median(level.sigma_px)
    assert np.median(np.abs(rolled_px)) < 1.2 * np.median(np.abs(level_px))
    assert np.abs(np.median(rolled_px, axis=0)).max() < 0.01
