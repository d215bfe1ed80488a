"""Recordings for the fleet's bench: a few short simulated flights, written many times over, each time aged a little.

Three aircraft take turns. On the second one the symmetric mode falls by 6 % over the fleet's flights, on the third the
left node's noise grows; on the first nothing changes. Only what a report reads of these is altered: the recorded
modes and the node's samples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.core.pipeline import start, step
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ImuBatch, ModeState, Station
from companion.sim.flight.aircraft import demo_plan
from companion.sim.flight.flight import build_flight
from tools.bench.slow import in_order
from tools.bench.world_flight import StruckPair, judged_shots

SHIPS = ("sound", "softening", "noisy")
SOFTENED = 0.06
_SEEDS = 3
_NOISE_MPS2 = 0.5  # added to the left node's samples at the end of its life, rms
_NO_SHOTS = 2


def flown(duration_s: float, seed: int) -> list[Recordable]:
    """Records of one simulated flight, outputs of the service behind the inputs that they follow from."""
    airframe = load_airframe("nadir-2m")
    flight = build_flight(airframe, seed, plan=demo_plan(duration_s), perturbed=False)
    state = start(airframe, dataclasses.replace(Settings(), trigger_policy=_NO_SHOTS))
    records: list[Recordable] = []
    for record in in_order(flight, list(judged_shots(flight, StruckPair(flight, 0.0)))):
        state, outputs = step(state, record)
        records += [record, *outputs]
    return records


def write_fleet(folder: Path, count: int, duration_s: float) -> list[Path]:
    """Write ``count`` recordings of ``duration_s`` each."""
    folder.mkdir(parents=True, exist_ok=True)
    airframe = load_airframe("nadir-2m")
    flights = [flown(duration_s, seed) for seed in range(1, _SEEDS + 1)]
    paths = []
    for number in range(count):
        ship, age = SHIPS[number % len(SHIPS)], number / max(count - 1, 1)
        path = folder / f"{number:04d}-{ship}.mcap"
        records = _aged(flights[number // len(SHIPS) % _SEEDS], ship, age, number)
        _write(path, dataclasses.replace(airframe, name=ship), records)
        paths.append(path)
    return paths


def _write(path: Path, airframe: Airframe, records: Iterable[Recordable]) -> None:
    writer = McapWriter(path, About.of(airframe, Settings()))
    for record in records:
        writer.write(record)
    writer.close()


def _aged(records: list[Recordable], ship: str, age: float, number: int) -> Iterator[Recordable]:
    """The records of a flight at an age of 0 to 1."""
    rng = np.random.default_rng(number)
    for record in records:
        if ship == "softening" and isinstance(record, ModeState):
            mode = record.symmetric
            softer = dataclasses.replace(mode, frequency_hz=mode.frequency_hz * (1.0 - SOFTENED * age))
            yield dataclasses.replace(record, symmetric=softer)
        elif ship == "noisy" and isinstance(record, ImuBatch) and record.station is Station.LEFT:
            noise = age * _NOISE_MPS2 * rng.standard_normal(record.values.shape)
            yield dataclasses.replace(record, values=record.values + noise)
        else:
            yield record
