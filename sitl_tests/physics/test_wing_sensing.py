"""A tip sensor's readings against signed closed forms and against points carried through space by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from companion.core.wing.foreshortening import foreshortening_pm
from companion.core.wing.model import WingModel
from companion.core.wing.sensing import ModalPath, RigidMotion, lever_arm_mps2, sense_station
from companion.params.airframe import Gust, Mode, Uncertain, Wing
from companion.records import Floats, Side

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
    reading = sense_station(MODEL, side, TIP[side], _steady(), _path((0.02, 0.0)))[0]
    assert reading[1] == pytest.approx(-sign * G * math.sin(psi), rel=1e-4)
    assert reading[1] * sign < 0.0


@pytest.mark.parametrize("side", list(Side))
def test_nose_up_twist_shows_gravity_forward(side: Side) -> None:
    # nose up by tau: the sensor's x axis points above the horizon and feels +g sin tau, as a pitched-up aircraft does
    reading = sense_station(MODEL, side, TIP[side], _steady(), _path((0.02, 0.0)))[0]
    assert reading[0] == pytest.approx(G * math.sin(0.5 * 0.02), rel=1e-3)


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


def test_the_sensor_is_turned_by_the_whole_rotation_vector() -> None:
    motion = _steady((1.0, -2.0, -12.0), (0.5, -0.4, 0.3))
    q = np.array([0.2, 0.1])  # far beyond a small angle
    reading = sense_station(MODEL, Side.RIGHT, np.zeros(3), motion, _path((0.2, 0.1)))[0]
    phi = np.array([-(1.4 * q[0] + 1.6 * q[1]), 0.5 * q[0] - 0.3 * q[1], 0.0])
    body_from_sensor = Rotation.from_rotvec(phi)
    omega, lifted = motion.rate_radps[0], np.array([0.0, 0.0, -q.sum()])  # at the root itself nothing moves inboard
    force = motion.specific_force_mps2[0] + np.cross(omega, np.cross(omega, lifted))
    assert body_from_sensor.apply(reading[:3]) == pytest.approx(force)
    assert body_from_sensor.apply(reading[3:]) == pytest.approx(omega)


@pytest.mark.parametrize(("side", "outward"), [(Side.LEFT, -1.0), (Side.RIGHT, 1.0)])
def test_a_bending_tip_in_a_rolling_body_is_a_point_that_moves_through_space(side: Side, outward: float) -> None:
    """Its path, roll and bending together, is differentiated numerically; the tip goes inboard by 1.162 w^2 / 2 L."""
    place, h, p, p_dot = TIP[side], 1e-4, 1.1, 3.0
    q, rate, accel = np.array([0.03, -0.01]), np.array([0.4, 0.25]), np.array([-35.0, 11.0])

    def at(t_s: float) -> tuple[np.ndarray, Rotation]:
        moved = q + rate * t_s + 0.5 * accel * t_s**2
        up = moved[0] + outward * moved[1]
        inboard = 0.5 * 1.16194 * up**2
        roll = Rotation.from_rotvec([p * t_s + 0.5 * p_dot * t_s**2, 0.0, 0.0])
        return roll.apply(place + np.array([0.0, -outward * inboard, -up])), roll

    before, here, after = (at(t_s)[0] for t_s in (-h, 0.0, h))
    acceleration = (before - 2.0 * here + after) / h**2
    gravity = np.array([0.0, 0.0, G])
    motion = _steady((0.0, 0.0, -G), (p, 0.0, 0.0), (p_dot, 0.0, 0.0))
    reading = sense_station(MODEL, side, place, motion, ModalPath(q[None], rate[None], accel[None]))[0]
    lean = outward * -(1.4 * q[0] + outward * 1.6 * q[1])
    twist = 0.5 * q[0] - outward * 0.3 * q[1]
    body_from_sensor = Rotation.from_rotvec([lean, twist, 0.0])
    assert body_from_sensor.apply(reading[:3]) == pytest.approx(acceleration - gravity, abs=1e-4)


def test_a_bent_wing_shortens_by_more_than_a_straight_one_on_a_hinge() -> None:
    """A straight line's tip moves inboard by w^2 / 2 L, and by Schwarz' inequality no bent shape's by less."""
    for lever_m in (0.7, 2.5):
        foreshortening = foreshortening_pm((0, 1, 2), lever_m)
        assert np.all(np.diag(foreshortening) > 1.0 / lever_m)
        assert np.all(np.linalg.eigvalsh(foreshortening) > 0.0)
    # the integrals of phi_i' phi_j' of a uniform cantilever, by another's quadrature
    assert foreshortening_pm((0, 1), 1.0) == pytest.approx(np.array([[1.1619, 1.8450], [1.8450, 8.1043]]), rel=1e-4)
    assert not foreshortening_pm((0, 1), 0.0).any()


