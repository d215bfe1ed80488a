"""Flights whose path is known in closed form, for tests of images: constant velocity and rates, a harmonic wing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.wing.model import WingModel
from companion.params.airframe import Airframe
from companion.sim.flight.truth import FlightTruth, TipShape

MIDDLE_NS = 1_000_000_000


@dataclass(frozen=True)
class Path:
    """State at 1 s and its constant rates; the wing swings as ``trim + swing sin(2 pi f (t - 1 s))`` metres."""

    altitude_m: float
    north_mps: float = 0.0
    east_m: float = 0.0
    climb_mps: float = 0.0
    roll_rad: float = 0.0
    roll_rate_radps: float = 0.0
    trim_m: float = 0.0
    swing_m: float = 0.0
    swing_hz: float = 5.0


def fly(airframe: Airframe, path: Path, seconds: int = 2) -> FlightTruth:
    """So many seconds of it."""
    t = np.arange(1000 * seconds + 1) * 1e-3 - 1.0
    knots, rates = np.zeros((len(t), 16)), np.zeros((len(t), 16))
    knots[:, 0], rates[:, 0] = path.north_mps * t, path.north_mps
    knots[:, 1] = path.east_m
    knots[:, 2], rates[:, 2] = -path.altitude_m - path.climb_mps * t, -path.climb_mps
    knots[:, 3], knots[:, 5] = path.north_mps, -path.climb_mps
    knots[:, 6], rates[:, 6] = path.roll_rad + path.roll_rate_radps * t, path.roll_rate_radps
    knots[:, 9] = path.roll_rate_radps
    omega = 2 * np.pi * path.swing_hz
    knots[:, 12] = path.trim_m + path.swing_m * np.sin(omega * t)
    rates[:, 12] = path.swing_m * omega * np.cos(omega * t)
    return FlightTruth(knots, rates, TipShape.from_model(WingModel(airframe.wing)))
