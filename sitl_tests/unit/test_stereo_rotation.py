"""Rotation algebra: group properties, agreement with scipy and OpenCV, precision at 0 and near pi."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from companion.core.stereo.rotation import exp_rotation, log_rotation, relative_rotation, skew

coordinate = st.floats(-3.0, 3.0)
vectors = st.tuples(coordinate, coordinate, coordinate).map(np.array)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))


@given(vectors)
def test_exp_is_a_proper_rotation_and_agrees_with_scipy_and_opencv(vector: np.ndarray) -> None:
    rotation = exp_rotation(vector)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert abs(np.linalg.det(rotation) - 1.0) < 1e-14
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation, cv2.Rodrigues(vector)[0], atol=1e-14)


@given(directions, st.floats(-18.0, 0.0))
def test_log_inverts_exp_with_relative_precision_down_to_tiny_angles(axis: np.ndarray, decade: float) -> None:
    vector = axis * 3.1 * 10.0**decade
    np.testing.assert_allclose(log_rotation(exp_rotation(vector)), vector, rtol=0.0, atol=2e-14 * (1e-3 + 10**decade))


@given(directions, st.floats(-12.0, -1.0))
def test_log_keeps_axis_and_angle_near_pi(axis: np.ndarray, decade: float) -> None:
    vector = axis * (np.pi - 10.0**decade)
    back = log_rotation(exp_rotation(vector))
    np.testing.assert_allclose(back, vector, atol=1e-13)


@given(directions)
def test_log_at_exactly_pi_gives_one_of_the_two_axes(axis: np.ndarray) -> None:
    half_turn = 2.0 * np.outer(axis, axis) - np.eye(3)
    back = log_rotation(half_turn)
    assert abs(np.linalg.norm(back) - np.pi) < 1e-13
    np.testing.assert_allclose(np.outer(back, back), np.pi**2 * np.outer(axis, axis), atol=1e-12)


def test_zero_is_exact_and_stacks_are_handled_at_once() -> None:
    assert np.array_equal(exp_rotation(np.zeros(3)), np.eye(3))
    assert np.array_equal(log_rotation(np.eye(3)), np.zeros(3))
    stack = np.random.default_rng(1).normal(size=(4, 5, 3))
    np.testing.assert_allclose(log_rotation(exp_rotation(stack)), stack * _wrapped(stack), atol=1e-13)
    np.testing.assert_array_equal(exp_rotation(stack)[2, 3], exp_rotation(stack[2, 3]))


@pytest.mark.parametrize("decade", [-9.0, -3.0, 0.0, 0.49])
def test_both_directions_equal_scipys_to_rounding(decade: float) -> None:
    vector = np.random.default_rng(5).standard_normal((1000, 3))
    vector *= 10.0**decade / np.linalg.norm(vector, axis=1, keepdims=True)
    rotation = Rotation.from_rotvec(vector)
    np.testing.assert_allclose(exp_rotation(vector), rotation.as_matrix(), rtol=0.0, atol=2e-15)
    ours, theirs = log_rotation(rotation.as_matrix()), Rotation.from_matrix(rotation.as_matrix()).as_rotvec()
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-14 * 10.0**decade)


def _wrapped(stack: np.ndarray) -> np.ndarray:
    """Factor that brings a rotation vector's angle into [0, pi] (negative: about the opposite axis)."""
    angle = np.linalg.norm(stack, axis=-1, keepdims=True)
    return (((angle + np.pi) % (2.0 * np.pi)) - np.pi) / angle


@given(vectors, vectors)
def test_skew_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-14)


@given(vectors, vectors, vectors)
def test_relative_rotation_takes_left_coordinates_to_right(
    left: np.ndarray, right: np.ndarray, point_body: np.ndarray
) -> None:
    left_from_body, right_from_body = exp_rotation(left), exp_rotation(right)
    seen_left, seen_right = left_from_body @ point_body, right_from_body @ point_body
    np.testing.assert_allclose(relative_rotation(right_from_body, left_from_body) @ seen_left, seen_right, atol=1e-13)


def test_quarter_turn_about_z_takes_x_to_y() -> None:
    np.testing.assert_allclose(
        exp_rotation(np.array([0.0, 0.0, np.pi / 2])) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15
    )
