"""A scene leaves out only what no ray would have hit."""

from __future__ import annotations

import numpy as np
import pytest

from companion.sim.vision.scene import Cone, Scene, board, ground, terrace


def crowded(seed: int) -> Scene:
    """Ground, and forty boards and platforms of all sizes about the origin."""
    rng = np.random.default_rng(seed)
    boards = [
        board(rng.uniform(-90.0, 90.0, 3), rng.uniform(0.0, 6.0), tuple(rng.uniform(1.0, 40.0, 2)), k)
        for k in range(1, 21)
    ]
    terraces = [
        terrace(*rng.uniform(-90.0, 90.0, 2), tuple(rng.uniform(1.0, 40.0, 2)), rng.uniform(0.0, 60.0), k)
        for k in range(21, 41)
    ]
    return Scene((ground(), *boards, *terraces), seed)


@pytest.mark.parametrize("spread", [0.01, 0.4, 1.5, 20.0])
def test_rays_hit_the_nearest_of_all_planes(spread: float) -> None:
    hits = 0
    for seed in range(10):
        scene, rng = crowded(seed), np.random.default_rng(1000 + seed)
        eye_m = np.array([*rng.uniform(-60.0, 60.0, 2), rng.uniform(-80.0, -1.0)])
        directions = rng.standard_normal(3) + spread * rng.uniform(-1.0, 1.0, (50, 3))
        expected = np.min([plane.hit(eye_m, directions) for plane in scene.planes], axis=0)
        assert scene.hit(eye_m, directions).tobytes() == expected.tobytes()
        hits += int(np.isfinite(expected).sum())
    assert hits > 100


def test_a_plane_behind_the_eye_is_left_out_and_no_rays_hit_nothing() -> None:
    ahead, behind = (board(np.array([north_m, 0.0, -10.0]), 0.0, (4.0, 4.0), 1) for north_m in (30.0, -30.0))
    scene, eye_m, north = Scene((ahead, behind), 1), np.array([0.0, 0.0, -10.0]), np.array([1.0, 0.0, 0.0])
    assert scene.visible(eye_m, [Cone(eye_m, north, 0.5)]) == [ahead]
    assert scene.visible(eye_m, [Cone(eye_m, north, 0.5), Cone(eye_m, -north, 0.5)]) == [behind, ahead]
    assert scene.hit(eye_m, np.empty((0, 3))).shape == (0,)
