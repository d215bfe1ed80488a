"""Nodes whose samples come late: what answers made known stays, and what arrivals tell is never more than they can."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from companion.core import pipeline
from companion.core.pipeline import PipelineState, start, step
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Axis, ClockName, Floats, ImuBatch, Notice, Record, Reject, Station, Tick, TimesyncReply
from sitl_tests.unit.test_clock_alignment import Listener, turning, without_cameras

NODE = ClockName.NODE_LEFT
S, MS = 1_000_000_000, 1_000_000
START_NS, OFFSET_NS = 1_000 * S, 77 * S
BATCH_S, SAMPLE_S = 0.02, 0.005
ALL_AXES = Axis.X | Axis.Y | Axis.Z | Axis.GYRO

Delay = Callable[[float], float]  # of the node's samples, ms, at a time, s


class Restarts(Listener):
    """Counts as well what the tracker hears of restarts."""

    restarts = 0

    def clock_restarted(self, _: Any) -> None:
        self.restarts += 1


@dataclass
class Flown:
    """Rows are of the node's batches as they arrive: time, s, error and bound, ns; both nan where one is refused."""

    state: PipelineState
    rows: list[tuple[float, float, float]] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)

    def since(self, from_s: float) -> tuple[Floats, Floats]:
        """Errors and bounds from a time on."""
        rows = np.array([row for row in self.rows if row[0] >= from_s])
        return rows[:, 1], rows[:, 2]


def samples(duration_s: float, delay_ms: Delay, seed: int) -> list[tuple[int, Record]]:
    """Rates of an aircraft that manoeuvres: the node's, late and jittery, and the root's in host time."""
    random, grid_s = np.random.default_rng(seed), np.arange(-1.0, duration_s + 0.5, SAMPLE_S)
    rates, inputs = turning(grid_s, seed), []
    for begin_s in np.arange(0.0, duration_s, BATCH_S):
        t_s = begin_s + np.arange(0.0, BATCH_S, SAMPLE_S)
        t_ns = START_NS + np.round(t_s * 1e9).astype(np.int64)
        at = np.stack([np.interp(t_s, grid_s, axis) for axis in rates.T], axis=1)
        late_ms = delay_ms(begin_s) + 2.0 * random.random()
        for station, clock, offset_ns, ms in (
            (Station.LEFT, NODE, OFFSET_NS, late_ms),
            (Station.ROOT, ClockName.HOST, 0, 8.0),
        ):
            values = np.hstack([np.zeros((len(t_s), 3)), at + random.normal(0, 0.002, at.shape)])
            received_ns = int(t_ns[-1] + ms * MS)
            inputs.append((received_ns, ImuBatch(station, clock, t_ns + offset_ns, values, ALL_AXES, received_ns)))
    return inputs


def answers(times_s: Floats, seed: int) -> list[tuple[int, Record]]:
    """Answers of a quick link, 3 ms there and 0.3 ms back."""
    random, inputs = np.random.default_rng([seed, 1]), []
    for sent_ns in START_NS + np.round(times_s * 1e9).astype(np.int64):
        there_ns, back_ns = ((3.0, 0.3) * np.array(MS) + random.integers(0, 2 * MS, 2)).astype(np.int64)
        received_ns = int(sent_ns + there_ns + back_ns)
        reply = TimesyncReply(NODE, int(sent_ns), int(sent_ns + there_ns) + OFFSET_NS, received_ns)
        inputs.append((received_ns, reply))
    return inputs


