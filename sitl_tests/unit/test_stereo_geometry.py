"""The rig: lens round trips against OpenCV, rest attitudes, and refusals of contradictory airframes."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.stereo.correction import Correction
from companion.core.stereo.geometry import Lens, Rig, axes_from_body
from companion.core.stereo.rotation import exp_rotation
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Side

EUROC = np.array([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0])
MATRIX = np.array([[458.654, 0.0, 367.215], [0.0, 458.654, 248.375], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def nadir() -> Airframe:
    return load_airframe("nadir-2m")


def _changed(airframe: Airframe, **changes: object) -> Airframe:
    assert airframe.left_camera is not None
    return dataclasses.replace(airframe, left_camera=dataclasses.replace(airframe.left_camera, **changes))


distortions = st.tuples(
    st.floats(-0.3, 0.3),
    st.floats(-0.05, 0.08),
    st.floats(-0.002, 0.002),
    st.floats(-0.002, 0.002),
    st.floats(-0.01, 0.01),
).map(np.array)


@given(distortions, st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_projection_agrees_with_opencv_and_unprojection_inverts_it(distortion: np.ndarray, seed: int) -> None:
    lens = Lens(MATRIX, distortion, (752, 480))
    random = np.random.default_rng(seed)
    points = np.column_stack([random.uniform(-0.5, 0.5, 40), random.uniform(-0.4, 0.4, 40), np.ones(40)])
    points *= random.uniform(2.0, 200.0, (40, 1))
    pixels = lens.project(points)
    reference = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, distortion)[0][:, 0]
    np.testing.assert_allclose(pixels, reference, atol=1e-9)
    np.testing.assert_allclose(lens.unproject(pixels), points / points[:, 2:], atol=1e-9)


def test_a_wide_lens_is_inverted_over_its_whole_image() -> None:
    lens = Lens(MATRIX, EUROC, (752, 480))
    columns, rows = np.meshgrid(np.linspace(0, 751, 40), np.linspace(0, 479, 30))
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    np.testing.assert_allclose(lens.project(lens.unproject(pixels)), pixels, atol=1e-6)


def test_what_is_behind_the_camera_is_nowhere() -> None:
    lens = Lens(MATRIX, EUROC, (752, 480))
    assert np.isnan(lens.project(np.array([[0.0, 0.0, -1.0], [0.1, 0.0, 0.0]]))).all()
    assert lens.unproject(np.empty((0, 2))).shape == (0, 3)


def test_axes_name_body_directions() -> None:
    nadir_from_body = axes_from_body(("y", "-x", "z"), "here")
    np.testing.assert_array_equal(nadir_from_body @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0])  # forward is up in the image
    np.testing.assert_array_equal(nadir_from_body @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])  # right wing is right
    np.testing.assert_array_equal(nadir_from_body @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0])  # down is ahead


@pytest.mark.parametrize(
    "axes", [("y", "x", "z"), ("y", "y", "z"), ("-y", "-x", "z"), ("right", "-x", "z"), ("", "x", "y")]
)
def test_contradictory_axes_are_named(axes: tuple[str, str, str], nadir: Airframe) -> None:
    with pytest.raises(ConfigError, match=r"left_camera\.axes"):
        Rig.from_airframe(_changed(nadir, axes=axes))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"focal_px": Uncertain(0.0)}, "focal_px"),
        ({"width_px": 0}, "width_px"),
        ({"distortion": (0.1, 0.2)}, "distortion needs 5"),
        ({"distortion": (-0.42, 0.25, 0.0, 0.0, -0.08), "focal_px": Uncertain(400.0)}, "distortion folds"),
        ({"row_time_s": 3e-5}, "row_time_s of the cameras differ"),
        ({"position_m": (0.0, 0.99, 0.0)}, "smaller position_m y"),
        ({"axes": ("y", "z", "x")}, "45 degrees"),
        ({"axes": ("-y", "x", "z")}, "rolled by 180 degrees against each other"),
        ({"axes": ("x", "y", "z")}, "rolled by 90 degrees"),
        ({"rotation_rad": (0.0, 0.0, -0.23)}, "rolled by 13 degrees"),
        ({"focal_px": Uncertain(930.0)}, r"a factor of 1\.16"),
        ({"focal_px": Uncertain(640.0)}, r"a factor of 1\.25"),
        ({"focal_ratio": 0.8}, r"a factor of 1\.25"),
    ],
)
def test_impossible_cameras_are_refused_by_name(change: dict[str, object], message: str, nadir: Airframe) -> None:
    with pytest.raises(ConfigError, match=message):
        Rig.from_airframe(_changed(nadir, **change))


@pytest.mark.parametrize(
    "change",
    [
        {"rotation_rad": (0.0, 0.0, 0.2)},
        {"rotation_rad": (0.0, 0.6, 0.0)},  # toed in: no roll
        {"rotation_rad": (0.4, 0.0, 0.0)},
        {"focal_px": Uncertain(910.0)},
    ],
)
def test_cameras_that_see_alike_are_a_pair(change: dict[str, object], nadir: Airframe) -> None:
    assert Rig.from_airframe(_changed(nadir, **change)).baseline_m > 0.0


@pytest.mark.parametrize("axes", [("-y", "x", "z"), ("x", "y", "z")])
def test_both_cameras_may_be_mounted_the_other_way_up(axes: tuple[str, str, str], nadir: Airframe) -> None:
    turned = _changed(nadir, axes=axes)
    right = dataclasses.replace(_camera(nadir.right_camera), axes=axes)
    assert Rig.from_airframe(dataclasses.replace(turned, right_camera=right)).baseline_m > 0.0


def test_cameras_that_look_along_the_baseline_are_refused(nadir: Airframe) -> None:
    sideways = {"axes": ("-x", "z", "y")}
    both = dataclasses.replace(
        nadir,
        left_camera=dataclasses.replace(_camera(nadir.left_camera), **sideways),
        right_camera=dataclasses.replace(_camera(nadir.right_camera), **sideways),
    )
    with pytest.raises(ConfigError, match="along their baseline"):
        Rig.from_airframe(both)


@pytest.mark.parametrize(("orientation", "said"), [(0, "it is 25"), (2, "it is 25"), (24, "it is 25"), (1, "possible")])
def test_an_orientation_where_no_camera_looks_is_refused(orientation: int, said: str, nadir: Airframe) -> None:
    Correction.create(nadir, Settings())
    with pytest.raises(ConfigError, match=said):
        Correction.create(dataclasses.replace(nadir, orientation=orientation), Settings())


def test_a_pair_needs_two_cameras(nadir: Airframe) -> None:
    with pytest.raises(ConfigError, match="left_camera"):
        Rig.from_airframe(dataclasses.replace(nadir, left_camera=None))


def _camera(camera: Camera | None) -> Camera:
    assert camera is not None
    return camera


def test_calibrated_rotation_is_in_camera_axes(nadir: Airframe) -> None:
    rig = Rig.from_airframe(_changed(nadir, rotation_rad=(0.0, 0.01, 0.0)))
    # a camera turned to its right (positive about its own y, which points down) sees things further left
    ahead = rig.left.rest.position_body_m + np.array([0.0, 0.0, 50.0])
    column, row = rig.project(Side.LEFT, rig.left.rest, ahead)
    assert column == pytest.approx(319.5 - 800.0 * np.tan(0.01), abs=1e-9)
    assert row == pytest.approx(239.5, abs=1e-9)


@given(st.floats(-0.1, 0.1), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_rays_pass_through_what_is_projected(slope: float, lift: float, twist: float, seed: int) -> None:
    rig = Rig.from_airframe(load_airframe("nadir-2m"))
    points = np.random.default_rng(seed).uniform([-3, -3, 20], [3, 3, 60], (10, 3))
    for side in Side:
        pose = rig.pose(side, slope, lift, twist)
        rays = rig.camera(side).rays(pose, rig.project(side, pose, points))
        assert np.abs(np.cross(rays, points - pose.position_body_m)).max() < 1e-9


def test_rest_pose_is_the_pose_without_bend(nadir: Airframe) -> None:
    rig = Rig.from_airframe(nadir)
    for side in Side:
        rest, pose = rig.camera(side).rest, rig.pose(side, 0.0, 0.0)
        np.testing.assert_array_equal(pose.camera_from_body, rest.camera_from_body)
        np.testing.assert_array_equal(pose.position_body_m, rest.position_body_m)
    assert rig.baseline_m == pytest.approx(1.98)


def test_gains_scale_slope_and_lift(nadir: Airframe) -> None:
    rig = Rig.from_airframe(_changed(nadir, slope_gain=0.8, lift_gain=0.5))
    pose = rig.pose(Side.LEFT, 0.02, 0.010)
    np.testing.assert_allclose(
        pose.camera_from_body, rig.left.rest.camera_from_body @ exp_rotation(np.array([-0.016, 0.0, 0.0])), atol=1e-15
    )
    assert pose.position_body_m[2] == pytest.approx(-0.005)
