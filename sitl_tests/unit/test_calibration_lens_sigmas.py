"""Sigmas that a calibration writes of its lenses, against closed forms: each OpenCV term alone, and what trades."""

from __future__ import annotations

import numpy as np
import pytest

from companion.calibration.bundle import SHARED, Bundle
from companion.calibration.lens_sigmas import lens_sigmas, look_sigma_rad

SIZE, FOCAL_PX = (640, 480), 800.0
LENS = [FOCAL_PX, FOCAL_PX, 319.5, 239.5, 0.0, 0.0, 0.0, 0.0, 0.0]
RIGHT_CX, RIGHT_P2, RIGHT_K1, LEFT_P1, YAW = 9 + 2, 9 + 7, 9 + 4, 6, 18 + 1


def _bundle(covariance: np.ndarray) -> Bundle:
    tiny = 1e-24 * np.eye(SHARED)
    return Bundle(np.array([*LENS, *LENS, 0.0, 0.0, 0.0, -1.98, 0.0, 0.0]), covariance + tiny, np.zeros((0, 6)), [])


def _of_one(index: int, sigma: float) -> Bundle:
    covariance = np.zeros((SHARED, SHARED))
    covariance[index, index] = sigma**2
    return _bundle(covariance)


@pytest.mark.parametrize(("index", "side"), [(RIGHT_P2, 1), (LEFT_P1, 0)])
def test_a_tangential_term_is_a_prism_and_twice_as_much_keystone(index: int, side: int) -> None:
    sigmas = lens_sigmas(_of_one(index, 1e-4), SIZE)
    assert sigmas[side].prism == pytest.approx(1e-4, rel=1e-3)
    assert sigmas[side].tilt_rad == pytest.approx(2e-4, rel=1e-3)
    assert sigmas[1 - side].prism < 1e-9
    assert look_sigma_rad(_of_one(index, 1e-4), SIZE).max() < 1e-8


def test_a_radial_term_is_one() -> None:
    right = lens_sigmas(_of_one(RIGHT_K1, 1e-3), SIZE)[1]
    assert right.radial == pytest.approx(1e-3, rel=1e-3)
    assert right.tilt_rad < 1e-8


def test_a_principal_point_is_a_turn_and_a_keystone() -> None:
    bundle = _of_one(RIGHT_CX, 0.4)
    assert lens_sigmas(bundle, SIZE)[1].tilt_rad == pytest.approx(0.4 / FOCAL_PX, rel=1e-3)
    assert look_sigma_rad(bundle, SIZE) == pytest.approx([0.0, 0.4 / FOCAL_PX, 0.0], rel=1e-3, abs=1e-8)


def test_a_yaw_that_undoes_a_principal_point_leaves_the_look_known_and_the_keystone_not() -> None:
    """A far point moves by ``f yaw`` for a right-from-left rotation, by ``c`` for the principal point."""
    turned = np.zeros(SHARED)
    turned[RIGHT_CX], turned[YAW] = 0.4, -0.4 / FOCAL_PX
    bundle = _bundle(np.outer(turned, turned))
    assert look_sigma_rad(bundle, SIZE).max() < 1e-8
    assert lens_sigmas(bundle, SIZE)[1].tilt_rad == pytest.approx(0.4 / FOCAL_PX, rel=1e-3)
