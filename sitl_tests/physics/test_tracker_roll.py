"""A steady roll acceleration, and a tip's sensor that sits higher than the airframe file says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.linalg

from companion.core.tracking.model import propagation
from companion.core.tracking.parameters import prior_parameters
from companion.core.tracking.states import make_layout, make_noise
from companion.params.files import load_airframe
from companion.sim.flight.flight import build_flight
from sitl_tests.unit.test_tracking_struck import Following

STEP_S = 0.004


def test_a_steady_roll_acceleration_is_predicted_as_it_is() -> None:
    """Euler's force on a lifted tip has it: a prediction that fades by 6 % moved a trim of 41 mm by 2.5 mm."""
    airframe = load_airframe("nadir-2m")
    layout = make_layout(airframe)
    noise = make_noise(airframe, layout, STEP_S)
    parameters = tuple(prior_parameters(family, airframe.wing.gust) for family in layout.families)
    transition, process = propagation(layout, noise, (parameters[0], parameters[1]), STEP_S)
    roll = slice(layout.roll_rate, layout.roll_accel + 1)
    F, Q, H = transition[roll, roll], process[roll, roll], np.array([[1.0, 0.0]])
    variance = np.array([[noise.sensor_variance[-1]]])
    P = scipy.linalg.solve_discrete_are(F.T, H.T, Q, variance)
    gain = P @ H.T / (H @ P @ H.T + variance)
    state, accel_radps2 = np.zeros(2), 0.5
    for k in range(1, 1000):
        predicted = F @ state
        state = predicted + gain[:, 0] * (accel_radps2 * k * STEP_S - predicted[0])
    middle = 0.5 * (state + F @ state)
    assert middle[1] == pytest.approx(accel_radps2, rel=0.01)


@pytest.mark.slow
def test_a_sensor_that_sits_15_mm_higher_is_told_and_moves_no_toe() -> None:
    """Three prior sigmas: a filter that takes the file's height as exact is 2.3 sigma of toe off, and 3.6 at most."""
    airframe = load_airframe("nadir-2m")
    height_m = 0.015

    left, right = (
        dataclasses.replace(sensor, position_m=(0.0, sensor.position_m[1], drop_m))
        for sensor, drop_m in ((airframe.left, height_m), (airframe.right, 0.0))
    )
    flight = build_flight(airframe, 11, 31.0)
    following = Following(dataclasses.replace(flight, airframe=dataclasses.replace(airframe, left=left, right=right)))
    flown = following.fly(30.0)
    over = (np.array(flown.error) / np.array(flown.sigma))[np.array(flown.t_s) > 15.0]
    tracker = following.state.tracker
    estimate_m, sigma_m = tracker.bias_parameters()["left.height"]
    true_m = height_m - following.flight.real.actual.left.position_m[2]
    assert abs(estimate_m - true_m) < 3.0 * sigma_m
    assert sigma_m < 0.003
    assert np.abs(over).max() < 3.0
