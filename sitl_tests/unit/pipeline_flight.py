"""Inputs of the pipeline for its tests: a simulated flight's records with the service's ticks between, and matches."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.core.pipeline import PipelineState, start, step
from companion.core.stereo.geometry import Rig
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, ImuBatch, MatchSet, Record, Tick
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS, flight_records
from sitl_tests.unit.stereo_cases import ground_below, raw_pixels

S = 1_000_000_000
MS = 1_000_000
TICK_NS = 10 * MS
GROUND_M = 40.0
SHOT_PERIOD_NS = 150 * MS
VISION_NS = 60 * MS


@functools.cache
def flight(seconds: float = 6.0, seed: int = 4) -> Flight:
    """Nadir-2m, once for all tests of a process."""
    return build_flight(load_airframe("nadir-2m"), seed, seconds)


@functools.cache
def inputs(seconds: float = 6.0, seed: int = 4) -> tuple[Record, ...]:
    """The flight as the service would have seen it, in order of arrival."""
    return tuple(in_order([*flight_records(flight(seconds, seed)), *shots(flight(seconds, seed))]))


def in_order(records: Iterable[Any]) -> Iterator[Record]:
    """Sort by arrival, and put a tick every 10 ms between."""
    next_tick_ns = HOST_EPOCH_NS + TICK_NS
    for record in sorted(records, key=arrival_ns):
        while next_tick_ns <= arrival_ns(record):
            yield Tick(next_tick_ns)
            next_tick_ns += TICK_NS
        yield record


def arrival_ns(record: Any) -> int:
    """Host time at which an input arrived."""
    names = ("received_host_ns", "matched_host_ns", "now_host_ns", "changed_host_ns", "seen_host_ns", "fired_host_ns")
    return int(next(getattr(record, name) for name in names if hasattr(record, name)))


def at_s(record: Any) -> float:
    """Flight second of an input's arrival."""
    return (arrival_ns(record) - HOST_EPOCH_NS) / S


def shots(flown: Flight) -> Iterator[MatchSet]:
    """Exact matches of level ground as the truly bent wing sees it, with the noise that their sigma tells."""
    rig = Rig.from_airframe(flown.airframe)
    last_ns = round(flown.duration_s * S) - VISION_NS
    for number, boot_ns in enumerate(range(S // 2, last_ns, SHOT_PERIOD_NS)):
        truth = flown.truth.at(boot_ns)
        points = ground_below(GROUND_M, 60, seed=number)
        slope, lift = tuple(truth.slope_rad.tolist()), tuple(truth.lift_m.tolist())
        left_px, right_px = raw_pixels(rig, points, slope, lift)
        noise = 0.05 * np.random.default_rng(number).standard_normal((2, len(points), 2))
        yield MatchSet(
            pair_id=number,
            plan_id=number,
            clocks=(ClockName.HOST, ClockName.HOST),
            mid_exposure_ns=np.full(2, HOST_EPOCH_NS + boot_ns),
            exposure_ns=2 * MS,
            row_time_ns=0,
            left_px=left_px + noise[0],
            right_px=right_px + noise[1],
            sigma_px=np.full(len(points), 0.05),
            matched_host_ns=HOST_EPOCH_NS + boot_ns + VISION_NS,
        )


@dataclass
class Run:
    """A pipeline that has been driven: its outputs with the flight second at which each came."""

    state: PipelineState
    outputs: list[tuple[float, Record]] = field(default_factory=list)

    def of(self, kind: type[Any], since_s: float = 0.0, until_s: float = 1e9) -> list[Any]:
        """Outputs of one kind made within a time."""
        return [record for t_s, record in self.outputs if isinstance(record, kind) and since_s <= t_s < until_s]

    def times_s(self, kind: type[Any]) -> list[float]:
        """When outputs of one kind came."""
        return [t_s for t_s, record in self.outputs if isinstance(record, kind)]


def run(records: Iterable[Record], airframe: Airframe | None = None, settings: Settings | None = None) -> Run:
    """Drive a fresh pipeline."""
    driven = Run(start(airframe or load_airframe("nadir-2m"), settings or Settings()))
    for record in records:
        driven.state, outputs = step(driven.state, record)
        driven.outputs += [(at_s(record), output) for output in outputs]
    return driven


def without_samples(records: Iterable[Record], stations: tuple[int, ...], since_s: float) -> Iterator[Record]:
    """The inputs of which some stations fall silent at an instant."""
    for record in records:
        if not (isinstance(record, ImuBatch) and record.station in stations and at_s(record) >= since_s):
            yield record
