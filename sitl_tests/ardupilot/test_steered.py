"""The flexible aeroplane at the JSON seam, steered by a fake ArduPilot that sends servo packets."""

from __future__ import annotations

import json
import math
import socket
import struct
from typing import Any

import numpy as np
import pytest

from companion.params.files import load_airframe
from companion.sim.landing.airplane import Airplane
from companion.sim.landing.trim import trimmed
from sitl_tests.ardupilot.physics import SERVO_HEAD, SERVOS_16, Physics, PhysicsOptions
from sitl_tests.ardupilot.rail import RATE_HZ
from sitl_tests.ardupilot.steered import SteeredFrames, controls_of
from sitl_tests.ardupilot.vehicle import Ports

AIRFRAME = load_airframe("nadir-2m")


def servos(aileron: float = 0.0, elevator: float = 0.0, throttle: float = 0.0, rudder: float = 0.0) -> tuple[int, ...]:
    """Sixteen outputs, us, for deflections of -1 to 1."""
    middle = [round(1500 + 500 * value) for value in (aileron, elevator)]
    return (*middle, round(1000 + 1000 * throttle), round(1500 + 500 * rudder), *[0] * 12)


def flown(frames: SteeredFrames, outputs: tuple[int, ...], count: int) -> list[Any]:
    frames.steer(outputs)
    return [json.loads(frames.line(number)) for number in range(count)]


def aloft() -> SteeredFrames:
    trim = trimmed(Airplane.of_airframe(AIRFRAME), 20.0)
    return SteeredFrames(AIRFRAME, tuple(trim.state(100.0)))


def test_servo_outputs_are_deflections() -> None:
    middle = controls_of(servos())
    assert (middle.aileron_rad, middle.elevator_rad, middle.rudder_rad, middle.throttle) == (0.0, 0.0, 0.0, 0.0)
    full = controls_of(servos(1.0, 1.0, 1.0, 1.0))
    assert full.aileron_rad > 0.0 > full.elevator_rad
    assert full.throttle == 1.0
    assert controls_of((0,) * 16) == middle, "outputs that are off leave everything in the middle"


@pytest.mark.parametrize(
    ("outputs", "name", "axis"),
    [(servos(aileron=0.4, throttle=0.5), "gyro", 0), (servos(elevator=0.4, throttle=0.5), "gyro", 1),
     (servos(rudder=0.6, throttle=0.5), "gyro", 2)],
)  # fmt: skip
def test_a_larger_output_rolls_right_pitches_up_and_yaws_right(outputs: tuple[int, ...], name: str, axis: int) -> None:
    rows = flown(aloft(), outputs, round(0.3 * RATE_HZ))
    assert rows[-1]["imu"][name][axis] > 0.05


def test_what_it_says_is_one_motion() -> None:
    """Position is the integral of velocity; velocity that of the specific force turned into NED, plus gravity."""
    rows = flown(aloft(), servos(0.2, 0.1, 0.6), RATE_HZ)
    position, velocity, euler = (np.array([row[name] for row in rows]) for name in ("position", "velocity", "attitude"))
    force = np.array([row["imu"]["accel_body"] for row in rows])
    step_s = 1.0 / RATE_HZ
    travelled = np.cumsum(0.5 * step_s * (velocity[1:] + velocity[:-1]), axis=0)
    assert np.abs(position[1:] - position[0] - travelled).max() < 1e-3
    roll, pitch, yaw = euler.T
    forward = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)], 1)
    down_body = np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], 1)
    sink_change = np.einsum("ni,ni->n", force, down_body) + 9.80665
    gained = np.cumsum(0.5 * step_s * (sink_change[1:] + sink_change[:-1]))
    assert np.abs(velocity[1:, 2] - velocity[0, 2] - gained).max() < 5e-3
    assert np.linalg.norm(forward, axis=1) == pytest.approx(1.0)


@pytest.mark.slow
def test_a_fake_ardupilot_takes_off_over_udp() -> None:
    """It stands on its wheels at 1 g, runs with full throttle, lifts off when the elevator asks, and is told so."""
    port = Ports.free().physics
    physics = Physics(PhysicsOptions(AIRFRAME, 1, 1.0, port, steered=True))
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.settimeout(5.0)
    rows: list[Any] = []
    try:
        for number in range(round(6.0 * RATE_HZ)):
            climb = rows[-1]["attitude"][1] if rows else 0.0
            moving = bool(rows) and rows[-1]["airspeed"] > 12.0
            wanted = servos(elevator=3.0 * (0.12 - climb) if moving else 0.0, throttle=1.0 if number > 600 else 0.0)
            outputs = [min(max(value, 1000), 2000) if value else 0 for value in wanted]
            packet = SERVO_HEAD.pack(SERVOS_16, RATE_HZ, number) + struct.pack("<16H", *outputs)
            link.sendto(packet, ("127.0.0.1", port))
            physics.turn()
            rows.append(json.loads(link.recv(4096)))
    finally:
        link.close()
        physics.close()
    standing = rows[590]
    assert math.hypot(*standing["imu"]["accel_body"]) == pytest.approx(9.80665, rel=0.02)
    assert standing["airspeed"] < 0.2
    assert np.allclose(np.diff([row["timestamp"] for row in rows]), 1 / RATE_HZ, atol=2e-6)
    heights_m = [-row["position"][2] for row in rows]
    assert min(heights_m) > 0.15
    assert heights_m[-1] > 0.6
    assert rows[-1]["velocity"][2] < -0.3, "it climbs"
