"""Signed closed forms for the simulated flight, from first principles: nothing of our core says what is expected."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from companion.params.airframe import Airframe, Sensor, Uncertain
from companion.params.files import load_airframe
from companion.records import Station
from companion.sim.flight.aircraft import AltitudeStep, FlightPlan, Jolt, PullUp, Roll, demo_plan
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.gust import GustKind
from companion.sim.flight.sensors import station_readings
from sitl_tests.still_plan import still_plan

G = 9.80665
SLOPE = 1.39


def quiet(sensor: Sensor) -> Sensor:
    return dataclasses.replace(
        sensor,
        accel_noise_mps2_rthz=0.0,
        gyro_noise_radps_rthz=0.0,
        accel_bias_sigma_mps2=0.0,
        gyro_bias_sigma_radps=0.0,
        lowpass_accel_hz=0.0,
        lowpass_gyro_hz=0.0,
    )


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    base = load_airframe("nadir-2m")
    return dataclasses.replace(base, root=quiet(base.root), left=quiet(base.left), right=quiet(base.right))


def rigid(airframe: Airframe) -> Airframe:
    """A wing that does not bend under load."""
    wing = dataclasses.replace(airframe.wing, trim_bend_m=Uncertain(0.0), bend_per_g_m=Uncertain(0.0))
    return dataclasses.replace(airframe, wing=wing)


def calm_flight(airframe: Airframe, plan: FlightPlan) -> Flight:
    return build_flight(airframe, 7, plan=plan, gust=GustKind.CALM, perturbed=False)


def readings(flight: Flight, station: Station, t_s: float) -> np.ndarray:
    sensor = flight.real.actual.sensor(station)
    return station_readings(
        flight.truth, flight.model, station, sensor, np.array([round(t_s * 1e9)], dtype=np.int64), 1_000_000
    )[0]


@pytest.fixture(scope="module")
def demo(airframe: Airframe) -> Flight:
    return build_flight(airframe, 3, 60.0)


# ------------------------------------------------------------------------------------------ rigid flight


def test_level_and_unaccelerated_reads_minus_one_g(airframe: Airframe) -> None:
    flight = calm_flight(airframe, still_plan(3.0))
    np.testing.assert_allclose(readings(flight, Station.ROOT, 1.0), [0, 0, -9.80665, 0, 0, 0], atol=1e-9)
    assert flight.truth.at(1_000_000_000).load_factor == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("t_s", [4.7, 12.0123, 21.5, 33.3331, 45.0, 54.4567])
def test_gyro_attitude_and_accelerometer_of_the_demo_agree(demo: Flight, t_s: float) -> None:
    t_ns, h = round(t_s * 1e9), 1e-4
    step = round(h * 1e9)
    before, here, after = (demo.truth.at(t_ns + k * step) for k in (-1, 0, 1))
    # d/dt body_from_ned = -[omega]x body_from_ned
    spin = (after.body_from_ned - before.body_from_ned) / (2 * h) @ here.body_from_ned.T
    p, q, r = here.body_rate_radps
    np.testing.assert_allclose(spin, -np.array([[0, -r, q], [r, 0, -p], [-q, p, 0]]), atol=1e-6)
    acceleration = (after.velocity_ned_mps - before.velocity_ned_mps) / (2 * h)
    force = here.body_from_ned @ (acceleration - np.array([0, 0, G]))
    np.testing.assert_allclose(here.specific_force_mps2, force, atol=1e-5)
    velocity = (after.position_ned_m - before.position_ned_m) / (2 * h)
    np.testing.assert_allclose(here.velocity_ned_mps, velocity, atol=1e-6)
    change = (after.body_rate_radps - before.body_rate_radps) / (2 * h)
    np.testing.assert_allclose(here.angular_accel_radps2, change, atol=1e-5)


def test_a_banked_turn_pulls_one_over_cosine_without_slip(airframe: Airframe) -> None:
    bank, speed = 0.5, 22.0
    plan = dataclasses.replace(still_plan(14.0), rolls=(Roll(1.0, bank, 2.0, 8.0),), airspeed_mps=speed)
    sample = calm_flight(airframe, plan).truth.at(7_000_000_000)
    assert sample.load_factor == pytest.approx(1 / math.cos(bank), rel=1e-6)
    assert sample.specific_force_mps2[1] == pytest.approx(0.0, abs=1e-9)
    turn = G * math.tan(bank) / speed
    # to the right: yaw rate is positive, seen along the tilted axes as pitch and yaw
    np.testing.assert_allclose(sample.body_rate_radps, [0, turn * math.sin(bank), turn * math.cos(bank)], atol=1e-9)


def test_a_pull_up_loads_and_its_easing_unloads(airframe: Airframe) -> None:
    plan = dataclasses.replace(still_plan(14.0), pull_ups=(PullUp(2.0, 2.2, 1.2, 4.0),))
    truth = calm_flight(airframe, plan).truth
    # the rise of climb rate has a mean acceleration of 2.2/1.2 and a peak of 35/16 times that
    peak = 2.2 / 1.2 * 35 / 16 / G
    assert truth.at(2_600_000_000).load_factor - 1 == pytest.approx(peak, rel=0.03)
    assert truth.at(5_200_000_000).load_factor < 1.0
    # it comes back to the altitude it left
    assert truth.at(13_900_000_000).position_ned_m[2] == pytest.approx(-60.0, abs=1e-9)


def test_the_demo_visits_its_altitudes_and_its_envelope(demo: Flight) -> None:
    truth = demo.truth.series(demo.truth.t_boot_ns[:60_000])
    height = -truth.position_ned_m[:, 2]
    for level in (20.0, 60.0, 100.0):
        assert np.count_nonzero(np.abs(height - level) < 3.0) > 5_000, f"less than 5 s near {level} m"
    assert 0.65 < truth.load_factor.min() < 0.95
    assert 1.2 < truth.load_factor.max() < 1.6
    assert 0.4 < np.abs(truth.euler_rad[:, 0]).max() < 0.65
    assert 0.4 < np.abs(truth.body_rate_radps[:, 0]).max() < 0.75


# ------------------------------------------------------------------------------------------ the wing in flight


def test_trim_bend_tilts_the_tip_sensors_outward(airframe: Airframe) -> None:
    flight = calm_flight(airframe, still_plan(3.0))
    psi = SLOPE * 0.0149
    left, right = (readings(flight, station, 1.0) for station in (Station.LEFT, Station.RIGHT))
    # gravity pulls down: on the raised left tip, whose y axis points a little down to the fuselage, f_y = f_z sin(psi)
    np.testing.assert_allclose(left[:3], [0, -G * math.sin(psi), -G * math.cos(psi)], atol=1e-6)
    np.testing.assert_allclose(right[:3], [0, +G * math.sin(psi), -G * math.cos(psi)], atol=1e-6)


def test_bend_follows_the_load_factor(airframe: Airframe) -> None:
    bank = 0.55
    plan = dataclasses.replace(still_plan(20.0), rolls=(Roll(1.0, bank, 3.0, 14.0),))
    sample = calm_flight(airframe, plan).truth.at(17_000_000_000)
    expected = 0.0149 + 0.0149 * (1 / math.cos(bank) - 1)
    np.testing.assert_allclose(sample.q_m, [expected, 0, 0, 0], atol=2e-6)
    np.testing.assert_allclose(sample.slope_rad, SLOPE * expected, rtol=2e-4)
    np.testing.assert_allclose(sample.lift_m, expected, rtol=2e-4)


def test_rolling_acceleration_and_centripetal_force_at_the_tips(airframe: Airframe) -> None:
    plan = dataclasses.replace(still_plan(8.0), rolls=(Roll(1.0, 0.5, 2.0, 2.0),))
    flight = calm_flight(rigid(airframe), plan)
    for t_s in (1.4, 2.0, 2.6):
        here = flight.truth.at(round(t_s * 1e9))
        left, root, right = (readings(flight, s, t_s) for s in (Station.LEFT, Station.ROOT, Station.RIGHT))
        p, q, r = here.body_rate_radps
        p_dot, _, r_dot = here.angular_accel_radps2
        # span 2 m: a roll that quickens to the right presses the right tip down, towards +z
        np.testing.assert_allclose(right[2] - left[2], 2 * (p_dot + q * r), atol=1e-9)
        np.testing.assert_allclose(right[1] - left[1], -2 * (p * p + r * r), atol=1e-9)
        np.testing.assert_allclose(right[0] - left[0], 2 * (p * q - r_dot), atol=1e-9)
        np.testing.assert_allclose((left + right) / 2, root, atol=1e-9)


def test_the_tip_gyro_adds_the_slope_rate_with_opposite_signs(demo: Flight) -> None:
    t_s = 20.3
    here = demo.truth.at(round(t_s * 1e9))
    left, right = (readings(demo, station, t_s) for station in (Station.LEFT, Station.RIGHT))
    # a small turn mixes q and r in; up-bend is +x on the left and -x on the right
    for values, sign, side in ((left, 1, 0), (right, -1, 1)):
        psi = sign * here.slope_rad[side]
        assert values[3] == pytest.approx(here.body_rate_radps[0] + sign * here.slope_rate_radps[side], abs=2e-3)
        turned = math.cos(psi) * here.body_rate_radps[1] + math.sin(psi) * here.body_rate_radps[2]
        assert values[4] == pytest.approx(turned, abs=1e-9)


def test_antisymmetric_raises_the_right_and_lowers_the_left(demo: Flight) -> None:
    truth = demo.truth
    here = truth.series(truth.t_boot_ns[1000:20_000])
    half = (here.lift_m[:, 1] - here.lift_m[:, 0]) / 2
    np.testing.assert_allclose(half, here.q_m[:, 1] + here.q_m[:, 3], atol=1e-12)
    np.testing.assert_allclose(here.lift_m.mean(axis=1), here.q_m[:, 0] + here.q_m[:, 2], atol=1e-12)
    slopes = (here.slope_rad[:, 1] - here.slope_rad[:, 0]) / 2
    assert np.corrcoef(slopes, half)[0, 1] > 0.99


def test_the_mean_of_the_vertical_axis_is_the_change_of_tip_velocity(airframe: Airframe) -> None:
    plan = still_plan(4.0)
    flight = build_flight(rigid(airframe), 5, plan=plan, gust=GustKind.WHITE, perturbed=False)
    times = 1_000_000_000 + 1_000_000 * np.arange(1000, dtype=np.int64)
    sensor = flight.real.actual.left
    values = station_readings(flight.truth, flight.model, Station.LEFT, sensor, times, 1_000_000)
    rate = flight.truth.series(np.array([999_500_000, 1_999_500_000])).lift_rate_mps[:, 0]
    tilt = flight.truth.series(times).slope_rad[:, 0]
    # turned back by the tilt the vertical force is -g - w'': the sum of -(f_z + g) dt is the gain of upward velocity
    felt = -(np.cos(tilt) * values[:, 2] + np.sin(tilt) * values[:, 1] + G)
    assert felt.sum() * 1e-3 == pytest.approx(rate[1] - rate[0], abs=1e-9)


@pytest.mark.parametrize("peak_mps2", [3.0, -10.0])
def test_a_blow_to_the_fuselage_leaves_the_tips_behind(airframe: Airframe, peak_mps2: float) -> None:
    """Duhamel's integral of a cantilever whose root jumps; 1.566 and -0.868 are a uniform one's participations."""
    begun_s, length_s = 1.0, 0.02
    plan = dataclasses.replace(still_plan(2.0), jolts=(Jolt(begun_s, peak_mps2, length_s),))
    flight = calm_flight(airframe, plan)
    at_s = begun_s + 0.5 * length_s
    assert readings(flight, Station.ROOT, at_s)[2] == pytest.approx(-G - peak_mps2, abs=1e-6)
    gained = flight.truth.at(1_500_000_000).velocity_ned_mps - flight.truth.at(500_000_000).velocity_ned_mps
    np.testing.assert_allclose(gained, [0, 0, -peak_mps2 * 2 * length_s / math.pi], atol=1e-9)
    wing = airframe.wing
    assert wing.second_symmetric is not None
    s = np.linspace(0.0, length_s, 2001)
    for t_s in (1.025, 1.07, 1.2):
        here, calm = flight.truth.at(round(t_s * 1e9)), flight.truth.at(500_000_000)
        for slot, mode, participation in ((0, wing.symmetric, 1.566), (2, wing.second_symmetric, -0.868)):
            omega, zeta = 2 * math.pi * mode.frequency_hz.value, mode.damping.value
            ringing, since = omega * math.sqrt(1 - zeta**2), t_s - begun_s - s
            answer = np.exp(-zeta * omega * since) * np.sin(ringing * since) / ringing
            blow = peak_mps2 * np.sin(np.pi * s / length_s)
            wanted = -participation * np.trapezoid(blow * answer, s)
            assert here.q_m[slot] - calm.q_m[slot] == pytest.approx(wanted, abs=2e-3 * abs(peak_mps2) / omega**2)
        assert here.q_m[1] == pytest.approx(calm.q_m[1], abs=1e-9)
    if peak_mps2 > 0:
        assert flight.truth.at(1_030_000_000).q_m[0] < calm.q_m[0]  # struck from below, the tips stay down


def test_slope_rate_is_the_derivative_of_slope_between_knots(demo: Flight) -> None:
    for t_ns in (10_000_250_000, 10_000_499_000, 25_123_456_789):
        before, here, after = (demo.truth.at(t_ns + k * 10_000) for k in (-1, 0, 1))
        np.testing.assert_allclose(here.slope_rate_radps, (after.slope_rad - before.slope_rad) / 2e-5, atol=1e-6)


@pytest.mark.long
def test_deflection_about_its_static_value_has_the_drawn_rms(airframe: Airframe) -> None:
    squares = []
    for seed in range(6):
        flight = build_flight(airframe, seed, plan=still_plan(60.0))
        wing = flight.real.actual.wing
        q = flight.truth.knots[:60_000, 12] - wing.trim_bend_m.value
        squares.append(np.mean(q**2) / wing.gust.deflection_rms_m.value**2)
    # 6 min of a 5 Hz, zeta 0.03 mode hold some 300 independent samples of the variance
    assert np.mean(squares) == pytest.approx(1.0, abs=0.2)


def test_the_plan_holds_its_level_outside_the_climbs() -> None:
    plan = demo_plan(60.0)
    assert [level.altitude_m for level in plan.levels] == [100.0, 60.0, 20.0]
    short = demo_plan(20.0)
    assert short.levels == (AltitudeStep(0.0, 60.0),)
