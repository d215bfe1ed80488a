"""Forces and moments of air and propeller on the rigid aeroplane, in body axes FRD.

With dynamic pressure ``Q = rho V^2 / 2`` a force is ``Q S C`` and a moment ``Q S b C`` (roll, yaw) or ``Q S c C``
(pitch); angular rates enter as ``p b / 2V`` and ``q c / 2V``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.sim.landing.airplane import AIR_DENSITY_KGPM3, Airplane

_LEAST_SPEED_MPS = 1.0  # below it the angles of the flow mean nothing: the aeroplane stands (choice)


class Controls(NamedTuple):
    """Deflections: elevator down, right aileron up (rolls right) and rudder right yaw (+) positive; throttle 0 to 1.

    Positive elevator pitches down, positive aileron rolls right, positive rudder yaws left, as the derivatives' signs.
    """

    elevator_rad: float
    aileron_rad: float
    rudder_rad: float
    throttle: float


class AirLoads(NamedTuple):
    """Loads by the air: body force N, body moment N m, and the parts that bend the wing.

    ``up_n`` is the aerodynamic force along -z, ``roll_n_m`` the rolling moment.
    """

    force_n: tuple[float, float, float]
    moment_nm: tuple[float, float, float]
    up_n: float
    roll_nm: float


class AirLoadModel:
    """Aerodynamics of one aeroplane."""

    def __init__(self, plane: Airplane) -> None:
        self._plane = plane
        self._long = plane.longitudinal
        self._lat = plane.lateral

    def loads(
        self, flow_mps: tuple[float, float, float], rates_radps: tuple[float, float, float], controls: Controls
    ) -> AirLoads:
        """Loads for the velocity through the air and the rates against it, both in body axes."""
        plane = self._plane
        u, v, w = flow_mps
        speed = math.sqrt(u * u + v * v + w * w)
        thrust_n = max(plane.thrust_n - plane.thrust_per_mps * speed, 0.0) * controls.throttle
        if speed < _LEAST_SPEED_MPS:
            return AirLoads((thrust_n, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
        pressure = 0.5 * AIR_DENSITY_KGPM3 * speed * speed * plane.area_m2
        x, z, pitch = self._in_plane(u, w, speed, rates_radps[1], controls.elevator_rad)
        y, roll, yaw = self._across(v / speed, rates_radps, speed, controls)
        moment = (pressure * plane.span_m * roll, pressure * plane.chord_m * pitch, pressure * plane.span_m * yaw)
        force = (thrust_n + pressure * x, pressure * y, pressure * z)
        return AirLoads(force, moment, -pressure * z, moment[0])

    def _in_plane(self, u: float, w: float, speed: float, q: float, elevator: float) -> tuple[float, float, float]:
        """Coefficients along x and z, and of the pitching moment."""
        c = self._long
        low, high = self._plane.alpha_limits_rad
        angle = math.atan2(w, u)
        alpha = min(max(angle, low), high)
        q_hat = q * self._plane.chord_m / (2.0 * speed)
        lift = c.lift_zero + c.lift_alpha * alpha + c.lift_pitch_rate * q_hat + c.lift_elevator * elevator
        drag = c.drag_zero + c.drag_lift_square * lift * lift
        moment = c.moment_zero + c.moment_alpha * angle + c.moment_pitch_rate * q_hat + c.moment_elevator * elevator
        cos, sin = math.cos(angle), math.sin(angle)
        return lift * sin - drag * cos, -lift * cos - drag * sin, moment

    def _across(
        self, beta_sine: float, rates: tuple[float, float, float], speed: float, controls: Controls
    ) -> tuple[float, float, float]:
        """Coefficients along y and of the rolling and yawing moment."""
        c = self._lat
        half = self._plane.span_m / (2.0 * speed)
        beta, p_hat, r_hat = math.asin(beta_sine), rates[0] * half, rates[2] * half
        aileron, rudder = controls.aileron_rad, controls.rudder_rad
        side = c.side_beta * beta + c.side_rudder * rudder
        roll = c.roll_beta * beta + c.roll_roll_rate * p_hat + c.roll_yaw_rate * r_hat + c.roll_aileron * aileron
        yaw = c.yaw_beta * beta + c.yaw_roll_rate * p_hat + c.yaw_yaw_rate * r_hat
        return side, roll, yaw + c.yaw_aileron * aileron + c.yaw_rudder * rudder
