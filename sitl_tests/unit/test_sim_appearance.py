"""Images of a world by closed forms: light to the corners, haze over distance, unequal noise, perfect by default."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.core.stereo.geometry import Rig
from companion.params.files import load_airframe
from companion.records import Side
from companion.sim.flight.worlds import FAIR, ImageFaults
from companion.sim.vision.appearance import Appearance
from companion.sim.vision.scene import PosedCamera, ground_scene

HEIGHT_M = 80.0


@pytest.fixture(scope="module")
def view() -> PosedCamera:
    rig = Rig.from_airframe(load_airframe("nadir-2m"))
    return PosedCamera.from_body(rig.left, rig.left.rest, np.eye(3), np.array([0.0, 0.0, -HEIGHT_M]))


def test_the_corner_loses_its_share_of_light_and_the_gain_counts_everywhere(view: PosedCamera) -> None:
    flat = np.full((480, 640), 100.0, np.float32)
    shown = Appearance(0.4, 0.0, 1.1, 1.0, 0.0).applied(flat, view, ground_scene(1))
    assert shown[0, 0] == pytest.approx(100.0 * 1.1 * 0.6, rel=1e-3)
    assert shown[240, 320] == pytest.approx(110.0, rel=1e-3)


def test_contrast_falls_with_distance_as_koschmieder_has_it(view: PosedCamera) -> None:
    scene = ground_scene(1)
    pattern = np.where(np.arange(640) // 8 % 2, 90.0, 110.0).astype(np.float32) * np.ones((480, 1), np.float32)
    shown = Appearance(0.0, 0.0, 1.0, 1.0, 1000.0).applied(pattern, view, scene)
    transmission = math.exp(-3.912 * HEIGHT_M / 1000.0)
    middle = shown[236:244, 312:328]
    assert np.ptp(middle) == pytest.approx(20.0 * transmission, rel=0.01)
    assert middle.mean() == pytest.approx(scene.sky + transmission * (100.0 - scene.sky), rel=0.01)


def test_defocus_is_a_gaussian_of_its_width(view: PosedCamera) -> None:
    dot = np.zeros((480, 640), np.float32)
    dot[240, 320] = 1000.0
    shown = Appearance(0.0, 0.8, 1.0, 1.0, 0.0).applied(dot, view, ground_scene(1))
    x = np.arange(640) - 320.0
    spread = shown.sum(axis=0)
    assert float(spread.sum()) == pytest.approx(1000.0, rel=1e-4)
    assert math.sqrt(float(spread @ x**2) / float(spread.sum())) == pytest.approx(0.8, rel=0.05)


def test_ideal_images_are_left_alone_and_each_camera_has_its_own_draw() -> None:
    assert Appearance.draw(ImageFaults(), Side.LEFT, 1) is None
    left, right = (Appearance.draw(FAIR.images, side, 1) for side in Side)
    assert left is not None
    assert left == Appearance.draw(FAIR.images, Side.LEFT, 1)
    assert left != right
