"""The aeroplane that lands, against closed forms: trim, phugoid, energy, load factor against bend, gusts, wheels."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from companion.core.wing.model import WingModel
from companion.params.files import load_airframe
from companion.sim.landing.aerodynamics import Controls
from companion.sim.landing.airplane import Airplane
from companion.sim.landing.flexible_aircraft import FlexibleAircraft
from companion.sim.landing.trim import trimmed
from companion.sim.landing.turbulence import AirMotion

G, RHO = 9.80665, 1.225
AIRFRAME = load_airframe("nadir-2m")
PLANE = Airplane.of_airframe(AIRFRAME)
MODEL = WingModel.from_airframe(AIRFRAME)
IDLE = Controls(0.0, 0.0, 0.0, 0.0)


def speed_mps(aircraft: FlexibleAircraft) -> float:
    return math.hypot(*aircraft.state[3:6])


def flown(aircraft: FlexibleAircraft, controls: Controls, seconds: float) -> np.ndarray:
    """Speed, climb rate and height at the ends of the steps, (n, 3)."""
    rows = []
    for _ in range(round(seconds * 1e9 / aircraft.step_ns)):
        aircraft.step(controls)
        rows.append((speed_mps(aircraft), -aircraft.state[5], -aircraft.state[2]))
    return np.array(rows)


@pytest.mark.parametrize(("airspeed_mps", "climb_rad"), [(22.0, 0.0), (17.0, math.radians(-6.0)), (18.0, 0.05)])
def test_trim_balances_weight_drag_and_thrust(airspeed_mps: float, climb_rad: float) -> None:
    """Along the path ``T cos(alpha) = D + W sin(gamma)``, across it ``L + T sin(alpha) = W cos(gamma)``."""
    trim, c = trimmed(PLANE, airspeed_mps, climb_rad), PLANE.longitudinal
    pressure = 0.5 * RHO * airspeed_mps**2 * 2.0 * 0.3
    lift = c.lift_zero + c.lift_alpha * trim.alpha_rad + c.lift_elevator * trim.controls.elevator_rad
    thrust_n = (PLANE.thrust_n - PLANE.thrust_per_mps * airspeed_mps) * trim.controls.throttle
    drag_n, weight_n = pressure * (c.drag_zero + c.drag_lift_square * lift**2), 6.0 * G
    cos, sin = math.cos(trim.alpha_rad), math.sin(trim.alpha_rad)
    assert thrust_n * cos == pytest.approx(drag_n + weight_n * math.sin(climb_rad), abs=1e-6)
    assert pressure * lift + thrust_n * sin == pytest.approx(weight_n * math.cos(climb_rad), abs=1e-6)
    path = flown(FlexibleAircraft(PLANE, MODEL, trim.state(100.0)), trim.controls, 3.0)
    assert np.abs(path[:, 0] - airspeed_mps).max() < 1e-6
    assert np.abs(path[:, 1] - airspeed_mps * math.sin(climb_rad)).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("moment_alpha", "tolerance"), [(-0.9, 0.06), (-20.0, 0.05)])
def test_phugoid_period(moment_alpha: float, tolerance: float) -> None:
    """Lanchester's ``pi sqrt(2) V / g``, longer by the root of manoeuvre margin over static margin.

    The latter is ``1 + Cmq CLa rho S c / (4 m Cma)``: damping in pitch makes a finite stability softer. The tolerance
    is for drag and for the propeller's loss of thrust with speed, which Lanchester leaves out.
    """
    c = dataclasses.replace(PLANE.longitudinal, moment_alpha=moment_alpha)
    plane = dataclasses.replace(PLANE, longitudinal=c, thrust_per_mps=0.0)
    trim = trimmed(plane, 22.0)
    start = trim.state(200.0)
    start[3] += 0.5
    change = flown(FlexibleAircraft(plane, MODEL, start), trim.controls, 28.0)[:, 0] - 22.0
    rising = np.flatnonzero((change[:-1] < 0.0) & (change[1:] >= 0.0))
    period_s = float(np.mean(np.diff(rising))) * 0.002
    damping = c.moment_pitch_rate * c.lift_alpha * RHO * 0.6 * 0.3 / (4.0 * 6.0 * moment_alpha)
    assert period_s == pytest.approx(math.pi * math.sqrt(2.0) * 22.0 / G * math.sqrt(1.0 + damping), rel=tolerance)


def test_energy_is_conserved_without_drag_and_thrust() -> None:
    """Lift does no work: in still air ``V^2 / 2 + g h`` stays, however the elevator moves."""
    c = dataclasses.replace(PLANE.longitudinal, drag_zero=0.0, drag_lift_square=0.0)
    plane = dataclasses.replace(PLANE, longitudinal=c, thrust_n=0.0)
    aircraft = FlexibleAircraft(plane, MODEL, trimmed(PLANE, 20.0).state(100.0))
    energy = []
    for step in range(5000):
        energy.append(0.5 * speed_mps(aircraft) ** 2 - G * aircraft.state[2])
        aircraft.step(Controls(0.03 * math.sin(0.004 * step), 0.0, 0.0, 0.0))
    assert max(energy) - min(energy) < 1e-5 * G * 100.0


def test_drag_takes_what_energy_is_lost() -> None:
    """In a glide the specific energy falls by the integral of drag times speed over mass."""
    aircraft = FlexibleAircraft(PLANE, MODEL, trimmed(PLANE, 20.0, -0.05).state(150.0))
    c, lost, before = PLANE.longitudinal, 0.0, None
    first = 0.5 * speed_mps(aircraft) ** 2 - G * aircraft.state[2]
    for _ in range(4000):
        speed, (_, pitch, _), q = speed_mps(aircraft), aircraft.state[6:9], aircraft.state[10]
        alpha = pitch - math.atan2(-aircraft.state[5], aircraft.state[3])
        lift = c.lift_zero + c.lift_alpha * alpha + c.lift_pitch_rate * q * 0.3 / (2 * speed)
        lift += c.lift_elevator * aircraft.state[12]
        thrust_n = (PLANE.thrust_n - PLANE.thrust_per_mps * speed) * aircraft.state[15] * math.cos(alpha)
        power = (0.5 * RHO * speed**2 * 0.6 * (c.drag_zero + c.drag_lift_square * lift**2) - thrust_n) * speed / 6.0
        lost += 0.0 if before is None else 0.001 * (power + before)
        before = power
        last = 0.5 * speed**2 - G * aircraft.state[2]
        aircraft.step(IDLE)
    assert first - last == pytest.approx(lost, rel=1e-4)
    assert first - last > 100.0


def test_lift_stops_growing_beyond_the_largest_angle_of_attack() -> None:
    """The model has no stall: a dive that is pulled out with full elevator never lifts more than the limit gives."""
    aircraft = FlexibleAircraft(PLANE, MODEL, trimmed(PLANE, 22.0).state(200.0))
    c = PLANE.longitudinal
    for _ in range(1500):
        aircraft.step(Controls(-0.4, 0.0, 0.0, 0.3))
        speed, q_hat = speed_mps(aircraft), aircraft.state[10] * 0.3 / (2 * speed_mps(aircraft))
        most = c.lift_zero + 0.22 * c.lift_alpha + c.lift_pitch_rate * max(q_hat, 0.0)
        drag = c.drag_zero + c.drag_lift_square * most**2
        load = aircraft.body(IDLE).lift_factor * 6.0 * G / (0.5 * RHO * speed**2 * 0.6)
        assert load <= math.hypot(most, drag) + 1e-9


def test_the_wing_bends_with_the_load_factor() -> None:
    """In slow pull-ups q = trim + per g (n - 1), n the specific force over g that an accelerometer feels.

    At 0.4 Hz a 5 Hz wing's swing is 0.6 % larger than the static bend.
    """
    trim = trimmed(PLANE, 22.0)
    aircraft = FlexibleAircraft(PLANE, MODEL, trim.state(200.0))
    wing, off_m, factors = AIRFRAME.wing, [], []
    for step in range(3000):
        elevator = 0.04 * (1.0 - math.cos(2 * math.pi * 0.4 * 0.002 * step))
        aircraft.step(trim.controls._replace(elevator_rad=trim.controls.elevator_rad + elevator))
        factor = -aircraft.body(trim.controls).specific_force_mps2[2] / G
        bend_m = wing.trim_bend_m.value + wing.bend_per_g_m.value * (factor - 1.0)
        off_m.append(abs(float(aircraft.wing.q_m[0]) - bend_m))
        factors.append(factor)
    assert max(factors) - min(factors) > 0.25
    assert max(off_m) < 2e-4, "a hundredth of the bend of 1 g"


def test_a_sharp_gust_lifts_by_its_change_of_the_angle_of_attack() -> None:
    """``delta n = Q S CLa (w / V) / W``: an updraught of 1 m/s (w down is negative) at 22 m/s."""
    trim = trimmed(PLANE, 22.0)
    aircraft = FlexibleAircraft(PLANE, MODEL, trim.state(60.0))
    before = aircraft.body(trim.controls).lift_factor
    gain = aircraft.body(trim.controls, AirMotion(w_mps=-1.0)).lift_factor - before
    expected = 0.5 * RHO * 22.0**2 * 0.6 * PLANE.longitudinal.lift_alpha / 22.0 / (6.0 * G)
    assert gain == pytest.approx(expected, rel=0.05)  # drag turns with the flow, and V grows by w^2 / 2V


def test_right_aileron_rolls_right_and_lifts_the_left_tip() -> None:
    trim = trimmed(PLANE, 22.0)
    aircraft = FlexibleAircraft(PLANE, MODEL, trim.state(60.0))
    flown(aircraft, trim.controls._replace(aileron_rad=0.1), 0.12)
    left_m, right_m = MODEL.structure.lift @ aircraft.wing.q_m
    assert aircraft.state[9] > 0.05
    assert left_m > right_m + 1e-4


def test_it_stands_on_its_wheels_without_bend() -> None:
    """At rest the springs carry the weight at the sink that they are made for, and the wing is as it was calibrated."""
    start = [0.0, 0.0, -0.25, *[0.0] * 13]
    aircraft = FlexibleAircraft(PLANE, MODEL, start)
    flown(aircraft, IDLE, 8.0)
    body = aircraft.body(IDLE)
    assert body.wheels_n == pytest.approx(6.0 * G, rel=1e-3)
    mains = 0.55 / 0.63  # share of the weight, by the levers of the wheels; a third of the springs' rate each
    sunk_m = 0.03 * 3.0 * (mains**2 / 2.0 + (1.0 - mains) ** 2)
    assert -body.position_ned_m[2] == pytest.approx(
        0.25 - sunk_m, abs=1.5e-3
    )  # the nose-up stand moves the levers by 2 %
    assert math.hypot(*body.specific_force_mps2) == pytest.approx(G, rel=1e-3)
    assert abs(float(aircraft.wing.q_m[0])) < 2e-4


def test_a_bump_bends_the_tips_down() -> None:
    """A touch-down at 1.5 m/s throws the root up and leaves the tips behind: the bend falls below that of the lift."""
    trim = trimmed(PLANE, 16.0)
    start = trim.state(0.35)
    start[5] = 1.5
    aircraft = FlexibleAircraft(PLANE, MODEL, start)
    bends_m, factors = [], []
    for _ in range(150):
        aircraft.step(trim.controls)
        bends_m.append(float(aircraft.wing.q_m[0]))
        factors.append(-aircraft.body(trim.controls).specific_force_mps2[2] / G)
    assert max(factors) > 2.0
    assert min(bends_m) < AIRFRAME.wing.trim_bend_m.value - 0.01


def test_a_scaled_aeroplane_flies_alike() -> None:
    """Froude: half the size trims at the same angle of attack and throttle at 1 / sqrt(2) of the speed."""
    half = dataclasses.replace(AIRFRAME, wing=dataclasses.replace(AIRFRAME.wing, semispan_m=0.5))
    small, large = trimmed(Airplane.of_airframe(half), 20.0 / math.sqrt(2.0)), trimmed(PLANE, 20.0)
    assert small.alpha_rad == pytest.approx(large.alpha_rad, rel=1e-9)
    assert small.controls.throttle == pytest.approx(large.controls.throttle, rel=1e-9)
