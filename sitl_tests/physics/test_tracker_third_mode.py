"""A wing with three symmetric modes: tracked with as many, with two, and a wing tracked with one mode a family."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
import pytest

from companion.core.pipeline import start, step
from companion.params.airframe import Airframe, Mode, Uncertain
from companion.params.files import dump_airframe, load_airframe, parse_airframe
from companion.params.settings import Settings
from companion.records import Deflection, Floats, Tick
from companion.sim.flight.flight import build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS, flight_records

SEEDS = (1, 2, 3)
LENGTH_S, LEARNED_S = 24.0, 13.0  # the parameters are learned in the first ten seconds that are in sync
LAG_NS, TICK_NS, EVERY = 200_000_000, 20_000_000, 5
# each flight's errors as one draw of two numbers, 95 %: chi square of 6 degrees of freedom over 6
NEES_BOUNDS = (0.21, 2.41)

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Errors:
    """Symmetric deflection (m) and relative slope (rad) less the truth, (n, 2), and NEES of both, a half each."""

    deflection_and_slope: Floats
    nees: float


def three_modes() -> Airframe:
    """The demo's aircraft with symmetric modes at 5, 14 and 28 Hz; a cantilever's third slopes 7.85 / span a metre."""
    airframe = load_airframe("nadir-2m")
    second = Mode(Uncertain(14.0, 0.7), Uncertain(0.02, 0.01), Uncertain(4.78, 0.02))
    third = Mode(Uncertain(28.0, 1.4), Uncertain(0.02, 0.01), Uncertain(7.85, 0.04))
    wing = dataclasses.replace(airframe.wing, second_symmetric=second, further_symmetric=(third,))
    return dataclasses.replace(airframe, wing=wing)


def with_wing(airframe: Airframe, **changes: object) -> Airframe:
    return dataclasses.replace(airframe, wing=dataclasses.replace(airframe.wing, **changes))  # type: ignore[arg-type]


@functools.cache
def flown(seed: int, modes: int) -> Errors:
    """Smoothed estimates of one flight of the wing with three modes, by a belief of so many."""
    true = three_modes()
    flight = build_flight(true, seed, LENGTH_S)
    state = start(true if modes == 3 else with_wing(true, further_symmetric=()), Settings())
    smoothed, now_ns = [], HOST_EPOCH_NS
    for record in flight_records(flight):
        while now_ns < record.received_host_ns:
            state, _ = step(state, Tick(now_ns))
            now_ns += TICK_NS
            if now_ns > HOST_EPOCH_NS + LEARNED_S * 1e9 and now_ns // TICK_NS % EVERY == 0:
                smoothed.append(state.tracker.smooth(state.tracker.newest_ns - LAG_NS))
        state, _ = step(state, record)
    estimates = [estimate for estimate in smoothed if isinstance(estimate, Deflection)]
    assert len(estimates) > 0.9 * len(smoothed) > 0
    truth = flight.truth.series(np.array([estimate.t_host_ns - HOST_EPOCH_NS for estimate in estimates]))
    rows = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]])
    values = np.array([[*estimate.q_m, *estimate.qdot_mps, *estimate.slope_rad] for estimate in estimates]) @ rows.T
    errors = values - np.stack([truth.q_m[:, 0], truth.slope_rad.sum(axis=1)], axis=1)
    squares = [
        error @ np.linalg.solve(rows @ estimate.covariance @ rows.T, error)
        for error, estimate in zip(errors, estimates, strict=True)
    ]
    return Errors(errors, float(np.mean(squares)) / 2.0)


def rms(modes: int) -> Floats:
    """Root mean square errors over all flights: deflection, relative slope."""
    errors = np.concatenate([flown(seed, modes).deflection_and_slope for seed in SEEDS])
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))


@pytest.mark.long
def test_a_third_mode_that_is_believed_in_makes_neither_deflection_nor_slope_worse() -> None:
    with_third, without = rms(3), rms(2)
    assert with_third[0] <= without[0]
    assert with_third[1] <= without[1]


@pytest.mark.long
def test_the_error_with_three_modes_is_what_the_covariance_says() -> None:
    low, high = NEES_BOUNDS
    assert low < np.mean([flown(seed, 3).nees for seed in SEEDS]) < high


def test_a_third_mode_comes_back_from_its_file() -> None:
    airframe = with_wing(three_modes(), assume_second=False)
    assert parse_airframe(dump_airframe(airframe), "file") == airframe


if __name__ == "__main__":
    for modes in (2, 3):
        print(modes, rms(modes) * 1e3, [round(flown(seed, modes).nees, 2) for seed in SEEDS])
