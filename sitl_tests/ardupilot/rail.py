"""A simulated flight as ArduPilot's JSON model wants it told: one line of sensor values for every physics frame.

The aircraft is carried along the flight that :mod:`companion.sim` has computed, wing and all; the autopilot's surfaces
and motors do not steer it. It first hangs still at the place where the run-up starts, is then pulled up to the flight's
speed along a straight line, and flies. So every truth of the flight is known beforehand, cameras included.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.records import Floats
from companion.sim.flight.truth import FlightTruth, body_from_ned_matrix
from companion.units import GRAVITY_MPS2

RATE_HZ = 1200
LAUNCH_S = 6.0
_RC = ',"rc":{' + ",".join(f'"rc_{n}":{1000 if n == 3 else 1500}' for n in range(1, 9)) + "}"
_TAIL = _RC + ',"battery":{"voltage":12.6,"current":1},"no_time_sync":1}\n'


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of the autopilot's sensors, at ``n`` frames: NED position and velocity, Euler angles, FRD rates."""

    gyro_radps: Floats
    specific_force_mps2: Floats
    position_ned_m: Floats
    euler_rad: Floats
    velocity_ned_mps: Floats


def flight_motion(truth: FlightTruth, duration_s: float) -> Motion:
    """The flight itself, a frame every 1/1200 s from its boot time 0."""
    t_ns = np.arange(round(duration_s * RATE_HZ), dtype=np.int64) * 1_000_000_000 // RATE_HZ
    states = truth.series(t_ns)
    return Motion(
        states.body_rate_radps,
        states.specific_force_mps2,
        states.position_ned_m,
        states.euler_rad,
        states.velocity_ned_mps,
    )


def launch_motion(truth: FlightTruth) -> Motion:
    """The run-up: from rest to the flight's first velocity within :data:`LAUNCH_S`, the attitude held.

    The speed follows 3u^2 - 2u^3, so that acceleration begins and ends at zero.
    """
    start = truth.at(0)
    count = round(LAUNCH_S * RATE_HZ)
    u = (np.arange(count) / count)[:, None]
    speed_ratio, travelled, push = 3 * u**2 - 2 * u**3, u**3 - u**4 / 2, (6 * u - 6 * u**2) / LAUNCH_S
    velocity = start.velocity_ned_mps
    position = start.position_ned_m + velocity * LAUNCH_S * (travelled - 0.5)
    euler = np.repeat(truth.series(np.zeros(1, dtype=np.int64)).euler_rad, count, axis=0)
    gravity = np.array([0.0, 0.0, GRAVITY_MPS2])
    force = (push * velocity - gravity) @ body_from_ned_matrix(euler[:1])[0].T
    return Motion(np.zeros((count, 3)), force, position, euler, speed_ratio * velocity)


def lines(motion: Motion) -> list[bytes]:
    """Everything of a JSON line but its time stamp."""
    airspeed = np.linalg.norm(motion.velocity_ned_mps, axis=1).tolist()
    rows = zip(
        motion.gyro_radps.tolist(),
        motion.specific_force_mps2.tolist(),
        motion.position_ned_m.tolist(),
        motion.euler_rad.tolist(),
        motion.velocity_ned_mps.tolist(),
        airspeed,
        strict=True,
    )
    return [line_of(*row).encode() for row in rows]


def stamp_of(frame: int, rate_hz: int = RATE_HZ) -> bytes:
    """Begin of a frame's line.

    SIM_JSON adds the difference of two stamps to a clock of whole microseconds and cuts the rest off. The stamps run
    a quarter of a microsecond a frame too fast, so that what is cut off is that quarter and never a whole one.
    """
    clock_us = (frame + 1) * 1_000_000 // rate_hz
    return b'\n{"timestamp":%.8f,' % (1e-6 * (clock_us + 0.25 * (frame + 1)))


def line_of(
    gyro: list[float],
    force: list[float],
    position: list[float],
    euler: list[float],
    velocity: list[float],
    airspeed_mps: float,
) -> str:
    """Line of one frame but its time stamp; lists of three, NED and body FRD."""
    roll, pitch, yaw = euler
    heading = (yaw + math.pi) % (2 * math.pi) - math.pi
    return (
        f'"imu":{{"gyro":{_numbers(gyro)},"accel_body":{_numbers(force)}}},"position":{_numbers(position)},'
        f'"attitude":{_numbers([roll, pitch, heading])},"velocity":{_numbers(velocity)},"airspeed":{airspeed_mps:.4f}'
        + _TAIL
    )


def _numbers(values: list[float]) -> str:
    # six decimals: a microradian per second, a micrometre
    return "[" + ",".join(f"{value:.6f}" for value in values) + "]"
