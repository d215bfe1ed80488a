"""The physics that flies the autopilot, without one: what it says is one motion, in ArduPilot's form and on time."""

from __future__ import annotations

import json
import multiprocessing
import socket
import struct
import time
from array import array

import numpy as np
import pytest

from companion.params.files import load_airframe
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.truth import body_from_ned_matrix
from sitl_tests.ardupilot.physics import (
    CAMERA_CHANNELS,
    CAMERA_OFF_PWM,
    CAMERA_ON_PWM,
    SERVO_HEAD,
    SERVOS_16,
    Frames,
    PhysicsOptions,
    Shutter,
    serve,
    servo_outputs,
)
from sitl_tests.ardupilot.rail import LAUNCH_S, RATE_HZ, Motion, flight_motion, launch_motion
from sitl_tests.ardupilot.vehicle import Ports, keep_pace

GRAVITY = np.array([0.0, 0.0, 9.80665])
FLOWN_S = 3.0


@pytest.fixture(scope="module")
def flight() -> Flight:
    return build_flight(load_airframe("nadir-2m"), 1, FLOWN_S)


def joined(first: Motion, second: Motion) -> Motion:
    names = Motion.__slots__
    return Motion(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))


def test_launch_and_flight_are_one_motion(flight: Flight) -> None:
    """Position is the integral of velocity, velocity of specific force turned into NED plus gravity, over the seam."""
    motion = joined(launch_motion(flight.truth), flight_motion(flight.truth, FLOWN_S))
    step_s = 1.0 / RATE_HZ
    travelled = np.cumsum((motion.velocity_ned_mps[1:] + motion.velocity_ned_mps[:-1]) * 0.5 * step_s, axis=0)
    assert np.abs(motion.position_ned_m[1:] - motion.position_ned_m[0] - travelled).max() < 1e-3
    ned_from_body = np.swapaxes(body_from_ned_matrix(motion.euler_rad), 1, 2)
    acceleration = np.einsum("nij,nj->ni", ned_from_body, motion.specific_force_mps2) + GRAVITY
    gained = np.cumsum((acceleration[1:] + acceleration[:-1]) * 0.5 * step_s, axis=0)
    assert np.abs(motion.velocity_ned_mps[1:] - motion.velocity_ned_mps[0] - gained).max() < 5e-3


def test_it_hangs_still_first_and_feels_one_g(flight: Flight) -> None:
    launch = launch_motion(flight.truth)
    assert not launch.velocity_ned_mps[0].any()
    assert np.linalg.norm(launch.specific_force_mps2[0]) == pytest.approx(9.80665, abs=1e-9)
    run_up_m = np.linalg.norm(launch.position_ned_m[0] - flight.truth.at(0).position_ned_m)
    assert run_up_m == pytest.approx(np.linalg.norm(flight.truth.at(0).velocity_ned_mps) * LAUNCH_S / 2, rel=1e-6)


def test_a_line_is_what_the_json_model_reads(flight: Flight) -> None:
    """The names that SIM_JSON looks for, a line feed before and after, a stamp that grows, angles in rad."""
    frames = Frames(flight, FLOWN_S)
    frames.launch_frame = RATE_HZ
    hanging, flying = frames.line(0), frames.line(round((1.0 + LAUNCH_S + 1.0) * RATE_HZ))
    assert hanging.startswith(b"\n")
    assert hanging.endswith(b"\n")
    at_rest, in_flight = json.loads(hanging), json.loads(flying)
    assert at_rest["velocity"] == [0.0, 0.0, 0.0]
    truth = flight.truth.at(1_000_000_000)
    assert in_flight["imu"]["gyro"] == pytest.approx(truth.body_rate_radps.tolist(), abs=1e-5)
    assert in_flight["imu"]["accel_body"] == pytest.approx(truth.specific_force_mps2.tolist(), abs=1e-5)
    assert in_flight["position"] == pytest.approx(truth.position_ned_m.tolist(), abs=1e-5)
    assert len(in_flight["attitude"]) == 3
    assert in_flight["airspeed"] == pytest.approx(float(np.linalg.norm(truth.velocity_ned_mps)), abs=1e-3)


def test_the_autopilots_clock_of_whole_microseconds_keeps_time(flight: Flight) -> None:
    """SIM_JSON adds differences of stamps to an integer; frame n must end at (n + 1)/1200 s, for minutes."""
    frames, clock_us, last_s = Frames(flight, FLOWN_S), 0, 0.0
    for frame in range(120 * RATE_HZ):
        stamp_s = float(frames.line(frame).split(b":", 1)[1].split(b",", 1)[0])
        clock_us, last_s = int(clock_us + (stamp_s - last_s) * 1e6), stamp_s
        assert clock_us == (frame + 1) * 1_000_000 // RATE_HZ


def packet(pwm: int, frame: int = 0) -> bytes:
    servos = [1500] * 16
    for channel in CAMERA_CHANNELS:
        servos[channel - 1] = pwm
    return SERVO_HEAD.pack(SERVOS_16, RATE_HZ, frame) + struct.pack("<16H", *servos)


def test_only_a_rising_servo_is_a_shot() -> None:
    shutter = Shutter(None, [], {})
    for at, pwm in enumerate((0, CAMERA_OFF_PWM, CAMERA_ON_PWM, CAMERA_ON_PWM, CAMERA_OFF_PWM, CAMERA_ON_PWM)):
        shutter.watch(servo_outputs(packet(pwm)) or (), at)
    assert shutter.edges == [(at, channel) for at in (2, 5) for channel in CAMERA_CHANNELS]
    assert servo_outputs(packet(1500)[:-2]) is None
    assert servo_outputs(b"") is None


@pytest.mark.realtime
def test_frames_come_at_1200_hz_of_the_hosts_clock() -> None:
    """A stand-in for the autopilot asks for four seconds of frames; boot time must not drift from the host's."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    ports = Ports.free()
    options = PhysicsOptions(load_airframe("nadir-2m"), 1, 1.0, ports.physics)
    process = spawn.Process(target=serve, args=(options, theirs), daemon=True)
    process.start()
    try:
        assert ours.poll(60), "the physics does not come up"
        assert ours.recv()[0] == "ready"
        keep_pace(process.pid or 0)
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        link.settimeout(5.0)
        stamps, came_ns = array("d"), array("q")
        for frame in range(4 * RATE_HZ):
            link.sendto(
                packet(CAMERA_ON_PWM if frame == RATE_HZ else CAMERA_OFF_PWM, frame), ("127.0.0.1", ports.physics)
            )
            stamps.append(json.loads(link.recv(4096))["timestamp"])
            came_ns.append(time.monotonic_ns())
        link.close()
        assert ours.poll(5), "the clock was never pinned"
        assert ours.recv()[0] == "started"
        ours.send("stop")
        assert ours.poll(5), "no report"
        kind, report = ours.recv()
    finally:
        process.terminate()
        process.join()
    assert kind == "report"
    assert np.allclose(np.diff(stamps), 1 / RATE_HZ, atol=2e-6)
    late_s = 1e-9 * (np.array(came_ns) - came_ns[0]) - (np.array(stamps) - stamps[0])
    assert late_s.min() > -0.1, "no frame comes before its time"
    # a busy machine may hold frames up, but most tenths of a second last a tenth of a second
    assert np.median(np.diff(late_s[:: RATE_HZ // 10])) == pytest.approx(0.0, abs=0.002)
    assert [channel for _, channel in report["edges"]] == list(CAMERA_CHANNELS)
