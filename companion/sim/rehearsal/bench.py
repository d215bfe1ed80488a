"""An aircraft on the bench that a person handles: taps, tilts and plucks at given times, as its sensors tell them.

The autopilot and the nodes are those of a flight; what their sensors feel is written here in closed form: the ground's
push in tilted axes, the rates of the tilt, and the ringing of the tips.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.params.airframe import Airframe
from companion.records import Floats, Station
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.sensors import BACKEND_HZ
from companion.units import GRAVITY_MPS2

_TILT_RAD = math.radians(25.0)  # chosen: the guide asks for some 25 degrees
_RISE_S, _HOLD_S = 2.0, 5.0  # chosen: of a tilt by hand, and how long it is held
_TAP_MPS2 = 8.0  # chosen: a fingernail's tap, well above what the guide asks for
_CROSSING = 0.15  # part of a tap that the wing passes on (choice)
_FADE_S = 0.12  # chosen: of a tap's ringing: gone before the guide has listened
_PLUCK_MPS2 = 4.0  # chosen: a hand's pluck, far above a node's noise
_NOISE = np.array([0.03, 0.03, 0.03, 0.002, 0.002, 0.002])  # chosen: m/s^2 and rad/s, a node's


class Gesture(enum.Enum):
    """Motion of one handling."""

    TAP_LEFT = "tap the left tip"
    TAP_RIGHT = "tap the right tip"
    RIGHT_WING_DOWN = "right wing down"
    NOSE_UP = "nose up"
    PLUCK_BOTH = "pluck both tips"
    PLUCK_ACROSS = "pluck the tips against each other"


@dataclass(frozen=True, slots=True)
class Handling:
    """One motion of the hand, and when it begins."""

    motion: Gesture
    at_s: float


@dataclass(frozen=True, slots=True)
class Miswiring:
    """Faults of a new aircraft: nodes exchanged, columns of the samples with the wrong sign."""

    exchanged: bool = False
    turned: tuple[tuple[Station, int], ...] = ()


def bench_flight(
    airframe: Airframe, seed: int, duration_s: float, script: Sequence[Handling], miswiring: Miswiring | None = None
) -> Flight:
    """Build what a :class:`~companion.sim.vehicle.world.World` plays: a flight whose sensors lie on a bench."""
    flight = build_flight(airframe, seed, duration_s)
    rng, fault = flight.generator("bench"), miswiring or Miswiring()
    nodes = {}
    for station, stream in flight.nodes.items():
        felt = felt_at(airframe, fault, station, np.asarray(stream.sent_boot_ns * 1e-9, np.float64), script)
        nodes[station] = dataclasses.replace(stream, values=felt + _NOISE * rng.standard_normal(felt.shape))
    backends = {}
    for station, imu in flight.backends.items():
        felt = felt_at(airframe, fault, station, np.arange(len(imu.raw)) / BACKEND_HZ, script)
        backends[station] = dataclasses.replace(imu, raw=felt + _NOISE * rng.standard_normal(felt.shape))
    return dataclasses.replace(flight, nodes=nodes, backends=backends)


def felt_at(airframe: Airframe, fault: Miswiring, station: Station, t_s: Floats, script: Sequence[Handling]) -> Floats:
    """Readings (n, 6) of a station at instants (n,), body axes, m/s^2 and rad/s."""
    felt = tilted(t_s, script)
    felt[:, 2] += tip_response(airframe, _place(station, fault), t_s, script)
    for wrong, column in fault.turned:
        if wrong is station:
            felt[:, column] *= -1.0
    return felt


def _place(station: Station, fault: Miswiring) -> Station:
    """Where a node sits that says to be this one."""
    others = {Station.LEFT: Station.RIGHT, Station.RIGHT: Station.LEFT}
    return others.get(station, station) if fault.exchanged else station


def tilted(t_s: Floats, script: Sequence[Handling]) -> Floats:
    """Readings (n, 6) of a rigid aircraft: roll phi, then pitch theta, one at a time."""
    roll, roll_rate = _angle(t_s, script, Gesture.RIGHT_WING_DOWN)
    pitch, pitch_rate = _angle(t_s, script, Gesture.NOSE_UP)
    g = GRAVITY_MPS2
    force = (g * np.sin(pitch), -g * np.cos(pitch) * np.sin(roll), -g * np.cos(pitch) * np.cos(roll))
    return np.column_stack([*force, roll_rate, pitch_rate * np.cos(roll), -pitch_rate * np.sin(roll)])


def _angle(t_s: Floats, script: Sequence[Handling], motion: Gesture) -> tuple[Floats, Floats]:
    """Angle and its rate: up in two seconds, held, and back."""
    angle, rate = np.zeros_like(t_s), np.zeros_like(t_s)
    for each in script:
        if each.motion is motion:
            for from_s, sign in ((each.at_s, 1.0), (each.at_s + _RISE_S + _HOLD_S, -1.0)):
                u = np.clip((t_s - from_s) / _RISE_S, 0.0, 1.0)
                angle += sign * _TILT_RAD * u * u * (3.0 - 2.0 * u)
                rate += sign * _TILT_RAD * 6.0 * u * (1.0 - u) / _RISE_S
    return angle, rate


def tip_response(airframe: Airframe, place: Station, t_s: Floats, script: Sequence[Handling]) -> Floats:
    """Vertical acceleration (n,) of a tip, m/s^2, down positive: taps fade at once, plucks ring at the wing's modes."""
    wing = airframe.wing
    side = {Station.LEFT: -1.0, Station.RIGHT: 1.0, Station.ROOT: 0.0}[place]
    total = np.zeros_like(t_s)
    for each in script:
        since_s = np.maximum(t_s - each.at_s, 0.0)
        after = t_s >= each.at_s
        if each.motion in (Gesture.TAP_LEFT, Gesture.TAP_RIGHT):
            struck = side == (-1.0 if each.motion is Gesture.TAP_LEFT else 1.0)
            size = _TAP_MPS2 * (1.0 if struck else _CROSSING)
            total += after * size * np.exp(-since_s / _FADE_S) * np.cos(math.tau * 12.0 * since_s)
        elif each.motion in (Gesture.PLUCK_BOTH, Gesture.PLUCK_ACROSS):
            both = each.motion is Gesture.PLUCK_BOTH
            mode = wing.symmetric if both else wing.antisymmetric
            rate = math.tau * mode.frequency_hz.value
            size = _PLUCK_MPS2 * (abs(side) if both else side)
            decay = np.exp(-mode.damping.value * rate * since_s)
            total -= after * size * decay * np.cos(rate * since_s)
    return total
