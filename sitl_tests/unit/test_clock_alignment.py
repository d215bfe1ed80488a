"""A node without TIMESYNC, aligned by the rigid motion: lag and sigma against truth, and through the whole pipeline."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from companion.core import pipeline
from companion.core.clock.alignment import SIGMAS, Alignment, lag_between, lowpass_delay_s
from companion.params.files import load_airframe
from companion.records import (
    ClockName,
    ClockState,
    Floats,
    ImuBatch,
    Notice,
    Rejected,
    Station,
    TimesyncReply,
)
from companion.sim.flight import build_flight
from companion.sim.offline import HOST_EPOCH_NS, flight_records
from sitl_tests.unit.pipeline_flight import in_order, run

NODE = ClockName.NODE_LEFT
SPAN_S, MOST_S = 12.0, 0.06


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


@pytest.mark.parametrize("lag_s", [0.0, 0.0123, 0.05])
def test_the_lag_is_found_beside_bending_tilt_scale_and_bias_and_its_sigma_is_honest(lag_s: float) -> None:
    z = []
    for seed in range(12):
        found = lag_between(*pair(seed, lag_s), SPAN_S, MOST_S)
        assert found is not None
        assert found.sigma_s < 0.001
        z.append((found.lag_s - lag_s) / found.sigma_s)
    assert np.max(np.abs(z)) < SIGMAS
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.8


def test_an_aircraft_at_rest_cannot_be_aligned() -> None:
    rng, node_s, root_s = np.random.default_rng(2), np.arange(-0.2, 12.2, 0.001), np.arange(-0.2, 12.2, 0.003)
    node, root = (rng.normal(0, 0.002, (len(t_s), 3)) for t_s in (node_s, root_s))
    found = lag_between(node_s, node, root_s, root, SPAN_S, MOST_S)
    assert found is None or found.sigma_s > 0.0025
    assert lag_between(node_s, 0 * node, root_s, 0 * root, SPAN_S, MOST_S) is None


def test_the_delay_of_a_low_pass_is_that_of_its_slope_at_zero() -> None:
    cutoff, f = 20.0, 0.01
    s = 1j * f / cutoff
    phase = np.angle(1 / (1 + math.sqrt(2) * s + s * s))
    assert lowpass_delay_s(cutoff) == pytest.approx(-phase / (2 * math.pi * f), rel=1e-4)
    assert lowpass_delay_s(0.0) == 0.0


def test_arrivals_alone_bound_the_clock_by_the_longest_delay() -> None:
    alignment = Alignment(NODE)
    alignment.add_node(ImuBatch(Station.LEFT, NODE, np.array([5_000_000_000]), np.zeros((1, 6)), 63, 9_000_000_000))  # type: ignore[arg-type]
    (exchange,) = alignment.exchanges(9_000_000_000)
    assert exchange == TimesyncReply(NODE, 9_000_000_000 - 60_000_000, 5_000_000_000, 9_000_000_000)
    assert list(alignment.exchanges(9_100_000_000)) == []


# ------------------------------------------------------------------------------------------ in flight


class Listener:
    """Stands in for the tracker, which is not what is looked at here: notes whose samples came, and how far off."""

    def __init__(self, *_: Any) -> None:
        self.heard: list[ImuBatch] = []

    def add(self, batch: ImuBatch) -> list[Rejected]:
        self.heard.append(batch)
        return []

    def advance(self, now_host_ns: int) -> None:
        """No state of the wing."""


@pytest.mark.slow
def test_in_flight_a_deaf_node_joins_with_a_true_bound_and_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "WingTracker", Listener)
    flight = build_flight(load_airframe("nadir-2m"), 4, 26.0)
    blind = dataclasses.replace(flight.airframe, left_camera=None, right_camera=None)
    records = [
        record for record in flight_records(flight) if not (isinstance(record, TimesyncReply) and record.clock is NODE)
    ]
    driven = run(in_order(records), airframe=blind)
    (notice,) = [entry for entry in driven.of(Notice) if "aligned by motion" in entry.text]
    assert "node_left answers no TIMESYNC" in notice.text
    clock = flight.real.clocks[NODE]
    states = [state for state in driven.of(ClockState, since_s=19.0) if state.clock is NODE]
    assert len(states) >= 5
    assert all(state.synced for state in states)
    errors = [
        state.offset_ns - (clock.from_boot(state.at_host_ns - HOST_EPOCH_NS) - state.at_host_ns) for state in states
    ]
    bounds = [state.bound_ns for state in states]
    print(f"error {np.abs(errors).max() / 1e6:.2f} ms at most, bound {np.median(bounds) / 1e6:.2f} ms")
    assert all(abs(error) <= bound for error, bound in zip(errors, bounds, strict=True))
    assert np.abs(errors).max() < 1.0e6
    tracker: Any = driven.state.tracker
    assert {batch.station for batch in tracker.heard} == set(Station), "the node's samples reach the tracker"
    assert {batch.clock for batch in tracker.heard} == {ClockName.HOST}
    assert driven.state.airframe.left.time_offset_sigma_s >= flight.airframe.left.time_offset_sigma_s
    assert set(driven.state.alignments) == {NODE}, "the right node answers, and is left alone"
