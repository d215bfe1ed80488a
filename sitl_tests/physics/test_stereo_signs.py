"""Signed closed forms of a bending rig, written out by hand: which way things move in the images, and by how much."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.stereo.geometry import Rig
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Side

FOCAL, BASELINE, COLUMN, ROW = 800.0, 1.98, 319.5, 239.5


@pytest.fixture(scope="module")
def nadir() -> Rig:
    return Rig.from_airframe(load_airframe("nadir-2m"))


@pytest.fixture(scope="module")
def forward() -> Rig:
    return Rig.from_airframe(_looking(load_airframe("nadir-2m"), ("y", "z", "x")))


def _looking(airframe: Airframe, axes: tuple[str, str, str]) -> Airframe:
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    return dataclasses.replace(
        airframe,
        left_camera=dataclasses.replace(airframe.left_camera, axes=axes),
        right_camera=dataclasses.replace(airframe.right_camera, axes=axes),
    )


def _projected(
    rig: Rig, point: tuple[float, float, float], slope: float, twist: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    left = rig.project(Side.LEFT, rig.pose(Side.LEFT, slope, 0.0, twist), np.array(point))
    right = rig.project(Side.RIGHT, rig.pose(Side.RIGHT, slope, 0.0, twist), np.array(point))
    return left, right


@pytest.mark.parametrize(("range_m", "disparity_px"), [(4.0, 396.0), (60.0, 26.4), (200.0, 7.92)])
def test_disparity_of_the_resting_nadir_pair_is_focal_times_baseline_over_range(
    nadir: Rig, range_m: float, disparity_px: float
) -> None:
    left, right = _projected(nadir, (0.0, 0.0, range_m), 0.0)
    assert left[0] - right[0] == pytest.approx(disparity_px, abs=1e-9)
    assert left[1] == pytest.approx(right[1], abs=1e-9)


def test_up_bend_of_a_nadir_pair_diverges_and_adds_disparity(nadir: Rig) -> None:
    """Both tips up by 2.25 mrad: disparity grows by f * 4.5 mrad = 3.6 px, so the rigid range of 60 m reads 52.8 m."""
    rest_left, rest_right = _projected(nadir, (0.0, 0.0, 60.0), 0.0)
    left, right = _projected(nadir, (0.0, 0.0, 60.0), 0.00225)
    assert (left[0] - right[0]) - (rest_left[0] - rest_right[0]) == pytest.approx(3.6, abs=0.002)
    assert FOCAL * BASELINE / (left[0] - right[0]) == pytest.approx(60.0 / (1.0 + 60.0 * 0.0045 / 1.98), abs=0.005)
    left, right = _projected(nadir, (0.0, 0.0, 60.0), 0.002239)  # the angle of the paper's board
    assert FOCAL * BASELINE / (left[0] - right[0]) == pytest.approx(52.83, abs=0.005)
    assert left[0] > rest_left[0]
    assert right[0] < rest_right[0]


def test_antisymmetric_bend_of_a_nadir_pair_moves_both_images_the_same_way(nadir: Rig) -> None:
    """Left tip down, right tip up: both cameras roll to the right wing's side together, no toe."""
    point = np.array([0.0, 0.0, 60.0])
    left = nadir.project(Side.LEFT, nadir.pose(Side.LEFT, -0.002, 0.0), point)
    right = nadir.project(Side.RIGHT, nadir.pose(Side.RIGHT, 0.002, 0.0), point)
    rest_left, rest_right = _projected(nadir, (0.0, 0.0, 60.0), 0.0)
    assert left[0] - rest_left[0] == pytest.approx(-1.6, abs=0.003)
    assert right[0] - rest_right[0] == pytest.approx(-1.6, abs=0.003)


def test_nose_up_twist_of_a_nadir_pair_moves_the_ground_down_the_image(nadir: Rig) -> None:
    """Nose-up turns the view forward; what was at the centre is then behind, that is lower in the image."""
    left, right = _projected(nadir, (0.0, 0.0, 60.0), 0.0, twist=0.005)
    rest_left, rest_right = _projected(nadir, (0.0, 0.0, 60.0), 0.0)
    for bent, rest in ((left, rest_left), (right, rest_right)):
        assert bent[1] - rest[1] == pytest.approx(4.0, abs=0.01)


def test_lift_raises_the_camera_and_lengthens_the_range(nadir: Rig) -> None:
    point = np.array([0.5, 0.0, 20.0])
    low = nadir.project(Side.LEFT, nadir.pose(Side.LEFT, 0.0, 0.0), point)
    high = nadir.project(Side.LEFT, nadir.pose(Side.LEFT, 0.0, 0.05), point)
    assert low[0] - COLUMN == pytest.approx(FOCAL * 0.99 / 20.0, abs=1e-9)
    assert high[0] - COLUMN == pytest.approx(FOCAL * 0.99 / 20.05, abs=1e-9)
    assert high[1] - ROW == pytest.approx(-FOCAL * 0.5 / 20.05, abs=1e-9)


def test_bend_of_a_forward_pair_is_roll(forward: Rig) -> None:
    """4.5 mrad between the cameras gives 1.08 px of disparity error at rows +-240 and 1.44 px of
    vertical parallax at columns +-320, f = 800; with up-bend the error is positive at the bottom rows.

    The left camera, turned by +psi about its viewing axis (clockwise as it looks), sees a point at (x, y) from its
    centre go to (x + psi y, y - psi x); the right camera the other way round.
    """
    slope, far = 0.00225, 1.0e6
    for row in (-240.0, 240.0):
        left, right = _projected(forward, (far, 0.0, far * row / FOCAL), slope)
        assert left[0] - right[0] == pytest.approx(0.0045 * row, abs=3e-3)
        assert abs(left[0] - right[0]) == pytest.approx(1.08, abs=3e-3)
    for column in (-320.0, 320.0):
        left, right = _projected(forward, (far, far * column / FOCAL, 0.0), slope)
        assert left[1] - right[1] == pytest.approx(-0.0045 * column, abs=3e-3)
        assert abs(left[1] - right[1]) == pytest.approx(1.44, abs=3e-3)


def test_bend_of_a_forward_pair_leaves_the_disparity_of_the_middle_row_alone(forward: Rig) -> None:
    rest_left, rest_right = _projected(forward, (60.0, 0.0, 0.0), 0.0)
    left, right = _projected(forward, (60.0, 0.0, 0.0), 0.02)
    assert left[0] - right[0] == pytest.approx(rest_left[0] - rest_right[0], abs=0.01)


@pytest.mark.parametrize("elevation_deg", [-60.0, -30.0, -10.0])
def test_any_look_angle_mixes_toe_and_roll(elevation_deg: float) -> None:
    """A pair looking down by e sees bending as yaw by sin(e): a distant point straight ahead moves f theta sin(e)."""
    tilt = np.radians(elevation_deg)
    airframe = _looking(load_airframe("nadir-2m"), ("y", "z", "x"))
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    tilted = dataclasses.replace(
        airframe,
        left_camera=dataclasses.replace(airframe.left_camera, rotation_rad=(tilt, 0.0, 0.0)),
        right_camera=dataclasses.replace(airframe.right_camera, rotation_rad=(tilt, 0.0, 0.0)),
    )
    far = 1.0e6 * np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    left, right = _projected(Rig.from_airframe(tilted), (far[0], far[1], far[2]), 0.00225)
    assert left[0] - right[0] == pytest.approx(FOCAL * 0.0045 * np.sin(-tilt), abs=0.01)
    assert left[1] == pytest.approx(ROW, abs=0.01)
