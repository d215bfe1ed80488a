"""Latency of simulated shots: what was put in comes out; unknown plans are paired by time; too little is refused."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest

from companion.calibration.latency import trigger_latency
from companion.core.trigger.latency import LatencyModel
from companion.errors import RecordingError
from companion.params.airframe import Uncertain
from companion.params.files import load_airframe
from companion.records import ClockName, MatchSet, Record, Shot, Side

EXPOSURE_NS = 2_000_000
TO_MIDDLE_NS = (EXPOSURE_NS // 2, EXPOSURE_NS // 2)
CAMERAS = load_airframe("forward-2m").camera_pair


def _records(n: int, *, known_plans: bool, to_middle_ns: tuple[int, int] = TO_MIDDLE_NS) -> list[Record]:
    random, records = np.random.default_rng(2), []
    for k in range(n):
        fired = 1_000_000_000 + k * 100_000_000
        start = fired + np.array([8_000_000, 8_500_000]) + random.normal(0, 200_000, 2).astype(np.int64)
        records.append(Shot(k, fired - 1000, fired))
        mid = (start + np.array(to_middle_ns)).astype(np.int64)
        empty = np.zeros((0, 2))
        plan = k if known_plans else -1
        host = (ClockName.HOST, ClockName.HOST)
        records.append(MatchSet(k, plan, host, mid, EXPOSURE_NS, 0, empty, empty, np.zeros(0), int(mid[0])))
    return records


@pytest.mark.parametrize("known_plans", [True, False])
def test_latency_and_its_spread_come_back(known_plans: bool) -> None:
    latency = trigger_latency(_records(400, known_plans=known_plans), CAMERAS)
    assert latency.shots == 400
    # the median of 400 normal deviates is off by 1.25 sigma / 20
    assert latency.median_s == pytest.approx([0.008, 0.0085], abs=4 * 0.0002 * 1.25 / 20)
    assert latency.sigma_s == pytest.approx([0.0002, 0.0002], rel=0.25)
    assert np.all(latency.p99_s > latency.median_s + 1.5 * latency.sigma_s)


def test_the_latency_is_to_the_first_row_of_either_camera_and_gives_the_stamp_back_in_flight() -> None:
    """Rows of 20 us, 480 of them, and exposures of 2 and 6 ms: 5.8 and 7.8 ms to the middle."""
    base = load_airframe("forward-2m")
    cameras = tuple(
        dataclasses.replace(camera, exposure_s=exposure_s, row_time_s=20e-6)
        for camera, exposure_s in zip(CAMERAS, (0.002, 0.006), strict=True)
    )
    latency = trigger_latency(
        _records(400, known_plans=True, to_middle_ns=(5_800_000, 7_800_000)), (cameras[0], cameras[1])
    )
    assert latency.median_s == pytest.approx([0.008, 0.0085], abs=4 * 0.0002 * 1.25 / 20)
    left, right = (
        dataclasses.replace(camera, latency_s=Uncertain(float(median_s), 1e-4))
        for camera, median_s in zip(cameras, latency.median_s, strict=True)
    )
    model = LatencyModel(dataclasses.replace(base, left_camera=left, right_camera=right))
    leads_ns = [model.estimate(side).bias_ns for side in Side]
    assert leads_ns == pytest.approx([13.8e6, 16.3e6], abs=0.05e6)


def test_stamps_cut_to_milliseconds_leave_their_step_in_the_sigma() -> None:
    """All within half a step: the median deviation is 0."""
    records = [
        dataclasses.replace(record, mid_exposure_ns=record.mid_exposure_ns // 1_000_000 * 1_000_000)
        if isinstance(record, MatchSet)
        else record
        for record in _records(40, known_plans=True)
    ]
    assert np.all(trigger_latency(records, CAMERAS).sigma_s >= 1e-3 / np.sqrt(12.0))
    steady = [
        dataclasses.replace(record, mid_exposure_ns=np.array([k // 2 * 100_000_000 + 1_009_000_001] * 2))
        if isinstance(record, MatchSet)
        else record
        for k, record in enumerate(_records(40, known_plans=True))
    ]
    assert np.all(trigger_latency(steady, CAMERAS).sigma_s >= 5e-5)


def test_without_plans_a_latency_beyond_the_period_is_ambiguous_and_that_is_told() -> None:
    assert trigger_latency(_records(40, known_plans=True), CAMERAS).ambiguous_s is None
    assert trigger_latency(_records(40, known_plans=False), CAMERAS).ambiguous_s == pytest.approx(0.1)


@pytest.mark.parametrize("known_plans", [True, False])
def test_four_times_the_shots_take_about_four_times_as_long(known_plans: bool) -> None:
    """Sixteen times by looking through all shots for each exposure: hours of a recording never ended."""
    took_s = []
    for count in (3000, 12000):
        records = _records(count, known_plans=known_plans)
        began_s = time.process_time()
        trigger_latency(records, CAMERAS)
        took_s.append(time.process_time() - began_s)
    assert took_s[1] < 8.0 * took_s[0]


def test_a_few_shots_are_too_few() -> None:
    with pytest.raises(RecordingError, match="only 5"):
        trigger_latency(_records(5, known_plans=True), CAMERAS)