def _loaded_cantilever(mass_ratio: float) -> tuple[Floats, Floats]:
    """Slopes (2,) at the tip of a unit cantilever with so much mass there, and integrals (2, 2) of phi_i' phi_j'."""
    y = np.linspace(0.0, 1.0, 20_001)
    slopes = []
    for low, high in ((0.5, 2.0), (3.0, 4.8)):  # of beta l
        x = brentq(
            lambda x: 1 + np.cos(x) * np.cosh(x) + mass_ratio * x * (np.cos(x) * np.sinh(x) - np.sin(x) * np.cosh(x)),
            low,
            high,
        )
        odd = (np.cosh(x) + np.cos(x)) / (np.sinh(x) + np.sin(x))  # no moment at the tip
        tip = np.cosh(x) - np.cos(x) - odd * (np.sinh(x) - np.sin(x))
        slopes.append(x * (np.sinh(x * y) + np.sin(x * y) - odd * (np.cosh(x * y) - np.cos(x * y))) / tip)
    products = np.array([[np.trapezoid(first * second, y) for second in slopes] for first in slopes])
    return np.array([slope[-1] for slope in slopes]), products


@pytest.mark.parametrize("mass_ratio", [0.0, 0.05, 0.1, 0.2])
def test_a_tip_that_carries_mass_moves_inboard_as_its_slope_factors_say(mass_ratio: float) -> None:
    """The product of both modes by a fifth of the wing's mass is a third larger than without."""
    slopes, products = _loaded_cantilever(mass_ratio)
    lever_m = 0.8
    foreshortening = lever_m * foreshortening_pm((0, 1), lever_m, slopes / lever_m)
    assert foreshortening[0] == pytest.approx(products[0], rel=0.025)
    assert foreshortening[1, 1] == pytest.approx(products[1, 1], rel=0.25)
    uniform = lever_m * foreshortening_pm((0, 1), lever_m)
    assert uniform[0, 1] == pytest.approx(products[0, 1] / (1.0 + 1.7 * mass_ratio), rel=0.02)


def test_a_second_mode_pulls_the_tip_inboard_as_its_slope_factor_says() -> None:
    """Beside a static bend of the first mode the second one's acceleration a does so by ``K_12 q_1 a``."""
    slopes, products = _loaded_cantilever(0.1)
    first, second = (
        Mode(Uncertain(f), Uncertain(0.03), Uncertain(s)) for f, s in zip((5.0, 27.0), slopes, strict=True)
    )
    wing = Wing(
        1.0, first, first, Gust(Uncertain(0.005)), Uncertain(0.0), Uncertain(0.015), second, shortening=Uncertain(1.0)
    )
    model = WingModel(wing)
    q, accel = np.zeros((1, model.count)), np.zeros((1, model.count))
    bend_m, accel_mps2 = 0.03, 4.0
    q[0, model.structure.slots.index(0)], accel[0, model.structure.slots.index(2)] = bend_m, accel_mps2
    path = ModalPath(q, np.zeros_like(q), accel)
    reading = sense_station(model, Side.RIGHT, TIP[Side.RIGHT], _steady(), path)[0]
    body_from_sensor = Rotation.from_rotvec([-slopes[0] * bend_m, 0.0, 0.0])
    across = body_from_sensor.apply(reading[:3])[1]
    assert across == pytest.approx(-products[0, 1] * bend_m * accel_mps2, rel=0.025)


bounded = st.floats(-1.0, 1.0)
