"""Lying samples, bursts and blows: the deflection stays within what is said of it, and trust does not pause."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.core.pipeline import PipelineState, start, step
from companion.core.tracking.contradiction import NIS_LIMIT
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ImuBatch, ModeEstimate, OutputRecord, Reject, Rejected, Station, Tick
from companion.sim.flight.aircraft import Jolt, demo_plan
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS, flight_records

STRUCK_S, END_S = 13.0, 17.0
LAG_NS = 150_000_000
LIES = (-4.0, 2.0, 8.0, 100.0, -100.0, 1e6, -1e20, 1e30)
Alter = Callable[[ImuBatch, float], None]


@dataclass
class Flown:
    """Every 20 ms: relative slope's error and sigma (rad), NIS, reason of distrust."""

    t_s: list[float] = dataclasses.field(default_factory=list)
    error: list[float] = dataclasses.field(default_factory=list)
    sigma: list[float] = dataclasses.field(default_factory=list)
    nis: list[float] = dataclasses.field(default_factory=list)
    distrust: list[Reject | None] = dataclasses.field(default_factory=list)
    refused: list[Rejected] = dataclasses.field(default_factory=list)

    def check(self) -> None:
        """Nothing is out of three sigmas, no NIS is above its limit and nothing costs trust."""
        ratio = np.abs(np.array(self.error)) / np.array(self.sigma)
        assert len(ratio) > 100
        assert np.all(np.isfinite(ratio))
        assert ratio.max() < 3.0
        assert max(self.nis) < NIS_LIMIT
        assert set(self.distrust) == {None}


class Following:
    """The pipeline on a simulated flight, without cameras."""

    def __init__(self, flight: Flight) -> None:
        self.flight, self.state = flight, start(flight.airframe, Settings())
        self.state.scheduling = self.state.correction = None
        self.records = list(flight_records(flight))
        self.at, self.now_ns = 0, HOST_EPOCH_NS

    def fly(self, until_s: float, alter: Alter | None = None, flown: Flown | None = None) -> Flown:
        flown = flown or Flown()
        end_ns = HOST_EPOCH_NS + round(until_s * 1e9)
        while self.records[self.at].received_host_ns <= end_ns:
            record = self.records[self.at]
            self.at += 1
            while self.now_ns <= record.received_host_ns:
                self._take(Tick(self.now_ns), flown)
                self._look(flown)
                self.now_ns += 20_000_000
            if alter is not None and isinstance(record, ImuBatch):
                record = dataclasses.replace(record, values=record.values.copy())
                alter(record, (record.received_host_ns - HOST_EPOCH_NS) * 1e-9)
            self._take(record, flown)
        return flown

    def _take(self, record: object, flown: Flown) -> None:
        out: list[OutputRecord] = step(self.state, record)[1]  # type: ignore[arg-type]
        flown.refused += [each for each in out if isinstance(each, Rejected)]

    def _look(self, flown: Flown) -> None:
        state: PipelineState = self.state
        bend = state.tracker.smooth(self.now_ns - LAG_NS)
        if isinstance(bend, Reject):
            return
        truth = self.flight.truth.at(bend.t_host_ns - HOST_EPOCH_NS)
        flown.t_s.append((self.now_ns - HOST_EPOCH_NS) * 1e-9)
        flown.error.append(float(bend.slope_rad.sum() - truth.slope_rad.sum()))
        flown.sigma.append(float(np.sqrt(bend.covariance[4:, 4:].sum())))
        flown.nis.append(state.tracker.nis)
        flown.distrust.append(state.tracker.distrust)


def _lie(station: Station, column: int, value: float) -> Alter:
    """Change one sample at the instant of the blow: by a value that it may have, or to one that it never has."""
    waiting = [True]

    def alter(batch: ImuBatch, t_s: float) -> None:
        if batch.station is station and t_s >= STRUCK_S and waiting:
            waiting.clear()
            batch.values[0, column] = value + (batch.values[0, column] if abs(value) < 50.0 else 0.0)

    return alter


def _burst(station: Station, columns: tuple[int, ...], amplitude: float) -> Alter:
    rng, since_ns = np.random.default_rng(5), []

    def alter(batch: ImuBatch, t_s: float) -> None:
        if batch.station is not station or t_s < STRUCK_S:
            return
        since_ns.append(int(batch.t_ns[0]))
        within = batch.t_ns - since_ns[0] < 20_000_000
        for column in columns:
            batch.values[within, column] += rng.uniform(-amplitude, amplitude, int(within.sum()))

    return alter


@pytest.fixture(scope="module")
def followed() -> Following:
    """Tracked until just before the blow; each test goes on with a copy."""
    following = Following(build_flight(load_airframe("nadir-2m"), 6, END_S + 1.0))
    following.fly(STRUCK_S - 0.05)
    return following


