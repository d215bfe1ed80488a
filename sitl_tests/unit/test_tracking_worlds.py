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
def test_scales_are_learned_once_the_lines_are_taken_out() -> None:
    """Left at their priors they contradict the sensors for good: 27 of 204 shots were trusted."""
    following = Following(build_flight(load_airframe("forward-2m"), 303503, 24.0, world=TONES))
    following.fly(SETTLED_S)
    assert set(following.fly(23.0).distrust) == {None}


@pytest.mark.slow
def test_a_clean_electric_aircraft_is_trusted_and_its_vibration_moves_nothing() -> None:
    """Six axes in the world fair: beside the biases, which images correct, the slopes are right to a milliradian."""
    following = Following(build_flight(load_airframe("nadir-2m"), 3, END_S + 1.0, perturbed=False, world=FAIR))
    following.fly(SETTLED_S)
    flown = following.fly(END_S)
    assert np.mean([distrust is None for distrust in flown.distrust]) > 0.9
    assert np.std(flown.error) < min(np.mean(flown.sigma), 1e-3)


@pytest.mark.slow
def test_a_root_too_slow_to_be_searched_does_not_say_where_a_shaft_is() -> None:
    """At 333 Hz a loop near 160 Hz looks locked to what it has: the tips' shaft was lost and begun anew each second."""
    belief = load_airframe("forward-2m")
    left, right = (dataclasses.replace(sensor, sends="z") for sensor in (belief.left, belief.right))
    flight = build_flight(dataclasses.replace(belief, left=left, right=right), 303002, 9.0, world=TONES)
    following, shafts = Following(flight), []
    for until_s in (4.0, 5.0, 6.0, 7.0, 8.0):
        following.fly(until_s)
        shafts.append(list(following.state.tracker._lines._lines.leader_hz))
    assert shafts == [[0]] * 5
