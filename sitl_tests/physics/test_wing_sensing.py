"""What a tip sensor sees, against signed closed forms and against points carried through space by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from companion.core.wing.model import WingModel
from companion.core.wing.sensing import (
    ModalPath,
    RigidMotion,
    lever_arm_mps2,
    remove_rigid_motion,
    sense_station,
    sensing_rows,
)
from companion.params.airframe import Gust, Mode, Uncertain, Wing
from companion.records import Side

G = 9.80665
SYMMETRIC = Mode(Uncertain(5.0), Uncertain(0.03), Uncertain(1.4), Uncertain(0.5))
ANTISYMMETRIC = Mode(Uncertain(6.4), Uncertain(0.03), Uncertain(1.6), Uncertain(-0.3))
MODEL = WingModel(Wing(1.0, SYMMETRIC, ANTISYMMETRIC, Gust(Uncertain(0.005)), Uncertain(0.0), Uncertain(0.015)))
TIP = {Side.LEFT: np.array([0.1, -1.0, 0.05]), Side.RIGHT: np.array([0.1, 1.0, 0.05])}
NONE = np.zeros((1, 2))


def _steady(
    force: tuple[float, float, float] = (0.0, 0.0, -G),
    rate: tuple[float, float, float] = (0, 0, 0),
    spin: tuple[float, float, float] = (0, 0, 0),
) -> RigidMotion:
    return RigidMotion(np.array([force]), np.array([rate], float), np.array([spin], float))


def _path(
    q: tuple[float, float] = (0, 0), rate: tuple[float, float] = (0, 0), accel: tuple[float, float] = (0, 0)
) -> ModalPath:
    return ModalPath(np.array([q], float), np.array([rate], float), np.array([accel], float))


@pytest.mark.parametrize("side", list(Side))
def test_level_and_at_rest_only_gravity(side: Side) -> None:
    assert sense_station(MODEL, side, TIP[side], _steady(), _path())[0] == pytest.approx([0, 0, -G, 0, 0, 0])


@pytest.mark.parametrize(("side", "sign"), [(Side.LEFT, 1.0), (Side.RIGHT, -1.0)])
def test_up_bend_shows_gravity_on_the_lateral_axis_inward(side: Side, sign: float) -> None:
    # up-bent by psi, the left sensor leans right-side-down: lateral is +psi f_z with f_z = -g; the right is its mirror
    psi = 1.4 * 0.02
    seen = sense_station(MODEL, side, TIP[side], _steady(), _path((0.02, 0.0)))[0]
    assert seen[1] == pytest.approx(-sign * G * math.sin(psi), rel=1e-4)
    assert seen[1] * sign < 0.0


@pytest.mark.parametrize("side", list(Side))
def test_nose_up_twist_shows_gravity_forward(side: Side) -> None:
    # nose up by tau: the sensor's x axis points above the horizon and feels +g sin tau, as a pitched-up aircraft does
    seen = sense_station(MODEL, side, TIP[side], _steady(), _path((0.02, 0.0)))[0]
    assert seen[0] == pytest.approx(G * math.sin(0.5 * 0.02), rel=1e-3)


def test_a_tip_that_accelerates_upward_feels_heavier_and_antisymmetry_has_its_sign() -> None:
    symmetric = [sense_station(MODEL, side, TIP[side], _steady(), _path(accel=(3.0, 0.0)))[0, 2] for side in Side]
    antisymmetric = [sense_station(MODEL, side, TIP[side], _steady(), _path(accel=(0.0, 2.0)))[0, 2] for side in Side]
    assert symmetric == pytest.approx([-G - 3.0, -G - 3.0])
    assert antisymmetric == pytest.approx([-G + 2.0, -G - 2.0])


def test_gyros_see_the_slope_rate_with_opposite_signs() -> None:
    rates = [sense_station(MODEL, side, TIP[side], _steady(), _path(rate=(0.3, 0.0)))[0, 3:] for side in Side]
    assert rates[0] == pytest.approx([1.4 * 0.3, 0.5 * 0.3, 0.0])
    assert rates[1] == pytest.approx([-1.4 * 0.3, 0.5 * 0.3, 0.0])


def test_rolling_pulls_both_tips_inward_and_roll_acceleration_lifts_one() -> None:
    # a tip on a circle accelerates toward the axis: the left one to +y, the right one to -y, p^2 * 1 m
    left, right = (sense_station(MODEL, side, TIP[side], _steady(rate=(2.0, 0, 0)), _path())[0, 1] for side in Side)
    assert (left, right) == pytest.approx((4.0, -4.0))
    # roll acceleration to the right: the right tip goes down (+z), the left up
    left, right = (sense_station(MODEL, side, TIP[side], _steady(spin=(5.0, 0, 0)), _path())[0, 2] for side in Side)
    assert (left, right) == pytest.approx((-G - 5.0, -G + 5.0))


def test_lever_arms_are_the_acceleration_of_a_point_carried_by_a_turning_body() -> None:
    # body turning about a fixed axis at w(t) = w0 + w1 t: differentiate the point's path numerically
    axis, place = np.array([0.6, -0.48, 0.64]), np.array([0.3, 1.0, -0.2])
    w0, w1, h = 0.8, 1.7, 1e-4
    inertial = [Rotation.from_rotvec(axis * (w0 * t + 0.5 * w1 * t**2)).apply(place) for t in (-h, 0.0, h)]
    acceleration = (inertial[0] - 2 * inertial[1] + inertial[2]) / h**2
    motion = RigidMotion(np.zeros((1, 3)), (axis * w0)[None], (axis * w1)[None])
    assert lever_arm_mps2(motion, place)[0] == pytest.approx(acceleration, abs=1e-6)


def test_removing_the_rigid_motion_leaves_the_wings_own() -> None:
    motion = _steady((1.0, -2.0, -12.0), (0.5, -0.4, 0.3), (2.0, 1.0, -1.0))
    raw = sense_station(MODEL, Side.LEFT, TIP[Side.LEFT], motion, _path(accel=(3.0, 1.0)))
    assert remove_rigid_motion(raw, motion, TIP[Side.LEFT])[0] == pytest.approx([0, 0, -2.0, 0, 0, 0], abs=1e-12)


def test_the_sensor_is_turned_by_the_whole_rotation_vector() -> None:
    motion = _steady((1.0, -2.0, -12.0), (0.5, -0.4, 0.3))
    q = np.array([0.2, 0.1])  # far beyond a small angle
    seen = sense_station(MODEL, Side.RIGHT, np.zeros(3), motion, _path((0.2, 0.1)))[0]
    phi = np.array([-(1.4 * q[0] + 1.6 * q[1]), 0.5 * q[0] - 0.3 * q[1], 0.0])
    body_from_sensor = Rotation.from_rotvec(phi)
    assert body_from_sensor.apply(seen[:3]) == pytest.approx(motion.specific_force_mps2[0])
    assert body_from_sensor.apply(seen[3:]) == pytest.approx(motion.rate_radps[0])


bounded = st.floats(-1.0, 1.0)


@settings(deadline=None, max_examples=60)
@given(
    side=st.sampled_from(list(Side)),
    centre=st.tuples(bounded, bounded),
    step=st.tuples(bounded, bounded),
    rate=st.tuples(bounded, bounded),
    accel=st.tuples(bounded, bounded),
    turn=st.tuples(bounded, bounded, bounded),
)
def test_rows_are_the_derivative_of_the_exact_model(
    side: Side,
    centre: tuple[float, float],
    step: tuple[float, float],
    rate: tuple[float, float],
    accel: tuple[float, float],
    turn: tuple[float, float, float],
) -> None:
    motion = _steady((0.5, 0.3, -12.0), turn, (turn[2], turn[0], turn[1]))
    at = 0.015 * np.array(centre)
    rows = sensing_rows(MODEL, side, TIP[side], motion, at)
    for scale in (1e-4,):
        dq, v, a = scale * np.array(step), scale * np.array(rate), scale * np.array(accel)
        exact = sense_station(MODEL, side, TIP[side], motion, ModalPath((at + dq)[None], v[None], a[None]))[0]
        linear = rows.offset + rows.per_q @ dq + rows.per_qdot @ v + rows.per_qddot @ a
        # what a small rotation leaves: about half of angle change times base angle, times 12 m/s^2
        assert exact == pytest.approx(linear, abs=5e-5)
    still = sense_station(MODEL, side, TIP[side], motion, ModalPath(at[None], NONE, NONE))[0]
    assert rows.offset == pytest.approx(still, abs=1e-12)


def test_in_state_form_substitutes_the_modal_equation() -> None:
    motion = _steady((0.0, 0.0, -1.5 * G), (0.3, 0.1, 0.0))
    at = MODEL.q_static(1.5)
    rows = sensing_rows(MODEL, Side.LEFT, TIP[Side.LEFT], motion, at)
    constant, c, d = rows.in_state(MODEL, 1.5)
    q, rate, load = at + np.array([0.002, -0.001]), np.array([0.1, 0.05]), np.array([2.0, -1.0])
    accel = MODEL.acceleration(0.0, q, rate, load, 1.5)
    direct = rows.offset + rows.per_q @ (q - at) + rows.per_qdot @ rate + rows.per_qddot @ accel
    assert constant + c @ np.concatenate([q, rate]) + d @ load == pytest.approx(direct)


def test_a_resting_accelerometer_feels_gust_load_as_it_feels_the_spring() -> None:
    # held at rest by a gust load equal to the spring force it reads gravity alone
    at = MODEL.q_static(1.0)
    rows = sensing_rows(MODEL, Side.RIGHT, TIP[Side.RIGHT], _steady(), at)
    constant, c, d = rows.in_state(MODEL, 1.0)
    q = at + np.array([0.004, 0.0])
    held = MODEL.structure.stiffness_radps2 @ (q - at)
    reading = constant + c @ np.concatenate([q, np.zeros(2)]) + d @ held
    assert reading[2] == pytest.approx(-G)