def _copied(following: Following) -> Following:
    other = copy.copy(following)
    other.state = copy.deepcopy(following.state)
    return other


@pytest.mark.slow
@pytest.mark.parametrize("value", LIES)
@pytest.mark.parametrize("station", [Station.ROOT, Station.LEFT])
def test_one_lying_sample_changes_nothing_that_matters(followed: Following, station: Station, value: float) -> None:
    flown = _copied(followed).fly(END_S, _lie(station, 2, value))
    flown.check()
    reasons = {record.reason: record.count for record in flown.refused}
    assert reasons == {Reject.LAPSED if abs(value) <= 100.0 else Reject.BEYOND_RANGE: 1}


@pytest.mark.slow
@pytest.mark.parametrize("value", [0.5, 10.0])
@pytest.mark.parametrize("station", [Station.ROOT, Station.RIGHT])
def test_one_lying_rate_changes_nothing_that_matters(followed: Following, station: Station, value: float) -> None:
    _copied(followed).fly(END_S, _lie(station, 3, value)).check()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("station", "columns", "amplitude"),
    [
        (Station.ROOT, (2,), 5.0),
        (Station.ROOT, (0, 1, 2), 5.0),
        (Station.ROOT, (3, 4, 5), 0.5),
        (Station.LEFT, (2,), 5.0),
        (Station.LEFT, (0, 1, 2, 3, 4, 5), 5.0),
        (Station.RIGHT, (3, 4, 5), 0.5),
    ],
)
def test_a_burst_of_20_ms_costs_no_trust(
    followed: Following, station: Station, columns: tuple[int, ...], amplitude: float
) -> None:
    _copied(followed).fly(END_S, _burst(station, columns, amplitude)).check()


@pytest.mark.slow
@pytest.mark.parametrize(
    "peak_mps2", [pytest.param(1.0, marks=pytest.mark.long), 3.0, pytest.param(10.0, marks=pytest.mark.long), -10.0]
)
def test_a_blow_that_the_wing_answers_costs_no_trust(peak_mps2: float) -> None:
    plan = dataclasses.replace(demo_plan(END_S + 1.0), jolts=(Jolt(STRUCK_S, peak_mps2),))
    following = Following(build_flight(load_airframe("nadir-2m"), 6, END_S + 1.0, plan=plan))
    following.fly(STRUCK_S - 0.05)
    following.fly(END_S).check()


@pytest.mark.long
@pytest.mark.parametrize("seed", [7, 8])
def test_a_blow_that_no_gust_explains_leaves_the_modes_as_they_are_without_it(seed: int) -> None:
    def modes(peak_mps2: float) -> tuple[ModeEstimate, ModeEstimate]:
        plan = dataclasses.replace(demo_plan(STRUCK_S + 9.0), jolts=(Jolt(STRUCK_S, peak_mps2),))
        following = Following(build_flight(load_airframe("nadir-2m"), seed, STRUCK_S + 9.0, plan=plan))
        flown = following.fly(STRUCK_S + 8.0)
        assert flown.distrust[-1] is None
        described = following.state.tracker.describe()
        assert described is not None
        return described.symmetric, described.antisymmetric

    for calm, struck in zip(modes(0.0), modes(80.0), strict=True):
        sigma_hz = np.hypot(calm.frequency_sigma_hz, struck.frequency_sigma_hz)
        assert abs(struck.frequency_hz - calm.frequency_hz) < 3.0 * sigma_hz
        assert struck.frequency_sigma_hz < 0.05 * struck.frequency_hz
        assert 0.5 < struck.rms_m / calm.rms_m < 2.0


@pytest.mark.slow
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(list(Station)),
    st.lists(
        st.tuples(st.integers(0, 5), st.integers(0, 5), st.floats(allow_nan=False, allow_infinity=False, width=32)),
        min_size=1,
        max_size=12,
    ),
)
def test_no_finite_values_whatever_raise_or_leave_what_is_not_finite(
    followed: Following, station: Station, lies: list[tuple[int, int, float]]
) -> None:
    def alter(batch: ImuBatch, t_s: float) -> None:
        if batch.station is station and STRUCK_S <= t_s < STRUCK_S + 0.02:
            for at, column, value in lies:
                batch.values[at % len(batch.values), column] = value

    following = _copied(followed)
    flown = following.fly(STRUCK_S + 0.4, alter)
    described = following.state.tracker.describe()
    assert described is not None
    assert np.all(np.isfinite(described.q_m))
    assert np.all(np.isfinite(described.q_sigma_m))
    assert np.all(np.isfinite(flown.error))
    assert np.all(np.isfinite(flown.sigma))
