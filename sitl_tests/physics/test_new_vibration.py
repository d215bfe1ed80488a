"""Vibration that begins in flight: the sensors' noise is learned although it looks like a blow at first."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.pipeline import start, step
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ImuBatch, Record, Station, Tick
from companion.sim.flight.aircraft import demo_plan
from companion.sim.flight.flight import build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS
from tools.bench.slow import in_order

BEGINS_S, END_S = 14.0, 24.0
SAMPLE_MPS2 = 0.1
LONGEST_S = 6.0  # a second of innovations contradicts, a look or two teach, and trust waits for two seconds without


def _shaken(record: Record, rng: np.random.Generator) -> Record:
    """The record with white noise on a tip's lateral and vertical axis."""
    if not isinstance(record, ImuBatch) or record.station is Station.ROOT:
        return record
    if record.received_host_ns < HOST_EPOCH_NS + BEGINS_S * 1e9:
        return record
    values = record.values.copy()
    values[:, 1:3] += SAMPLE_MPS2 * rng.standard_normal((len(values), 2))
    return dataclasses.replace(record, values=values)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_vibration_that_begins_in_flight_is_trusted_again_within_seconds(seed: int) -> None:
    flight, rng = (
        build_flight(load_airframe("nadir-2m"), seed, plan=demo_plan(END_S + 2.0)),
        np.random.default_rng(seed),
    )
    state, distrusted_s = start(flight.airframe, Settings()), []
    for record in in_order(flight, []):
        state, _ = step(state, _shaken(record, rng))
        if isinstance(record, Tick) and record.now_host_ns > HOST_EPOCH_NS + 13.0e9 and state.tracker.distrust:
            distrusted_s.append((record.now_host_ns - HOST_EPOCH_NS) * 1e-9)
    assert distrusted_s, "the vibration is too weak to be a test"
    assert distrusted_s[0] > BEGINS_S
    assert distrusted_s[-1] < BEGINS_S + LONGEST_S
