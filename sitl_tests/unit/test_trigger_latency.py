"""The learned latency: prior first, truth soon, outliers counted, pairing that cannot slip."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from companion.core.trigger.latency import LatencyModel
from companion.core.trigger.scheduling import Scheduling
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, MatchSet, Reject, Shot, Side

MS = 1_000_000
S = 1_000_000_000


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return load_airframe("nadir-2m")


def teach(model: LatencyModel, count: int, true_ns: tuple[float, float], spread_ns: float, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for i in range(count):
        fired = S + i * 100 * MS
        model.shot(Shot(i, fired, fired))
        for side in Side:
            model.exposure(side, i, fired + round(true_ns[side] + spread_ns * rng.standard_normal()))


def test_the_prior_is_latency_and_half_the_exposure(airframe: Airframe) -> None:
    model = LatencyModel(airframe)
    assert model.lead_ns == 9 * MS
    assert model.estimate(Side.LEFT).bias_sigma_ns == pytest.approx(2 * MS)
    assert airframe.left_camera is not None
    rolling = dataclasses.replace(airframe, left_camera=dataclasses.replace(airframe.left_camera, row_time_s=20e-6))
    # the middle row of 480 starts 4.8 ms after the first
    assert LatencyModel(rolling).estimate(Side.LEFT).bias_ns == pytest.approx(13.8 * MS)


@pytest.mark.parametrize("spread_ns", [0.1e6, 0.5e6])
def test_each_side_learns_its_own_bias_and_spread(airframe: Airframe, spread_ns: float) -> None:
    true_ns = (6.5e6, 11.2e6)
    model = LatencyModel(airframe)
    teach(model, 200, true_ns, spread_ns)
    for side in Side:
        belief = model.estimate(side)
        assert abs(belief.bias_ns - true_ns[side]) < 4 * belief.bias_sigma_ns
        assert belief.bias_sigma_ns < spread_ns / 4
        assert belief.spread_ns == pytest.approx(spread_ns, rel=0.9)
    assert model.lead_ns == pytest.approx(8.85e6, abs=spread_ns / 3)
    left, right = model.shifts_ns()
    assert left == -right == pytest.approx(-2.35e6, abs=spread_ns / 3)


def test_the_sigma_of_the_bias_is_honest(airframe: Airframe) -> None:
    errors = []
    for seed in range(60):
        model = LatencyModel(airframe)
        true = 9e6 + 2e6 * np.random.default_rng(seed).standard_normal()
        teach(model, 12, (true, true), 0.4e6, seed=1000 + seed)
        belief = model.estimate(Side.LEFT)
        errors.append((belief.bias_ns - true) / belief.bias_sigma_ns)
    assert 0.4 < np.std(errors) < 1.3


def test_no_more_is_known_than_a_median_of_the_last_64_tells(airframe: Airframe) -> None:
    """The median of n normal values scatters by sqrt(pi / 2n) of their spread, which is itself known to a seventh."""
    told_ns, spread_ns = [], 0.4e6
    for seed in range(20):
        model = LatencyModel(airframe)
        teach(model, 100, (9e6, 9e6), spread_ns, seed)
        told_ns += [model.estimate(side).bias_sigma_ns for side in Side]
    least_ns = np.sqrt(np.pi / 2 / 64) * spread_ns
    assert 0.95 * least_ns < np.mean(told_ns) < 1.4 * least_ns


def test_outliers_are_counted_and_do_not_move_the_bias(airframe: Airframe) -> None:
    model = LatencyModel(airframe)
    teach(model, 50, (9e6, 9e6), 0.1e6)
    before = model.estimate(Side.LEFT).bias_ns
    fired = 100 * S
    model.shot(Shot(900, fired, fired))
    assert model.exposure(Side.LEFT, 900, fired + 60 * MS) is Reject.INCONSISTENT
    after = model.estimate(Side.LEFT)
    assert after.outliers == 1
    assert after.bias_ns == before


def test_a_lasting_change_is_followed(airframe: Airframe) -> None:
    model = LatencyModel(airframe)
    teach(model, 50, (9e6, 9e6), 0.1e6)
    for i in range(1000, 1020):
        fired = i * S
        model.shot(Shot(i, fired, fired))
        model.exposure(Side.RIGHT, i, fired + 25 * MS)
    assert model.estimate(Side.RIGHT).bias_ns == pytest.approx(25e6, abs=0.2e6)
    assert model.estimate(Side.LEFT).bias_ns == pytest.approx(9e6, abs=0.2e6)


def test_without_a_plan_id_the_nearest_shot_in_time_is_taken(airframe: Airframe) -> None:
    model = LatencyModel(airframe)
    for i in range(10):
        model.shot(Shot(i, S + i * 40 * MS, S + i * 40 * MS))
    for i in range(10):
        assert model.exposure(Side.LEFT, -1, S + i * 40 * MS + 8 * MS) is None
    assert model.estimate(Side.LEFT).bias_ns == pytest.approx(8e6, abs=0.3e6)


def test_a_frame_that_no_shot_explains_is_unpaired(airframe: Airframe) -> None:
    model = LatencyModel(airframe)
    assert model.exposure(Side.LEFT, 3, S) is Reject.UNPAIRED
    model.shot(Shot(3, S, S))
    assert model.exposure(Side.LEFT, 3, S - MS) is Reject.UNPAIRED
    assert model.exposure(Side.LEFT, 3, 3 * S) is Reject.UNPAIRED
    assert model.unpaired == 3
    assert model.estimate(Side.LEFT).count == 0


@pytest.mark.parametrize("named", [True, False])
def test_coarse_stamps_of_a_short_latency_are_learned_without_bias(airframe: Airframe, named: bool) -> None:
    """Stamps of 3 ms, 0.7 ms after the command: four of ten are before it, and the others alone are 2.5 ms late."""
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    coarse: dict[str, Any] = {"latency_s": Uncertain(0.0002, 0.001), "exposure_s": 0.001, "stamp_sigma_s": 0.003}
    left, right = (dataclasses.replace(each, **coarse) for each in (airframe.left_camera, airframe.right_camera))
    scheduling = Scheduling.create(dataclasses.replace(airframe, left_camera=left, right_camera=right), Settings())
    random, empty = np.random.default_rng(4), np.zeros((0, 2))
    verdicts, biases_ns = [], []
    for number in range(1000):
        fired_ns = S + number * 100 * MS
        scheduling.fired(Shot(number, fired_ns, fired_ns))
        stamps_ns = fired_ns + np.round(0.7e6 + 3e6 * random.standard_normal(2)).astype(np.int64)
        clocks, plan_id = (ClockName.HOST, ClockName.HOST), number if named else -1
        pair = MatchSet(number, plan_id, clocks, stamps_ns, MS, 0, empty, empty, np.zeros(0), fired_ns + 60 * MS)
        verdicts.append(scheduling.exposed(pair, 0.003))
        biases_ns += [scheduling.latency.estimate(side).bias_ns for side in Side]
    assert sum(verdict is not None for verdict in verdicts) < 10
    assert np.mean(biases_ns[200:]) == pytest.approx(0.7e6, abs=0.3e6)
    assert scheduling.latency.unpaired == 0


def test_a_stamp_before_its_command_by_more_than_it_errs_is_unpaired(airframe: Airframe) -> None:
    model = LatencyModel(airframe)
    model.shot(Shot(3, S, S))
    assert model.exposure(Side.LEFT, 3, S - 10 * MS, 0.001) is Reject.UNPAIRED
    assert model.exposure(Side.LEFT, -1, S - 10 * MS, 0.001) is Reject.UNPAIRED
    assert model.exposure(Side.LEFT, 3, S - 5 * MS, 0.001) is not Reject.UNPAIRED
