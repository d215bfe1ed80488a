"""A node without TIMESYNC, aligned by the rigid motion: lag and sigma against truth, and through the whole pipeline."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from companion.core import pipeline
from companion.core.clock.bank import ClockBank
from companion.core.clock.motion_alignment import (
    LARGEST_SIGMA_S,
    SIGMAS,
    Lag,
    MotionAlignment,
    carried,
    heave_lag,
    lag_between,
    lowpass_delay_s,
)
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import ClockName, ClockState, Floats, ImuBatch, Notice, Rejected, Station, TimesyncReply
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS, flight_records
from sitl_tests.still_plan import still_plan
from sitl_tests.unit.pipeline_flight import in_order, run

NODE = ClockName.NODE_LEFT
SPAN_S, MOST_S = 12.0, 0.06
HEAVE_S, SHIFT_S = 24.0, 0.02


def turning(t_s: Floats, seed: int) -> Floats:
    """Rates of an aircraft that manoeuvres: sums of slow sines, known at every instant."""
    rng = np.random.default_rng(seed)
    w, phase = rng.uniform(0.5, 6.0, (3, 5)), rng.uniform(0, 2 * np.pi, (3, 5))
    return np.stack([0.15 * np.sin(np.outer(t_s, w[k]) + phase[k]).sum(1) for k in range(3)], 1)


def pair(seed: int, lag_s: float) -> tuple[Floats, Floats, Floats, Floats]:
    """A node that is late, tilted, scaled, biased and shaken by its wing, and a root with noise."""
    rng = np.random.default_rng([seed, 1])
    node_s, root_s = np.arange(-0.2, SPAN_S + 0.2, 0.001), np.arange(-0.2, SPAN_S + 0.2, 0.003)
    tilt = np.array([[0.0, 0.01, -0.02], [-0.01, 0.0, 0.03], [0.02, -0.03, 0.0]])
    node = turning(node_s - lag_s, seed) @ (np.eye(3) + tilt).T * 1.01 + rng.normal(0, 0.02, 3)
    shake = rng.standard_normal(len(node_s))
    w, decay = 2 * np.pi * 5.0, math.exp(-0.03 * 2 * np.pi * 5.0 * 0.001)
    rate = np.zeros(len(node_s))
    for k in range(2, len(rate)):  # a mode of 5 Hz in the roll rate
        rate[k] = 2 * decay * math.cos(w * 0.001) * rate[k - 1] - decay**2 * rate[k - 2] + shake[k]
    node[:, 0] += 0.2 * rate / rate.std()
    node += rng.normal(0, 0.002, node.shape)
    root = turning(root_s, seed) + rng.normal(0, 0.002, (len(root_s), 3))
    return node_s, node, root_s, root


@pytest.mark.parametrize(
    ("lag_s", "axes"), [(0.0, (0, 1, 2)), (0.0123, (0, 1, 2)), (0.05, (0, 1, 2)), (0.0142, (0,)), (0.0142, (1, 2))]
)
def test_the_lag_is_found_beside_bending_tilt_scale_and_bias_and_its_sigma_is_honest(
    lag_s: float, axes: tuple[int, ...]
) -> None:
    """Also by the axes that a node has: those that it lacks, which read 0, gave the nearest 4 ms and no sigma."""
    z = []
    for seed in range(12):
        node_s, node, root_s, root = pair(seed, lag_s)
        node[:, [k for k in range(3) if k not in axes]] = 0.0
        lag = lag_between(node_s, node, root_s, root, SPAN_S, MOST_S, axes)
        assert lag is not None
        assert lag.sigma_s < (0.001 if len(axes) > 1 else 0.02), "a roll rate alone is shaken by the bending"
        z.append((lag.lag_s - lag_s) / lag.sigma_s)
    assert np.max(np.abs(z)) < SIGMAS
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.8


def test_an_aircraft_at_rest_cannot_be_aligned() -> None:
    rng, node_s, root_s = np.random.default_rng(2), np.arange(-0.2, 12.2, 0.001), np.arange(-0.2, 12.2, 0.003)
    node, root = (rng.normal(0, 0.002, (len(t_s), 3)) for t_s in (node_s, root_s))
    lag = lag_between(node_s, node, root_s, root, SPAN_S, MOST_S)
    assert lag is None or lag.sigma_s > 0.0025
    assert lag_between(node_s, 0 * node, root_s, 0 * root, SPAN_S, MOST_S) is None


def test_the_delay_of_a_low_pass_is_that_of_its_slope_at_zero() -> None:
    cutoff, f = 20.0, 0.01
    s = 1j * f / cutoff
    phase = np.angle(1 / (1 + math.sqrt(2) * s + s * s))
    assert lowpass_delay_s(cutoff) == pytest.approx(-phase / (2 * math.pi * f), rel=1e-4)
    assert lowpass_delay_s(0.0) == 0.0


def test_arrivals_alone_bound_the_clock_by_the_longest_delay() -> None:
    alignment = MotionAlignment(NODE)
    alignment.add_node(ImuBatch(Station.LEFT, NODE, np.array([5_000_000_000]), np.zeros((1, 6)), 63, 9_000_000_000))  # type: ignore[arg-type]
    unknown = ClockBank().state(NODE)
    (exchange,) = alignment.exchanges(9_000_000_000, unknown)
    # the sample was taken 0 to 60 ms before it arrived: so 60 ms less was read 0 to 120 ms before
    assert exchange == TimesyncReply(NODE, 9_000_000_000 - 120_000_000, 5_000_000_000 - 60_000_000, 9_000_000_000)
    assert list(alignment.exchanges(9_100_000_000, unknown)) == []


# ------------------------------------------------------------------------------------------ heave instead of rates


def heave(flight: Flight, station: Station, from_s: float) -> Lag | None:
    """Lag by the vertical specific force of a wing tip, which is 0: true stamps, known filters."""
    streams, sensor, clock = flight.streams(), flight.airframe.sensor(station), flight.real.clocks[node_clock(station)]
    stream, root = streams[station], streams[Station.ROOT]
    node_s = (stream.stamp_ns - clock.epoch_ns) / (1 + clock.skew_ppm * 1e-6) * 1e-9 - from_s + SHIFT_S
    # an autopilot stamps the sending, 0.1 to 0.6 ms after the loop's tick
    late_s = 0.00035 + lowpass_delay_s(flight.airframe.root.lowpass_accel_hz)
    root_s: Floats = root.stamp_ns * np.float64(1e-9) - late_s - from_s
    edges = np.arange(0.5, HEAVE_S - MOST_S - 0.5, 0.02)
    means = np.stack([cell_means(root_s, column, edges) for column in root.values.T], axis=1)
    lever_m = np.subtract(sensor.position_m, flight.airframe.root.position_m)
    rigid = carried(means[:, :3], means[:, 3:], lever_m)
    return heave_lag(node_s, stream.values[:, 2:3], rigid, HEAVE_S, MOST_S)


def node_clock(station: Station) -> ClockName:
    return {Station.LEFT: ClockName.NODE_LEFT, Station.RIGHT: ClockName.NODE_RIGHT}[station]


def cell_means(t_s: Floats, values: Floats, edges: Floats) -> Floats:
    """Averages over cells, by interpolating the samples ten times as finely."""
    fine = np.arange(edges[0], edges[-1], 0.002) + 0.001
    return np.asarray(np.interp(fine, t_s, values)[: 10 * (len(edges) - 1)].reshape(-1, 10).mean(axis=1))


@pytest.mark.long
def test_heave_and_roll_align_a_tip_without_gyro_and_the_sigma_is_honest() -> None:
    """Perturbed wings that bend, in gusts, rolls and pull-ups; most are used, and the others said to be too bad."""
    estimates = []
    for seed in range(20, 32):
        flight = build_flight(load_airframe("nadir-2m"), seed, 37.0)
        estimates += [heave(flight, station, 12.0) for station in (Station.LEFT, Station.RIGHT)]
    lags = [lag for lag in estimates if lag is not None]
    z = np.array([(lag.lag_s - SHIFT_S) / lag.sigma_s for lag in lags])
    used = [lag.lag_s - SHIFT_S for lag in lags if lag.sigma_s <= LARGEST_SIGMA_S]
    rms_s = float(np.sqrt(np.mean(np.square(used))))
    print(f"{len(used)} of {len(estimates)} used, {1e3 * rms_s:.2f} ms rms; {np.sqrt(np.mean(z**2)):.2f} sigma")
    assert len(used) > len(estimates) / 2
    assert rms_s < LARGEST_SIGMA_S
    assert np.abs(z).max() < 3.0
    assert 0.3 < np.sqrt(np.mean(z**2)) < 1.5


@pytest.mark.slow
def test_a_wing_that_flies_straight_on_tells_nothing_by_its_heave() -> None:
    flight = build_flight(load_airframe("nadir-2m"), 5, 37.0, plan=still_plan(37.0))
    lag = heave(flight, Station.LEFT, 12.0)
    assert lag is None or lag.sigma_s > LARGEST_SIGMA_S


def test_what_a_rigid_wing_feels_is_force_and_lever_arm() -> None:
    """A roll acceleration of 2 rad/s^2, 1 m out to the right, where it goes down: 2 m/s^2 along z; -p^2 along y."""
    t = np.arange(0, 1, 0.02)
    rates = np.stack([2.0 * t, 0 * t, 0 * t], axis=1)
    felt = carried(np.zeros((len(t), 3)), rates, np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(felt[:, 2], 2.0, atol=1e-9)
    np.testing.assert_allclose(felt[:, 1], -((2.0 * t) ** 2), atol=1e-9)


# ------------------------------------------------------------------------------------------ in flight


class Listener:
    """Stands in for the tracker, which is not what is looked at here: notes whose samples came, and how far off."""

    def __init__(self, *_: Any) -> None:
        self.heard: list[ImuBatch] = []

    def add(self, batch: ImuBatch) -> list[Rejected]:
        self.heard.append(batch)
        return []

    def process_until(self, now_host_ns: int) -> None:
        """No state of the wing."""

    def work(self) -> None:
        """Nothing is spread over turns."""

    def describe(self) -> None:
        """Nor anything to tell of it."""

    @property
    def complaints(self) -> list[str]:
        """Nor anything wrong."""
        return []


def deaf_records(flight: Flight) -> list[Any]:
    """The flight's records but for the left node's answers."""
    return [r for r in flight_records(flight) if not (isinstance(r, TimesyncReply) and r.clock is NODE)]


def without_cameras(airframe: Airframe) -> Airframe:
    return dataclasses.replace(airframe, left_camera=None, right_camera=None)


def clock_errors(flight: Flight, all_states: list[ClockState]) -> tuple[list[int], list[ClockState]]:
    """Error [ns] of every state of the left node's clock, and the states."""
    clock, states = flight.real.clocks[NODE], [state for state in all_states if state.clock is NODE]
    true = [clock.from_boot(state.at_host_ns - HOST_EPOCH_NS) - state.at_host_ns for state in states]
    return [state.offset_ns - offset for state, offset in zip(states, true, strict=True)], states


