"""Ground contact: wheels on springs and dampers over the level ground at z = 0 of NED."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.sim.landing.airplane import Airplane
from companion.units import GRAVITY_MPS2

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

_SLIP_MPS = 0.3  # speed at which friction reaches its full size: keeps the force smooth through zero (choice)


class GearLoads(NamedTuple):
    """Force and moment in body axes; ``up_n`` is the weight on the wheels."""

    force_n: Vector
    moment_nm: Vector
    up_n: float


_ALOFT = GearLoads((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)


class LandingGear:
    """Springs that carry the weight with a stated sink at rest, dampers, friction along and across the wheels."""

    def __init__(self, plane: Airplane) -> None:
        gear = plane.gear
        wheels = len(gear.places_m)
        weight_n = plane.mass_kg * GRAVITY_MPS2
        self._gear = gear
        self._reach_m = max(math.dist((0.0, 0.0, 0.0), place) for place in gear.places_m)
        self._spring_npm = weight_n / gear.sink_at_rest_m / wheels
        omega = math.sqrt(GRAVITY_MPS2 / gear.sink_at_rest_m)
        self._damper_nspm = 2.0 * gear.damping_ratio * omega * plane.mass_kg / wheels

    def loads(self, height_m: float, body_from_ned: Matrix, flow_mps: Vector, rates_radps: Vector) -> GearLoads:
        """Loads for the origin's height, the attitude, and velocity over ground and rates in body axes."""
        if height_m > self._reach_m:
            return _ALOFT
        down = (body_from_ned[0][2], body_from_ned[1][2], body_from_ned[2][2])
        force, moment, up_n = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.0
        for place in self._gear.places_m:
            sunk_m = _dot(down, place) - height_m
            if sunk_m > 0.0:
                turned = _cross(rates_radps, place)
                velocity = (flow_mps[0] + turned[0], flow_mps[1] + turned[1], flow_mps[2] + turned[2])
                push, carried_n = self._push(sunk_m, velocity, down)
                lever = _cross(place, push)
                up_n += carried_n
                for axis in range(3):
                    force[axis] += push[axis]
                    moment[axis] += lever[axis]
        return GearLoads((force[0], force[1], force[2]), (moment[0], moment[1], moment[2]), up_n)

    def _push(self, sunk_m: float, velocity: Vector, down: Vector) -> tuple[Vector, float]:
        """Force of one wheel in body axes, and its part against gravity."""
        carried_n = max(self._spring_npm * sunk_m + self._damper_nspm * _dot(velocity, down), 0.0)
        along = -self._gear.rolling_friction * carried_n * math.tanh(velocity[0] / _SLIP_MPS)
        across = -self._gear.side_friction * carried_n * math.tanh(velocity[1] / _SLIP_MPS)
        return (along - carried_n * down[0], across - carried_n * down[1], -carried_n * down[2]), carried_n


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
