"""Sensors, priors, clocks and the two offline forms of a simulated flight."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.core.wing.lowpass import Biquad
from companion.diagnosis.data.sample_defects import find_sample_defects
from companion.errors import ConfigError
from companion.params.airframe import Airframe, NamedEffect, Source
from companion.params.files import load_airframe, shipped_airframes
from companion.records import AutopilotParameter, ClockName, ImuBatch, Station, TimesyncReply, VehicleState
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.gust import GustKind
from companion.sim.flight.offline import HOST_EPOCH_NS, flight_records
from companion.sim.flight.perturb import SensorErrors, TrueClock, draw_truth
from companion.sim.flight.sensors import corrupted, drifting, limited, lowpassed, on_wire, send_times
from companion.sim.flight.tables import write_csv
from companion.sim.vehicle.wire import FrameSender, inertial_format, payloads, stamped
from sitl_tests.still_plan import still_plan


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return load_airframe("nadir-2m")


@pytest.fixture(scope="module")
def flight(airframe: Airframe) -> Flight:
    return build_flight(airframe, 5, 10.0)


# ------------------------------------------------------------------------------------------ priors


def test_draws_follow_the_priors(airframe: Airframe) -> None:
    rng = np.random.default_rng(0)
    truths = [draw_truth(airframe, rng) for _ in range(600)]
    wing = airframe.wing

    def normal(values: list[float], mean: float, sigma: float) -> None:
        z = (np.array(values) - mean) / sigma
        # 600 draws: the mean is known to 0.041, the spread to 0.029; four sigma
        assert abs(z.mean()) < 0.17
        assert abs(z.std() - 1) < 0.12

    frequency = wing.symmetric.frequency_hz
    drawn = [math.log(t.actual.wing.symmetric.frequency_hz.value) for t in truths]
    normal(drawn, math.log(frequency.value), frequency.sigma / frequency.value)
    normal([t.actual.wing.trim_bend_m.value for t in truths], wing.trim_bend_m.value, wing.trim_bend_m.sigma)
    normal([t.errors[Station.LEFT].accel_scale[2] for t in truths], 0.0, airframe.left.accel_scale_sigma)
    normal([t.errors[Station.RIGHT].misalignment_rad[0] for t in truths], 0.0, airframe.right.misalignment_sigma_rad)
    normal([t.errors[Station.LEFT].time_offset_s for t in truths], 0.0, airframe.left.time_offset_sigma_s)
    normal([-t.actual.left.position_m[2] for t in truths], 0.0, airframe.left.height_sigma_m)
    left, believed = [t.actual.left_camera for t in truths], airframe.left_camera
    assert believed is not None
    normal([c.rotation_rad[1] for c in left if c], 0.0, believed.rotation_sigma_rad)
    assert all(t.actual.wing.symmetric.damping.value > 0 for t in truths)
    assert all(c is not None and c.latency_s.value >= 0.001 for c in left)


def test_a_truth_has_no_doubt_left(airframe: Airframe) -> None:
    actual = draw_truth(airframe, np.random.default_rng(1)).actual
    assert actual.wing.symmetric.slope_factor_radpm.sigma == 0.0
    assert actual.left_camera is not None
    assert actual.left_camera.rotation_sigma_rad == 0.0


@pytest.mark.slow
def test_a_flight_is_determined_by_its_seed(airframe: Airframe, flight: Flight) -> None:
    again, other = build_flight(airframe, 5, 10.0), build_flight(airframe, 6, 10.0)
    assert again.real.actual == flight.real.actual
    np.testing.assert_array_equal(again.truth.knots, flight.truth.knots)
    for station, stream in flight.streams().items():
        np.testing.assert_array_equal(stream.values, again.streams()[station].values)
        np.testing.assert_array_equal(stream.stamp_ns, again.streams()[station].stamp_ns)
    assert not np.array_equal(other.truth.knots, flight.truth.knots)


@pytest.mark.slow
def test_a_hidden_effect_is_in_the_truth_and_not_in_the_belief(airframe: Airframe) -> None:
    effect = NamedEffect("frequency-shift", {"ratio": 0.2})
    flight = build_flight(airframe, 1, plan=still_plan(4.0), effects=(effect,), perturbed=False)
    assert flight.airframe.effects == ()
    assert flight.model.omega_radps[0] == pytest.approx(1.2 * 2 * math.pi * 5.0)


def test_queries_outside_the_flight_are_refused(flight: Flight) -> None:
    with pytest.raises(ValueError, match="outside the flight"):
        flight.truth.at(-1)
    with pytest.raises(ValueError, match="outside the flight"):
        flight.truth.at(round(flight.truth.duration_s * 1e9) + 1)


# ------------------------------------------------------------------------------------------ sensors


def test_noise_has_the_stated_density(airframe: Airframe) -> None:
    sensor = dataclasses.replace(airframe.left, accel_bias_sigma_mps2=0.0, gyro_bias_sigma_radps=0.0)
    none, still = SensorErrors(np.zeros(3), np.zeros(3), np.zeros(3), 0.0), np.zeros((100_000, 6))
    noise = corrupted(still, still, sensor, none, 1000.0, np.random.default_rng(0))
    # averaging over 0.1 s leaves the variance density^2 / (2 * 0.1 s)
    means = noise.reshape(1000, 100, 6).mean(axis=1)
    np.testing.assert_allclose(means[:, :3].std(), 0.0007 / math.sqrt(0.2), rtol=0.06)
    np.testing.assert_allclose(means[:, 3:].std(), 0.00005 / math.sqrt(0.2), rtol=0.06)


def test_scale_and_misalignment_act_as_documented(airframe: Airframe) -> None:
    sensor = dataclasses.replace(
        airframe.left,
        accel_noise_mps2_rthz=0.0,
        gyro_noise_radps_rthz=0.0,
        accel_bias_sigma_mps2=0.0,
        gyro_bias_sigma_radps=0.0,
    )
    errors = SensorErrors(np.array([0.0, 0.0, 0.01]), np.array([0.02, 0.0, 0.0]), np.array([0.003, 0.0, 0.0]), 0.0)
    true = np.array([[0.0, 0.0, -9.80665, 1.0, 0.0, 0.0]])
    read = corrupted(true, np.zeros((1, 6)), sensor, errors, 1000.0, np.random.default_rng(0))[0]
    # the triad is turned by +3 mrad about x: its y axis dips towards +z, so gravity's reaction shows as -y
    np.testing.assert_allclose(read[1], -9.80665 * math.sin(0.003), rtol=1e-9)
    np.testing.assert_allclose(read[2], -9.80665 * math.cos(0.003) * 1.01, rtol=1e-9)
    np.testing.assert_allclose(read[3], 1.02, rtol=1e-9)


def test_bias_wanders_with_its_variance_and_time() -> None:
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, 4000.0, 10.0)
    paths = drifting(t_s, 50.0, 60, rng)
    assert paths.var() == pytest.approx(1.0, abs=0.1)
    # after one time constant the correlation is 1/e
    lag = 5
    assert np.mean(paths[lag:] * paths[:-lag]) == pytest.approx(math.exp(-1), abs=0.08)


def test_saturation_and_quantisation(airframe: Airframe) -> None:
    values = np.array([[500.0, -500.0, 1.0, 100.0, -100.0, 0.01]])
    fine = limited(values, airframe.left)[0]
    assert fine[0] == pytest.approx(157.0, abs=0.01)
    assert fine[1] == pytest.approx(-157.0, abs=0.01)
    assert fine[3] == pytest.approx(34.9, abs=0.01)
    assert abs(fine[2] - 1.0) <= 157.0 / 32768 / 2
    coarse = dataclasses.replace(airframe.left, source=dataclasses.replace(airframe.left.source, message="RAW_IMU"))
    steps = on_wire(np.array([[0.4 * 9.80665e-3, 0.0, 1.6 * 9.80665e-3, 0.0, 0.0, 0.0016]]), coarse)[0]
    np.testing.assert_allclose(steps, [0, 0, 2 * 9.80665e-3, 0, 0, 0.002], atol=1e-12)


def test_axes_that_are_not_sent_read_zero(airframe: Airframe) -> None:
    vertical = dataclasses.replace(airframe.left, sends="z")
    assert np.flatnonzero(limited(np.ones((1, 6)), vertical)[0]).tolist() == [2]


def test_the_vectorised_lowpass_is_the_autopilots_filter() -> None:
    rng = np.random.default_rng(0)
    values = rng.standard_normal((300, 6)) + 9.0
    out = lowpassed(values, 20.0, 40.0, 1000.0)
    np.testing.assert_allclose(out[:, :3], Biquad.lowpass(20.0, 1000.0).run(values[:, :3]), atol=1e-9)
    np.testing.assert_allclose(out[:, 3:], Biquad.lowpass(40.0, 1000.0).run(values[:, 3:]), atol=1e-9)
    np.testing.assert_array_equal(lowpassed(values, 0.0, 0.0, 1000.0), values)


def test_send_times_repeat_the_pattern_of_a_recorded_flight() -> None:
    times = send_times(3, 400.0, 0, 60_000_000_000, np.random.default_rng(0))
    steps = np.diff(times.tick_ns)
    assert set(steps.tolist()) == {2_500_000, 5_000_000}
    assert len(times.tick_ns) == pytest.approx(20_000, abs=2)
    assert np.all(np.diff(times.sent_ns) >= 0)
    assert np.all(times.sent_ns > times.tick_ns)


def test_node_stamps_lie_on_the_nodes_own_clock(flight: Flight) -> None:
    stream = flight.streams()[Station.LEFT]
    clock = flight.real.clocks[ClockName.NODE_LEFT]
    delays = [sent - (stamp - clock.epoch_ns) for sent, stamp in zip(stream.sent_boot_ns, stream.stamp_ns, strict=True)]
    slope, start = np.polyfit(stream.sent_boot_ns * 1e-9, np.array(delays) * 1e-9, 1)
    assert slope * 1e6 == pytest.approx(-clock.skew_ppm, abs=2.0)
    # half the averaging window, 0.15 ms of work, 0.05 ms of jitter
    assert start == pytest.approx(0.0007, abs=0.0001)


@given(st.integers(0, 10**14), st.floats(-100, 100))
def test_a_clock_runs_at_its_skew(t_ns: int, skew_ppm: float) -> None:
    clock = TrueClock(123_456, skew_ppm)
    gained = clock.from_boot(t_ns + 10**9) - clock.from_boot(t_ns)
    assert abs(gained - (10**9 + 1000 * skew_ppm)) <= 20


# ------------------------------------------------------------------------------------------ the wire


@pytest.mark.parametrize("message", ["HIGHRES_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3"])
@pytest.mark.parametrize("axes", [("x", "y", "z"), ("y", "-x", "z"), ("-z", "x", "-y")])
def test_pymavlink_reads_what_is_framed(message: str, axes: tuple[str, str, str]) -> None:
    values = np.array([[1.0, -2.0, -9.5, 0.25, -0.5, 0.125], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    source = Source(message, 200, ClockName.NODE_LEFT, axes=axes)
    form, sender, parser = inertial_format(message), FrameSender(200), mavlink.MAVLink(None)
    stamps = [1_234_567_891_000_000, 0]
    frames = [
        sender.raw(form.kind, stamped(form, t, rest)) for t, rest in zip(stamps, payloads(values, source), strict=True)
    ]
    first, second = parser.parse_buffer(b"".join(frames))
    assert (first.get_srcSystem(), first.get_srcComponent(), first.get_seq(), second.get_seq()) == (1, 200, 0, 1)
    stamp = first.time_usec * 1000 if hasattr(first, "time_usec") else first.time_boot_ms * 1_000_000
    assert stamp == stamps[0]
    accel, gyro = (1.0, 1.0) if message == "HIGHRES_IMU" else (9.80665e-3, 1e-3)
    sensor = np.array([first.xacc, first.yacc, first.zacc]) * accel
    rate = np.array([first.xgyro, first.ygyro, first.zgyro]) * gyro
    for body, entry in enumerate(axes):
        sign, axis = (-1 if entry.startswith("-") else 1), "xyz".index(entry[-1])
        assert sign * sensor[axis] == pytest.approx(values[0, body], abs=accel / 2 if accel < 1 else 1e-6)
        assert sign * rate[axis] == pytest.approx(values[0, 3 + body], abs=1e-6)


def test_a_message_that_cannot_be_sent_is_named() -> None:
    with pytest.raises(ConfigError, match="DEBUG_VECT"):
        inertial_format("DEBUG_VECT")


# ------------------------------------------------------------------------------------------ offline forms


def test_records_come_in_order_on_the_clocks_of_the_airframe(flight: Flight) -> None:
    records = list(flight_records(flight))
    arrivals = [record.received_host_ns for record in records]
    assert arrivals == sorted(arrivals)
    assert {type(record) for record in records} == {ImuBatch, TimesyncReply, VehicleState, AutopilotParameter}
    batches = [record for record in records if isinstance(record, ImuBatch)]
    rows = {station: sum(len(b.t_ns) for b in batches if b.station is station) for station in Station}
    assert rows[Station.LEFT] == pytest.approx(10_000, abs=10)
    assert rows[Station.ROOT] == pytest.approx(3_333, abs=10)
    for batch in batches:
        assert batch.clock is flight.airframe.sensor(batch.station).source.clock
        assert np.all(np.diff(batch.t_ns) >= 0)


def test_exchanges_bracket_the_true_offset(flight: Flight) -> None:
    for record in flight_records(flight):
        if isinstance(record, TimesyncReply):
            earliest, latest = record.sent_host_ns - HOST_EPOCH_NS, record.received_host_ns - HOST_EPOCH_NS
            if record.clock is ClockName.BOOT:
                assert earliest <= record.remote_ns <= latest
            else:
                clock = flight.real.clocks[record.clock]
                assert clock.from_boot(earliest) <= record.remote_ns <= clock.from_boot(latest)


def test_tables_hold_the_flight(airframe: Airframe, tmp_path: Path) -> None:
    flight = build_flight(airframe, 2, plan=still_plan(3.0), gust=GustKind.CALM, perturbed=False)
    paths = write_csv(flight, tmp_path / "lab")
    assert [path.name for path in paths] == ["accel.csv", "range.csv"]
    with paths[0].open() as file:
        table = list(csv.DictReader(file))
    times = np.array([float(row["t_s"]) for row in table])
    np.testing.assert_allclose(np.diff(times), 0.001, atol=1e-9)
    psi = 1.39 * 0.0149
    mean = {name: np.mean([float(row[name]) for row in table]) for name in table[0] if name != "t_s"}
    # biases of 0.02 m/s^2 stay
    assert mean["root_z_mps2"] == pytest.approx(-9.80665, abs=0.08)
    assert mean["left_y_mps2"] == pytest.approx(-9.80665 * math.sin(psi), abs=0.08)
    assert mean["right_y_mps2"] == pytest.approx(+9.80665 * math.sin(psi), abs=0.08)
    with paths[1].open() as file:
        ranges = list(csv.DictReader(file))
    # up-bend diverges by psi of both wings: 1/Z' = 1/Z + theta/B, so 60 m reads short
    expected = 1 / (1 / 60 + 2 * psi / 1.98)
    measured = np.mean([float(row["range_m"]) for row in ranges])
    assert measured == pytest.approx(expected, rel=0.005)
    assert {float(row["reference_m"]) for row in ranges} == {60.0}


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_airframes())
def test_every_airframe_flies(name: str) -> None:
    flight = build_flight(load_airframe(name), 1, 3.0)
    for station, stream in flight.streams().items():
        sensor = flight.airframe.sensor(station)
        rate_hz = len(stream.stamp_ns) / flight.duration_s
        # whole milliseconds on the autopilot, its own clock on a node
        assert rate_hz == pytest.approx(sensor.rate_hz, rel=0.05)
        assert np.all(np.isfinite(stream.values))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("baseline-error", {"error_m": 0.12}),
        ("focal-error", {"ratio": 0.05}),
        ("convergence-offset", {"toe_rad": 0.01}),
        ("camera-asymmetry", {"ratio": 0.1, "both": 0.1}),
        ("exposure-delay", {"delay_s": 0.02}),
        ("mount-lag", {"lag_s": 0.01}),
        ("mount-resonance", {"softness_s2": 1e-4}),
        ("rolling-shutter", {"readout2_s2": 1e-3}),
        ("exposure-jitter", {"jitter2_us2": 1e8}),
    ],
)
def test_ranges_of_a_table_show_an_effect_on_the_cameras(name: str, values: dict[str, float], tmp_path: Path) -> None:
    """Matching noise is that of the seed: disparities with and without differ by what is hidden alone."""
    airframe = load_airframe("nadir-2m")
    disparity_px = []
    for folder, effects in (("without", ()), ("with", (NamedEffect(name, values),))):
        flight = build_flight(airframe, 5, 4.0, perturbed=False, effects=effects)
        write_csv(flight, tmp_path / folder)
        table = np.loadtxt(tmp_path / folder / "range.csv", delimiter=",", skiprows=1)
        disparity_px.append(table[:, 3])
    changed = disparity_px[1] - disparity_px[0]
    assert airframe.left_camera is not None
    focal_px = airframe.left_camera.focal_px.value
    if name == "convergence-offset":
        assert changed == pytest.approx(focal_px * 0.01, rel=0.02)
    elif name == "focal-error":
        assert np.median(changed / disparity_px[0]) == pytest.approx(0.05, abs=0.02)
    else:
        assert np.std(changed) + abs(np.mean(changed)) > 0.1


@pytest.mark.parametrize("name", ["saturation", "quantisation", "dropout-jitter"])
def test_samples_of_a_table_show_their_defect_through_noise_and_low_pass(name: str, tmp_path: Path) -> None:
    values = {"saturation": {"inverse_s2pm": 0.1}, "quantisation": {"step_mps2": 0.5}, "dropout-jitter": {"lost": 0.1}}
    airframe = load_airframe("nadir-2m")
    write_csv(build_flight(airframe, 5, 4.0, perturbed=False, effects=(NamedEffect(name, values[name]),)), tmp_path)
    with (tmp_path / "accel.csv").open(encoding="utf-8") as file:
        rows = [[float(row[key]) for key in ("t_s", "left_z_mps2", "left_x_mps2")] for row in csv.DictReader(file)]
    t_s, force_z, force_x = np.array(rows).T
    if name == "dropout-jitter":  # in steps as coarse as the sensor's, repeated values alone are no evidence
        held = (np.diff(force_z) == 0.0) & (np.diff(force_x) == 0.0)
        assert np.mean(held) == pytest.approx(0.1, abs=0.03)
    else:
        assert name in [entry.name for entry in find_sample_defects(t_s, force_z, airframe.left)]