def fly(duration_s: float, delay_ms: Delay, answered_s: Floats, seed: int = 4) -> Flown:
    airframe = without_cameras(load_airframe("nadir-2m"))
    quick: dict[str, Any] = {"lowpass_gyro_hz": 0.0, "lowpass_accel_hz": 0.0}  # no filter that this flight would need
    root, node = (dataclasses.replace(each, **quick) for each in (airframe.root, airframe.left))
    flown = Flown(start(dataclasses.replace(airframe, root=root, left=node), Settings()))
    ticks: list[tuple[int, Record]] = [
        (at_ns, Tick(at_ns)) for at_ns in range(START_NS, START_NS + round(duration_s * S), 20 * MS)
    ]
    inputs = samples(duration_s, delay_ms, seed) + answers(answered_s, seed) + ticks
    for at_ns, record in sorted(inputs, key=lambda each: each[0]):
        flown.state, outputs = step(flown.state, record)
        flown.notices += [entry.text for entry in outputs if isinstance(entry, Notice)]
        if isinstance(record, ImuBatch) and record.clock is NODE:
            converted = flown.state.clocks.to_host(NODE, record.t_ns, record.received_host_ns)
            error, bound = np.nan, np.nan
            if not isinstance(converted, Reject):
                error, bound = float(np.abs(converted[0] - (record.t_ns - OFFSET_NS)).max()), float(converted[1])
            flown.rows.append((1e-9 * (at_ns - START_NS), error, bound))
    return flown


@pytest.fixture(autouse=True)
def _no_tracker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "WingTracker", Restarts)
    monkeypatch.setattr("companion.core.pipeline_state.WingTracker", Restarts)


@pytest.mark.parametrize("delay_ms", [10.0, 70.0, 90.0])
def test_a_pause_of_answers_costs_no_sample_however_late_samples_come(delay_ms: float) -> None:
    """Arrivals later than 60 ms contradicted the answers: the clock began anew, and half a minute was refused."""
    answered_s = np.r_[0.0:12.0:0.1, 15.5:30.0:0.1]
    flown = fly(30.0, lambda _: delay_ms, answered_s)
    error, bound = flown.since(10.0)
    assert (error <= bound).all(), "none refused, none beyond its bound"
    assert flown.state.clocks.restarts(NODE) == 0
    assert not any("aligned" in text for text in flown.notices)


def test_a_node_that_falls_silent_for_good_is_aligned_once_its_clock_is_no_longer_good() -> None:
    flown = fly(130.0, lambda _: 10.0, np.arange(0.0, 20.0, 0.1))
    error, bound = flown.since(10.0)
    assert (error[np.isfinite(error)] <= bound[np.isfinite(error)]).all()
    assert np.isfinite(flown.since(100.0)[0]).all()
    assert NODE in flown.state.unsynced_nodes.aligned
    assert sum("aligned by motion" in text for text in flown.notices) == 1


DELAYS_MS: dict[str, Delay] = {
    "rises by 50": lambda t_s: 10.0 + 50.0 * (t_s >= 30.0),
    "rises by 80": lambda t_s: 10.0 + 80.0 * (t_s >= 30.0),
    "rises at once": lambda t_s: 10.0 + 50.0 * (t_s >= 14.0),
    "rises slowly": lambda t_s: 10.0 + 2.5 * min(max(t_s - 25.0, 0.0), 20.0),
    "falls": lambda t_s: 55.0 - 45.0 * (t_s >= 30.0),
}


@pytest.mark.parametrize("name", DELAYS_MS)
def test_a_link_that_becomes_slower_or_quicker_moves_no_stamp_beyond_its_bound(name: str) -> None:
    """Samples of a slower link were stamped late by what it had become slower, with a bound of some 3 ms."""
    flown = fly(58.0, DELAYS_MS[name], np.zeros(0))
    error, bound = flown.since(0.0)
    joined = np.isfinite(error)
    assert (error[joined] <= bound[joined]).all()
    assert np.isfinite(flown.since(26.0)[0]).all(), "nor is a sample refused"
    assert flown.state.clocks.restarts(NODE) == 0


def test_a_link_too_slow_for_an_alignment_does_not_spoil_what_is_known() -> None:
    """Half a minute after it has become slow nothing tells how old a sample is: the clock is used while it is good."""
    flown = fly(85.0, DELAYS_MS["rises by 80"], np.zeros(0))
    error, bound = flown.since(0.0)
    joined = np.isfinite(error)
    assert (error[joined] <= bound[joined]).all()
    assert not joined[-100:].any()
    assert flown.state.clocks.restarts(NODE) == 0
