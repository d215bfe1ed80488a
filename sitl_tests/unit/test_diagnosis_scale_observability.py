"""Distances that tell a baseline, and those that cannot."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.diagnosis.data.observations import Observations, ToeData
from companion.diagnosis.flights.scale_observability import scale_note, scale_sigma
from companion.diagnosis.model.belief import believe
from companion.diagnosis.model.expectation import Expectation, ToeErrors
from companion.diagnosis.model.flight_model import FlightModel
from companion.params.files import load_airframe
from companion.records import Floats, Side

AIRFRAME = load_airframe("nadir-2m")
T_S = np.arange(5.0, 55.0, 0.1)
NOISE_RAD = 1e-3


def still(distance_m: Floats) -> tuple[FlightModel, Expectation]:
    """A wing that hardly moves, ranges with white noise at distances (k,)."""
    up_mps2 = 0.01 * np.random.default_rng(3).standard_normal((6000, 2))
    toe = ToeData(T_S, np.zeros(len(T_S)), 1.0 / distance_m, has_reference=True)
    observations = Observations(100.0, tuple(Side), up_mps2, np.zeros(2), False, np.ones(6000), {}, toe)
    model = FlightModel(believe(AIRFRAME, tuple(Side), True, False), observations, 40.0)
    white = dataclasses.replace(
        model.expect(np.zeros(len(model.belief.nuisances))),
        toe_errors=ToeErrors(np.zeros((len(T_S), len(T_S))), np.full(len(T_S), NOISE_RAD**2)),
    )
    return model, white


@pytest.mark.parametrize(
    ("distances_m", "said"), [((60.0, 60.0), "not at all"), ((59.5, 60.5), " % only"), ((100.0, 20.0), "")]
)
def test_one_distance_tells_no_baseline_and_two_tell_it(distances_m: tuple[float, float], said: str) -> None:
    model, white = still(np.where(T_S < 30.0, *distances_m))
    notes = scale_note([model], [white])
    assert bool(notes) == bool(said)
    assert all(said in note and "two known distances" in note for note in notes)


def test_a_sigma_of_almost_all_is_a_plain_percentage() -> None:
    """It said "1e+02 %"."""
    model, _ = still(np.full(len(T_S), 60.0))
    scatter_rad = NOISE_RAD / np.sqrt(0.25 * len(T_S))
    nearer_m = 1.0 / (1.0 / 60.0 + scatter_rad / (0.997 * model.baseline_m))
    (note,) = scale_note(*([entry] for entry in still(np.where(np.arange(len(T_S)) % 2, 60.0, nearer_m))))
    assert "to 100 % only" in note


def test_the_sigma_of_a_baseline_is_that_of_two_means() -> None:
    """White noise s at shares p and 1 - p of n exposures: sigma = s / sqrt(n p (1 - p)) / (B (1/Z_1 - 1/Z_2))."""
    model, white = still(np.where(T_S < 30.0, 80.0, 20.0))
    nearer = float(np.mean(T_S < 30.0))
    scatter_rad = NOISE_RAD / np.sqrt(len(T_S) * nearer * (1.0 - nearer))
    assert scale_sigma([model], [white]) == pytest.approx(
        scatter_rad / (model.baseline_m * (1.0 / 20.0 - 1.0 / 80.0)), rel=1e-6
    )


def test_ranges_without_true_distances_say_nothing_of_it() -> None:
    model, white = still(np.full(len(T_S), 60.0))
    toe = model.observations.toe
    assert toe is not None
    guessed = dataclasses.replace(model.observations, toe=dataclasses.replace(toe, has_reference=False))
    assert scale_note([FlightModel(model.belief, guessed, 40.0)], [white]) == []
