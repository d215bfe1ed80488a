"""Worlds of the simulator against closed forms: aliased lines, broadband, warm-up, clipping, ground rolls, draws."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.signal import welch

from companion.core.stereo.geometry import Rig
from companion.core.wing.lowpass import Biquad
from companion.params.airframe import Sensor
from companion.params.files import load_airframe
from companion.records import Floats, Side, Station
from companion.sim.flight.aircraft import airspeed, altitude_m, circuit_plan, lift_share
from companion.sim.flight.flight import build_flight, undisturbed
from companion.sim.flight.gust import GustKind
from companion.sim.flight.sensors import BACKEND_HZ, lowpassed
from companion.sim.flight.vibration import SensorDisturbance, ShaftTurns, StationVibration, VibrationLine
from companion.sim.flight.world_draw import gusty
from companion.sim.flight.worlds import FAIR, IDEAL, ROUGH, TONES, WORLDS, Conditions, LensResiduals
from companion.units import GRAVITY_MPS2
from sitl_tests.still_plan import still_plan

SENSOR: Sensor = load_airframe("nadir-2m").left
SECONDS = 20.0
T_S = np.arange(round(SECONDS * BACKEND_HZ)) / BACKEND_HZ


def vibration(
    rate_hz: float = 80.0, amplitude: float = 0.0, density: float = 0.0, band_hz: tuple[float, float] = (40.0, 400.0)
) -> StationVibration:
    turns = ShaftTurns.from_rate(np.full(round(SECONDS * 100) + 2, rate_hz))
    line = VibrationLine(1.0, np.full(6, amplitude), np.zeros(6))
    return StationVibration(turns, (line,), np.full(6, density), band_hz)


def shaken(source: StationVibration, at: float = 0.0) -> Floats:
    return source.added(np.full((len(T_S), 6), at), T_S, 1.0 / BACKEND_HZ, SENSOR, np.random.default_rng(1))


def amplitude_at(values: Floats, t_s: Floats, frequency_hz: float) -> float:
    basis = np.exp(-2j * math.pi * frequency_hz * t_s)
    return float(2.0 * abs(np.mean(values * basis)))


@pytest.mark.parametrize(("line_hz", "alias_hz"), [(80.0, 80.0), (260.0, 260.0), (980.0, 20.0), (1013.0, 13.0)])
def test_a_line_comes_out_at_its_alias_with_the_gain_of_the_averaging(line_hz: float, alias_hz: float) -> None:
    values = shaken(vibration(line_hz, 2.0))[:, 2]
    u = math.pi * line_hz / BACKEND_HZ
    mean_of_eight = abs(math.sin(u) / (8.0 * math.sin(u / 8.0)))
    assert amplitude_at(values, T_S, alias_hz) == pytest.approx(2.0 * mean_of_eight, rel=1e-3)
    assert mean_of_eight == pytest.approx(abs(np.sinc(line_hz / BACKEND_HZ)), rel=0.03)


def test_a_line_passes_the_autopilots_filter_and_aliases_when_every_third_sample_is_sent() -> None:
    line_hz, sent_hz = 320.0, BACKEND_HZ / 3.0
    filtered = lowpassed(shaken(vibration(line_hz, 5.0)), 20.0, 20.0, BACKEND_HZ)
    late = slice(1500, None, 3)
    z = np.exp(-2j * math.pi * line_hz / BACKEND_HZ)
    biquad = Biquad.lowpass(20.0, BACKEND_HZ)
    (b0, b1, b2), (a1, a2) = biquad.b, biquad.a
    gain = abs((b0 + b1 * z + b2 * z**2) / (1.0 + a1 * z + a2 * z**2)) * np.sinc(line_hz / BACKEND_HZ)
    out = amplitude_at(filtered[late, 2], T_S[late], sent_hz - line_hz)
    assert out == pytest.approx(5.0 * gain, rel=0.02)
    assert 0.0 < gain < 0.01


def test_broadband_has_its_level_inside_its_band_and_none_below() -> None:
    values = shaken(vibration(density=0.01))[:, 0]
    frequency_hz, power = welch(values, BACKEND_HZ, nperseg=1024)
    inside = (frequency_hz > 80) & (frequency_hz < 250)
    droop = np.sinc(frequency_hz[inside] / BACKEND_HZ) ** 2
    # 38 overlapping segments, 170 lines: the mean is known to 2 %; the band's edges fall by 4 % at 80 and at 250 Hz
    assert np.sqrt(np.mean(power[inside] / droop)) == pytest.approx(0.01, rel=0.08)
    assert np.sqrt(np.mean(power[frequency_hz < 15])) < 0.003


def test_warm_up_goes_with_its_time_constant() -> None:
    drift = SensorDisturbance(np.array([0.03, 0, 0, 0, 0, 0.001]), 20.0, None)
    values = drift.felt(np.zeros((3, 6)), np.array([0.0, 20.0, 400.0]), 1e-3, SENSOR, np.random.default_rng(0))
    assert values[:, 0] == pytest.approx([0.0, 0.03 * (1 - math.exp(-1)), 0.03], abs=1e-9)
    assert values[2, 5] == pytest.approx(0.001)
    assert not values[:, 1:5].any()


def test_a_line_beyond_the_range_is_cut_and_leaves_an_offset() -> None:
    values = shaken(vibration(80.0, 200.0), -GRAVITY_MPS2)[:, 2]
    phase = np.linspace(0.0, 2 * math.pi, 20_001)[:-1]
    cut = np.clip(-GRAVITY_MPS2 + 200.0 * np.sin(phase), -SENSOR.accel_range_mps2, SENSOR.accel_range_mps2)
    assert np.abs(values).max() <= SENSOR.accel_range_mps2
    assert values.mean() == pytest.approx(cut.mean(), abs=0.02)
    assert values.mean() > -0.8 * GRAVITY_MPS2


@pytest.mark.parametrize("world", [FAIR, ROUGH, TONES])
def test_the_same_seed_flies_the_same_aircraft_differently_disturbed(world: Conditions) -> None:
    airframe = load_airframe("nadir-2m")
    plain, other = (build_flight(airframe, 4, plan=still_plan(2.0), world=w) for w in (IDEAL, world))
    again = build_flight(airframe, 4, plan=still_plan(2.0), world=world)
    assert np.array_equal(other.nodes[Station.LEFT].values, again.nodes[Station.LEFT].values)
    assert np.array_equal(other.truth.knots, again.truth.knots)
    assert not np.array_equal(other.nodes[Station.LEFT].values, plain.nodes[Station.LEFT].values)
    assert other.real.actual.wing.symmetric == plain.real.actual.wing.symmetric
    assert other.real.errors[Station.LEFT].time_offset_s == plain.real.errors[Station.LEFT].time_offset_s
    if world is TONES:
        assert np.array_equal(other.truth.knots, plain.truth.knots)
        root = Station.ROOT
        assert np.array_equal(other.backends[root].raw, plain.backends[root].raw), "its lines are at the tips alone"
    else:
        assert other.real.actual.left_camera != plain.real.actual.left_camera


def test_undisturbed_it_is_the_same_flight_with_its_noise_stated_and_no_vibration() -> None:
    belief = load_airframe("nadir-2m")
    shaken_flight = build_flight(belief, 5, 4.0, world=ROUGH)
    quiet = undisturbed(shaken_flight)
    assert quiet.truth is shaken_flight.truth
    assert quiet.airframe.left.accel_noise_mps2_rthz == shaken_flight.real.actual.left.accel_noise_mps2_rthz
    assert quiet.airframe.left.accel_scale_sigma == belief.left.accel_scale_sigma, "what it does wrong stays unknown"
    wear = dataclasses.replace(ROUGH.sensors, accel_thermal_mps2=0.0, gyro_thermal_radps=0.0)
    calm = build_flight(belief, 5, 4.0, world=dataclasses.replace(ROUGH, propulsion=None, sensors=wear))
    for station, stream in calm.streams().items():
        assert np.array_equal(quiet.streams()[station].values, stream.values)
        assert np.std((shaken_flight.streams()[station].values - stream.values)[:, 2]) > 0.2


def test_ideal_adds_nothing() -> None:
    flight = build_flight(load_airframe("nadir-2m"), 4, plan=still_plan(2.0))
    assert flight.world is IDEAL
    assert flight.real.actual.left.accel_noise_mps2_rthz == flight.airframe.left.accel_noise_mps2_rthz
    assert flight.real.actual.left_camera is not None
    assert flight.real.actual.left_camera.distortion == (0.0,) * 5
    assert set(flight.throttle(np.arange(3.0)).tolist()) == {0.6}


def test_a_world_is_called_by_its_name() -> None:
    assert {name: world.name for name, world in WORLDS.items()} == {name: name for name in WORLDS}


@pytest.mark.slow
def test_lens_residuals_have_the_stated_sigmas() -> None:
    airframe = load_airframe("nadir-2m")
    plan = still_plan(0.2)
    tangential, columns = [], []
    for seed in range(60):
        flight = build_flight(airframe, seed, plan=plan, gust=GustKind.CALM, world=ROUGH)
        for camera in (flight.real.actual.left_camera, flight.real.actual.right_camera):
            assert camera is not None
            tangential += camera.distortion[2:4]
            columns.append(camera.principal_px[0] - 319.5)
    # 240 and 120 draws: the spread is known to 4.6 and 6.5 %; three sigma
    assert np.std(tangential) == pytest.approx(ROUGH.lenses.tangential, rel=0.14)
    assert np.std(columns) == pytest.approx(ROUGH.lenses.principal_px, rel=0.2)


def test_a_discrete_gust_lifts_the_load_factor_by_what_was_drawn() -> None:
    weather = dataclasses.replace(FAIR.weather, discrete_per_min=60.0, discrete_g=(0.3, 0.3), discrete_s=(0.8, 0.8))
    plan = gusty(still_plan(20.0), weather, np.random.default_rng(3))
    signs = [math.copysign(1.0, gust.climb_mps) for gust in plan.pull_ups]
    assert {-1.0, 1.0} == set(signs)
    for sign in (-1.0, 1.0):
        gust = dataclasses.replace(plan.pull_ups[signs.index(sign)], from_s=2.0)
        single_gust = dataclasses.replace(plan, duration_s=12.0, pull_ups=(gust,))
        flight = build_flight(load_airframe("nadir-2m"), 1, plan=single_gust, gust=GustKind.CALM, perturbed=False)
        factor = flight.truth.series(np.arange(0, 12_000_000_000, 5_000_000)).load_factor
        assert (sign * (factor - 1.0)).max() == pytest.approx(0.3, abs=0.01)


def test_gusts_leave_an_aircraft_on_its_wheels_and_out_of_the_ground() -> None:
    weather = dataclasses.replace(FAIR.weather, discrete_per_min=30.0, discrete_g=(0.6, 0.6), discrete_s=(1.4, 1.4))
    t_s = np.arange(0.0, 64.0, 0.05)
    for seed in range(20):
        plan = circuit_plan(64.0)
        gusts = gusty(plan, weather, np.random.default_rng(seed))
        off_s, on_s = plan.airborne_s
        assert len(gusts.pull_ups) > 5
        on_wheels = (t_s < off_s) | (t_s > on_s)
        np.testing.assert_allclose(altitude_m(gusts, t_s)[on_wheels], altitude_m(plan, t_s)[on_wheels], atol=1e-9)
        assert altitude_m(gusts, t_s).min() >= altitude_m(plan, t_s).min() - 1e-9


def test_a_ground_roll_stands_then_flies_and_its_wing_is_unloaded_on_the_wheels() -> None:
    plan = circuit_plan(40.0)
    flight = build_flight(load_airframe("nadir-2m"), 1, plan=plan, gust=GustKind.CALM, perturbed=False)
    times = np.array([0, 20_000_000_000], dtype=np.int64)
    truth = flight.truth.series(times)
    assert airspeed(plan, times * 1e-9)[0] == pytest.approx([0.0, 22.0])
    assert lift_share(plan, times * 1e-9) == pytest.approx([0.0, 1.0])
    assert abs(truth.velocity_ned_mps[0, 0]) < 1e-6
    assert -truth.position_ned_m[0, 2] < 0.6
    wing = flight.airframe.wing
    unloaded = wing.trim_bend_m.value - wing.bend_per_g_m.value
    # the bumps shake the wing about where no lift bends it
    rolling = flight.truth.series(np.arange(0, 2_000_000_000, 10_000_000)).q_m[:, 0]
    assert rolling.mean() == pytest.approx(unloaded, abs=0.004)
    # velocity is the derivative of position where speed, bumps and climb all change
    near = np.arange(5_000_000_000, 9_000_000_000, 1_000_000, dtype=np.int64)
    path = flight.truth.series(near)
    rate = np.diff(path.position_ned_m, axis=0) / 1e-3
    assert np.abs(rate - 0.5 * (path.velocity_ned_mps[1:] + path.velocity_ned_mps[:-1])).max() < 2e-4
    force = path.specific_force_mps2[:, 2] + GRAVITY_MPS2
    assert 1.5 < np.std(force[:1500]) < 4.5, "bumps of 3 m/s^2 rms"


def test_a_wrong_principal_point_leaves_the_middle_of_the_image_where_it_was() -> None:
    airframe = load_airframe("nadir-2m")
    world = dataclasses.replace(IDEAL, lenses=LensResiduals(principal_px=2.0))
    plain, other = (
        build_flight(airframe, 5, plan=still_plan(0.2), gust=GustKind.CALM, world=w).real.actual for w in (IDEAL, world)
    )
    before, after = Rig.from_airframe(plain), Rig.from_airframe(other)
    for side in Side:
        camera, worn = before.camera(side), after.camera(side)
        ahead = camera.rest.position_body_m + 60.0 * camera.rest.camera_from_body[2]
        pixels = camera.project(camera.rest, ahead), worn.project(worn.rest, ahead)
        assert camera.lens.matrix[0, 2] != worn.lens.matrix[0, 2]
        # the turn of 2 px / 800 px leaves its square, and its product with the mounting's turn
        assert np.abs(pixels[1] - pixels[0]).max() < 0.02
