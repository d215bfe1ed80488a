"""Draws of the worlds beside the wing: attitude and velocity that the autopilot tells, heat at the cameras, stamps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.params.files import load_airframe
from companion.records import Side, VehicleState
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.gust import GustKind
from companion.sim.flight.offline import flight_records
from companion.sim.flight.world_draw import HeatTurn, NavigationError
from companion.sim.flight.worlds import IDEAL
from sitl_tests.loop.test_sim_autopilot import Peer
from sitl_tests.still_plan import still_plan
from tools.bench.world_flight import StruckPair, as_stamped, judged_shots
from tools.bench.world_rows import STRUCK_S


@pytest.fixture(scope="module")
def flight() -> Flight:
    return build_flight(load_airframe("nadir-2m"), 4, plan=still_plan(3.0), gust=GustKind.CALM)


def test_the_autopilots_attitude_is_off_by_what_its_world_says() -> None:
    """The spread of 400 draws is known to 3.5 %: three sigma."""
    drawn = np.array([NavigationError(IDEAL, 1.0, np.random.default_rng(k)).euler_rad for k in range(400)])
    assert drawn.std(axis=0) == pytest.approx([IDEAL.level_rad, IDEAL.level_rad, IDEAL.heading_rad], rel=0.11)


@pytest.mark.parametrize("passed_s", [0.2, 1.0, 10.0])
def test_the_autopilots_velocity_error_changes_as_a_gauss_markov_process(passed_s: float) -> None:
    """Between two fixes as between distant ones: variance ``2 s^2 (1 - exp(-t/T))``, T of 10 s."""
    t_s = np.array([3.0, 3.0 + passed_s])
    drawn = [NavigationError(IDEAL, 20.0, np.random.default_rng(k)).ned_mps(t_s) for k in range(300)]
    changed_mps = np.array([after - before for before, after in drawn])
    sigma_mps = IDEAL.velocity_mps * np.sqrt(2.0 * (1.0 - np.exp(-passed_s / 10.0)))
    assert np.std(changed_mps, axis=0) == pytest.approx(np.full(3, sigma_mps), rel=0.13)


def test_all_attitudes_of_a_flight_are_off_by_the_same(flight: Flight) -> None:
    """In the records of a flight without sockets, and on the link."""
    off_rad = flight.navigation_error().euler_rad
    assert np.abs(off_rad).min() > 1e-4
    states = [record for record in flight_records(flight) if isinstance(record, VehicleState)]
    truth = flight.truth.series(np.array([100_000_000 * (k + 1) for k in range(len(states))], dtype=np.int64))
    reported_rad = np.array([[state.roll_rad, state.pitch_rad, state.yaw_rad] for state in states])
    assert np.allclose(reported_rad - truth.euler_rad, off_rad, atol=1e-9)
    peer = Peer(flight)
    peer.run(1.0)
    for _, message in peer.of("ATTITUDE"):
        (euler_rad,) = flight.truth.series(np.array([message.time_boot_ms * 1_000_000], dtype=np.int64)).euler_rad
        assert np.allclose([message.roll, message.pitch, message.yaw], euler_rad + off_rad, atol=1e-4)


def test_heat_turns_the_cameras_from_the_start_on_as_the_filter_believes() -> None:
    """Change of an Ornstein-Uhlenbeck path: the variance ``2 s^2 (1 - exp(-t/T))``, a walk of 1e-5 rad/rts a pair."""
    t_s = 100.0
    drawn = [HeatTurn(IDEAL, t_s, np.random.default_rng(k)) for k in range(300)]
    assert all(np.array_equal(heat.rotation_rad(0.0), np.zeros((2, 3))) for heat in drawn)
    turned = np.array([heat.rotation_rad(t_s) for heat in drawn])
    sigma_rad = IDEAL.heat_rad * np.sqrt(2.0 * (1.0 - np.exp(-t_s / IDEAL.heat_s)))
    assert np.std(turned, axis=0) == pytest.approx(np.full((2, 3), sigma_rad), rel=0.13)
    walk = IDEAL.heat_rad * np.sqrt(4.0 / IDEAL.heat_s)
    assert walk == pytest.approx(1e-5, rel=0.03)


def test_the_struck_pair_turns_by_heat_and_by_the_knock(flight: Flight) -> None:
    pair, actual = StruckPair(flight, 0.002), flight.real.actual.right_camera
    assert actual is not None
    start, before, after = (pair.at(round(1e9 * t_s)) for t_s in (0.0, 2.0, STRUCK_S))
    assert np.array_equal(start.rig.right.rest.camera_from_body, pair.rig.right.rest.camera_from_body)
    heat = flight.heat_turn().rotation_rad(2.0)[Side.RIGHT]
    for moved, size_rad in ((before, np.linalg.norm(heat)), (after, 0.002)):
        turn = moved.rig.right.rest.camera_from_body @ pair.rig.right.rest.camera_from_body.T
        assert np.arccos((np.trace(turn) - 1.0) / 2.0) == pytest.approx(size_rad, rel=0.05, abs=2e-5)


def test_stamps_are_as_wrong_as_the_airframe_file_states() -> None:
    """The shots themselves keep the true instants, by which they are judged."""
    airframe = load_airframe("nadir-2m")
    assert airframe.right_camera is not None
    careless = dataclasses.replace(
        airframe, right_camera=dataclasses.replace(airframe.right_camera, stamp_sigma_s=4e-4)
    )
    flight = build_flight(careless, 4, plan=still_plan(3.0), gust=GustKind.CALM)
    shots = list(judged_shots(flight, StruckPair(flight, 0.0)))
    rng_ns = [
        as_stamped(dataclasses.replace(shots[0], pair_id=k), flight).mid_exposure_ns - shots[0].mid_exposure_ns
        for k in range(400)
    ]
    assert np.std(rng_ns, axis=0) == pytest.approx([1e5, 4e5], rel=0.11)
