"""The flexible aeroplane in six degrees of freedom, advanced step by step: rigid body, servos, wheels and wing.

Rigid motion is integrated by the classical Runge-Kutta method over each step. Lift bends the wing: the modes of
:class:`companion.sim.flight.wing.WingStepper` are driven by the lift factor (lift over weight) and by the rolling
moment of the air, taken at the middle of the step. What bending does to the lift is left out: a wing of 5 Hz follows
gusts and manoeuvres below 1 Hz within a twentieth of its static bend. NED axes, flat ground at z = 0, body FRD.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.core.wing.model import WingModel
from companion.records import Floats
from companion.sim.flight.wing import WingStepper
from companion.sim.landing.aerodynamics import AirLoadModel, AirLoads, Controls
from companion.sim.landing.airplane import Airplane
from companion.sim.landing.gear import LandingGear, Matrix, Vector
from companion.sim.landing.turbulence import STILL_AIR, AirMotion
from companion.units import GRAVITY_MPS2

STEP_NS = 2_000_000
"""Length of a step: 500 Hz, eighteen steps in a period of a 27 Hz mode (choice)."""

_HALF_WING_ARM = 0.42  # of the semispan: where half an elliptic lift acts (4 / 3 pi; derived)
_PARTICIPATION = 1.566  # of a uniform cantilever's first bending mode in a shaken root (derived)
_RIGID = 12  # position, velocity, Euler angles, rates (by definition)
_CONTROLS = slice(12, 16)


class BodyState(NamedTuple):
    """Rigid motion at an instant: NED position and velocity, roll pitch yaw, FRD rates, and what moves them.

    ``specific_force_mps2`` is that of the body origin, ``lift_factor`` aerodynamic lift over weight and
    ``wheels_n`` the weight on the wheels.
    """

    position_ned_m: Vector
    velocity_ned_mps: Vector
    euler_rad: Vector
    rates_radps: Vector
    specific_force_mps2: Vector
    lift_factor: float
    wheels_n: float


class _Loads(NamedTuple):
    """Loads that bend the wing, in multiples of the weight, and the upward blow that the wheels pass on, m/s^2."""

    lift_factor: float
    roll_factor: float
    blow_mps2: float
    wheels_n: float


class FlexibleAircraft:
    """Advances the aeroplane; the state is readable between steps.

    ``model`` is the true wing, which starts at rest under 1 g. ``start`` has 16 numbers: NED position and velocity,
    roll pitch yaw, rates, then elevator, aileron, rudder and throttle (:mod:`companion.sim.landing.trim` makes one).
    """

    def __init__(self, plane: Airplane, model: WingModel, start: list[float], step_ns: int = STEP_NS) -> None:
        self.plane = plane
        self.step_ns = step_ns
        self.state = list(start)
        self.wing = WingStepper(model, 1.0, step_ns * 1e-9)
        self._air = AirLoadModel(plane)
        self._gear = LandingGear(plane)
        self._weight_n = plane.mass_kg * GRAVITY_MPS2
        slots = np.array(model.structure.slots)
        stiffness = np.diag(model.structure.stiffness_radps2)
        per_g_mps2 = float(stiffness[slots == 0].sum() * model.structure.static_per_g_m[slots == 0].sum())
        # per unit of (difference of the half wings' lift over weight): the first antisymmetric mode has the mass of
        # the symmetric one
        self._roll_load_mps2 = np.where(slots == 1, per_g_mps2, 0.0)
        self._blow_gain = np.where(slots == 0, -_PARTICIPATION, 0.0)

    def step(self, commands: Controls, before: AirMotion = STILL_AIR, after: AirMotion = STILL_AIR) -> None:
        """Advance one step with commands held; the gust goes straight from ``before`` to ``after``."""
        h, x = self.step_ns * 1e-9, self.state
        middle = before.between(after)
        k1, _ = self.derivative(x, commands, before)
        k2, _ = self.derivative(_moved(x, k1, 0.5 * h), commands, middle)
        k3, loads = self.derivative(_moved(x, k2, 0.5 * h), commands, middle)
        k4, _ = self.derivative(_moved(x, k3, h), commands, after)
        self.state = [
            value + h / 6.0 * (a + 2.0 * (b + c) + d) for value, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True)
        ]
        load = loads.roll_factor * self._roll_load_mps2 + loads.blow_mps2 * self._blow_gain
        self.wing.step(load, loads.lift_factor)

    def knot(self, commands: Controls, gust: AirMotion = STILL_AIR) -> tuple[Floats, Floats]:
        """Row of a :class:`companion.sim.flight.truth.FlightTruth` and its derivative, (12 + s,) each."""
        derivative, _ = self.derivative(self.state, commands, gust)
        model = self.wing.model
        modal, rate = model.all_slots(self.wing.q_m), model.all_slots(self.wing.qdot_mps)
        return np.concatenate([self.state[:_RIGID], modal]), np.concatenate([derivative[:_RIGID], rate])

    def body(self, commands: Controls, gust: AirMotion = STILL_AIR) -> BodyState:
        """The rigid motion now."""
        x = self.state
        derivative, loads = self.derivative(x, commands, gust)
        acceleration = (derivative[3], derivative[4], derivative[5] - GRAVITY_MPS2)
        force = _times(body_from_ned(x[6], x[7], x[8]), acceleration)
        position, velocity, euler, rates = ((x[i], x[i + 1], x[i + 2]) for i in (0, 3, 6, 9))
        return BodyState(position, velocity, euler, rates, force, loads.lift_factor, loads.wheels_n)

    def derivative(self, x: list[float], commands: Controls, gust: AirMotion) -> tuple[list[float], _Loads]:
        """Right-hand side for a state of 16, and what bends the wing meanwhile."""
        roll, pitch, yaw, p, q, r = x[6:12]
        turn = body_from_ned(roll, pitch, yaw)
        ground = _times(turn, (x[3], x[4], x[5]))
        flow = (ground[0] - gust.u_mps, ground[1] - gust.v_mps, ground[2] - gust.w_mps)
        air = self._air.loads(flow, (p - gust.p_radps, q, r), Controls(*x[_CONTROLS]))
        wheels = self._gear.loads(-x[2], turn, ground, (p, q, r))
        mass = self.plane.mass_kg
        push = [(a + b) / mass for a, b in zip(air.force_n, wheels.force_n, strict=True)]
        ax, ay, az = (turn[0][i] * push[0] + turn[1][i] * push[1] + turn[2][i] * push[2] for i in range(3))
        moment = [a + b for a, b in zip(air.moment_nm, wheels.moment_nm, strict=True)]
        rates = _angular_acceleration(self.plane.inertia_kgm2, (p, q, r), moment)
        angles = _euler_rates(roll, pitch, (p, q, r))
        servos = self._servo_rates(x, commands)
        return [x[3], x[4], x[5], ax, ay, az + GRAVITY_MPS2, *angles, *rates, *servos], self._bending(air, wheels.up_n)

    def _bending(self, air: AirLoads, wheels_n: float) -> _Loads:
        """Lift and roll in multiples of the weight; wheels that carry what lift does not bend nothing, bumps do."""
        lift = air.up_n / self._weight_n
        arm_m = _HALF_WING_ARM * 0.5 * self.plane.span_m
        blow_n = wheels_n - min(wheels_n, max(1.0 - lift, 0.0) * self._weight_n)
        # rolling right lifts the left half more: antisymmetric q > 0 is the right tip up
        roll = -air.roll_nm / (arm_m * self._weight_n)
        return _Loads(lift, roll, blow_n / self.plane.mass_kg, wheels_n)

    def _servo_rates(self, x: list[float], commands: Controls) -> list[float]:
        plane = self.plane
        surfaces = [(wanted - now) / plane.servo_time_s for wanted, now in zip(commands[:3], x[12:15], strict=True)]
        return [*surfaces, (commands.throttle - x[15]) / plane.motor_time_s]


def body_from_ned(roll: float, pitch: float, yaw: float) -> Matrix:
    """Rotation of the 3-2-1 sequence, rows in body axes."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return (
        (cp * cy, cp * sy, -sp),
        (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    )


def _times(matrix: Matrix, vector: Vector) -> Vector:
    x, y, z = vector
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _euler_rates(roll: float, pitch: float, rates: Vector) -> Vector:
    p, q, r = rates
    cos, sin = math.cos(roll), math.sin(roll)
    turn = (q * sin + r * cos) / math.cos(pitch)
    return p + turn * math.sin(pitch), q * cos - r * sin, turn


def _angular_acceleration(inertia: Vector, rates: Vector, moment: list[float]) -> Vector:
    """Euler's equations about principal axes."""
    (ix, iy, iz), (p, q, r) = inertia, rates
    return (
        (moment[0] + (iy - iz) * q * r) / ix,
        (moment[1] + (iz - ix) * r * p) / iy,
        (moment[2] + (ix - iy) * p * q) / iz,
    )


def _moved(x: list[float], rate: list[float], step_s: float) -> list[float]:
    return [value + step_s * change for value, change in zip(x, rate, strict=True)]
