"""Steady straight flight: the angle of attack, elevator and throttle at which nothing accelerates or turns."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.errors import ConfigError
from companion.records import Floats
from companion.sim.landing.aerodynamics import AirLoadModel, Controls
from companion.sim.landing.airplane import Airplane
from companion.units import GRAVITY_MPS2

_ITERATIONS = 30  # Newton's; five are enough (numerical)
_TOLERANCE = 1e-10  # of force over weight and moment over weight times chord (numerical)
_NUDGE = 1e-6  # of each unknown, for the Jacobian (numerical)


class Trim(NamedTuple):
    """Steady flight at an airspeed and climb angle."""

    airspeed_mps: float
    climb_rad: float
    alpha_rad: float
    controls: Controls

    def state(self, height_m: float, north_m: float = 0.0) -> list[float]:
        """Sixteen numbers of :class:`companion.sim.landing.flexible_aircraft.FlexibleAircraft`, heading north."""
        cos, sin = math.cos(self.climb_rad), math.sin(self.climb_rad)
        velocity = (self.airspeed_mps * cos, 0.0, -self.airspeed_mps * sin)
        attitude, rates = (0.0, self.climb_rad + self.alpha_rad, 0.0), (0.0, 0.0, 0.0)
        return [north_m, 0.0, -height_m, *velocity, *attitude, *rates, *self.controls]


def trimmed(plane: Airplane, airspeed_mps: float, climb_rad: float = 0.0) -> Trim:
    """Solve for steady straight flight by Newton's method.

    Raises
    ------
    ConfigError
        The aeroplane cannot fly so: the lift or the thrust that it takes is beyond it.
    """
    model = AirLoadModel(plane)
    unknowns = np.array([0.05, 0.0, 0.3])
    for _ in range(_ITERATIONS):
        residual = _residual(model, plane, airspeed_mps, climb_rad, unknowns)
        if float(np.abs(residual).max()) < _TOLERANCE:
            break
        columns = [_residual(model, plane, airspeed_mps, climb_rad, unknowns + row) for row in _NUDGE * np.eye(3)]
        unknowns = unknowns - np.linalg.solve((np.stack(columns, 1) - residual[:, None]) / _NUDGE, residual)
    alpha, elevator, throttle = unknowns.tolist()
    low, high = plane.alpha_limits_rad
    if not (low < alpha < high and 0.0 <= throttle <= 1.0):
        raise ConfigError(f"the aeroplane cannot fly steadily at {airspeed_mps:g} m/s, climbing {climb_rad:.3f} rad")
    return Trim(airspeed_mps, climb_rad, alpha, Controls(elevator, 0.0, 0.0, throttle))


def _residual(model: AirLoadModel, plane: Airplane, airspeed_mps: float, climb_rad: float, unknowns: Floats) -> Floats:
    """Force along x and z over weight and pitching moment over weight times chord, (3,)."""
    alpha, elevator, throttle = unknowns.tolist()
    flow = (airspeed_mps * math.cos(alpha), 0.0, airspeed_mps * math.sin(alpha))
    loads = model.loads(flow, (0.0, 0.0, 0.0), Controls(elevator, 0.0, 0.0, throttle))
    weight_n, pitch = plane.mass_kg * GRAVITY_MPS2, climb_rad + alpha
    x = loads.force_n[0] / weight_n - math.sin(pitch)
    z = loads.force_n[2] / weight_n + math.cos(pitch)
    return np.array([x, z, loads.moment_nm[1] / (weight_n * plane.chord_m)])