@pytest.mark.slow
def test_in_flight_a_deaf_node_joins_with_a_true_bound_and_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "WingTracker", Listener)
    flight = build_flight(load_airframe("nadir-2m"), 4, 26.0)
    driven = run(in_order(deaf_records(flight)), airframe=without_cameras(flight.airframe))
    (notice,) = [entry for entry in driven.of(Notice) if "aligned by motion" in entry.text]
    assert "node_left answers no TIMESYNC" in notice.text
    errors, states = clock_errors(flight, driven.of(ClockState, since_s=19.0))
    assert len(states) >= 5
    assert all(state.synced for state in states)
    bounds = [state.bound_ns for state in states]
    print(f"error {np.abs(errors).max() / 1e6:.2f} ms at most, bound {np.median(bounds) / 1e6:.2f} ms")
    assert all(abs(error) <= bound for error, bound in zip(errors, bounds, strict=True))
    assert np.abs(errors).max() < 1.0e6
    tracker: Any = driven.state.tracker
    assert {batch.station for batch in tracker.heard} == set(Station), "the node's samples reach the tracker"
    assert {batch.clock for batch in tracker.heard} == {ClockName.HOST}
    assert driven.state.airframe.left.time_offset_sigma_s >= flight.airframe.left.time_offset_sigma_s
    assert set(driven.state.unsynced_nodes._alignments) == {NODE}, "the right node answers, and is left alone"


@pytest.mark.slow
def test_in_flight_a_deaf_node_without_gyro_joins_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "WingTracker", Listener)
    airframe = load_airframe("nadir-2m")
    airframe = dataclasses.replace(airframe, left=dataclasses.replace(airframe.left, sends="xyz"))
    flight = build_flight(airframe, 6, 42.0)
    driven = run(in_order(deaf_records(flight)), airframe=without_cameras(flight.airframe))
    assert any("aligned by motion" in entry.text for entry in driven.of(Notice))
    errors, states = clock_errors(flight, driven.of(ClockState, since_s=34.0))
    assert len(states) >= 3
    assert all(state.synced for state in states)
    assert all(abs(error) <= state.bound_ns for error, state in zip(errors, states, strict=True))
    assert np.abs(errors).max() < 3.0e6
    assert driven.state.airframe.left.time_offset_sigma_s >= 0.0006
