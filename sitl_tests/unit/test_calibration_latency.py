"""Latency of simulated shots: what was put in comes out; unknown plans are paired by time; too little is refused."""

from __future__ import annotations

import numpy as np
import pytest

from companion.calibration.latency import trigger_latency
from companion.errors import RecordingError
from companion.records import ClockName, MatchSet, Record, Shot

EXPOSURE_NS = 2_000_000


def _records(n: int, *, known_plans: bool) -> list[Record]:
    random, records = np.random.default_rng(2), []
    for k in range(n):
        fired = 1_000_000_000 + k * 100_000_000
        start = fired + np.array([8_000_000, 8_500_000]) + random.normal(0, 200_000, 2).astype(np.int64)
        records.append(Shot(k, fired - 1000, fired))
        mid = (start + EXPOSURE_NS // 2).astype(np.int64)
        empty = np.zeros((0, 2))
        plan = k if known_plans else -1
        host = (ClockName.HOST, ClockName.HOST)
        records.append(MatchSet(k, plan, host, mid, EXPOSURE_NS, 0, empty, empty, np.zeros(0), int(mid[0])))
    return records


@pytest.mark.parametrize("known_plans", [True, False])
def test_latency_and_its_spread_come_back(known_plans: bool) -> None:
    latency = trigger_latency(_records(400, known_plans=known_plans))
    assert latency.shots == 400
    # the median of 400 normal deviates is off by 1.25 sigma / 20
    assert latency.median_s == pytest.approx([0.008, 0.0085], abs=4 * 0.0002 * 1.25 / 20)
    assert latency.sigma_s == pytest.approx([0.0002, 0.0002], rel=0.25)
    assert np.all(latency.p99_s > latency.median_s + 1.5 * latency.sigma_s)


def test_a_few_shots_are_too_few() -> None:
    with pytest.raises(RecordingError, match="only 5"):
        trigger_latency(_records(5, known_plans=True))
