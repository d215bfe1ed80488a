"""Sensors three times as noisy as believed, and a propeller's lines: the wing is tracked and its sigma holds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.params.files import load_airframe
from companion.sim.flight.flight import build_flight
from companion.sim.flight.worlds import FAIR, IDEAL, TONES, Conditions, SensorWear
from sitl_tests.unit.test_tracking_struck import Following

SETTLED_S, END_S = 15.0, 19.0
NOISY = dataclasses.replace(IDEAL, name="noisy", sensors=SensorWear(noise_ratio=(3.0, 3.0)))


@pytest.mark.slow
@pytest.mark.parametrize("world", [NOISY, TONES], ids=lambda world: world.name)
def test_it_is_trusted_and_right(world: Conditions) -> None:
    flight = build_flight(load_airframe("nadir-2m"), 3, END_S + 1.0, perturbed=False, world=world)
    following = Following(flight)
    following.fly(SETTLED_S)
    flown = following.fly(END_S)
    assert np.mean([distrust is None for distrust in flown.distrust]) > 0.9
    ratio = np.abs(np.array(flown.error)) / np.array(flown.sigma)
    assert len(ratio) > 150
    assert np.all(np.isfinite(ratio))
    assert ratio.max() < 4.0


@pytest.mark.slow
def test_a_clean_electric_aircraft_is_trusted_and_its_vibration_moves_nothing() -> None:
    """Six axes in the world fair: beside the biases, which images correct, the slopes are right to a milliradian."""
    following = Following(build_flight(load_airframe("nadir-2m"), 3, END_S + 1.0, perturbed=False, world=FAIR))
    following.fly(SETTLED_S)
    flown = following.fly(END_S)
    assert np.mean([distrust is None for distrust in flown.distrust]) > 0.9
    assert np.std(flown.error) < min(np.mean(flown.sigma), 1e-3)
