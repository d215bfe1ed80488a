"""Slow tilt of the tips by gyros and lateral axes: a wing written down, and what a flight's ranges tell with it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from companion.core.wing.effects import catalogue
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.data.tilt_measurement import TipSamples, tip_tilt
from companion.diagnosis.data.tip_tilt import slow_response
from companion.diagnosis.flights.recordings import Flights
from companion.diagnosis.flights.screen import screen
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.evaluation.flight_models import models_of
from companion.evaluation.recorded_evidence import load
from companion.params.airframe import NamedEffect
from companion.params.files import load_airframe
from companion.records import Floats
from companion.sim.flight.flight import build_flight
from companion.sim.flight.tables import write_csv
from companion.units import GRAVITY_MPS2

AIRFRAME = load_airframe("nadir-2m")
RATE_HZ = 500.0
T_S = np.arange(30_000) / RATE_HZ
AT_S = np.arange(4.0, 56.0, 0.1)
SLOW_HZ, SWING_HZ = 0.08, 5.0
WINDY_SEED = 417
"""A flight of 17 m/s^2 rms at the tips: the slow gust bends it by 7 mrad that no vertical accelerometer tells."""


def slope_rad() -> tuple[Floats, Floats]:
    """Slope of either tip, and its slow part: a sag, a slow gust, and a swing that outweighs both."""
    slow = 0.02 + 0.006 * np.sin(2.0 * np.pi * SLOW_HZ * T_S)
    return slow + 0.03 * np.sin(2.0 * np.pi * SWING_HZ * T_S), slow


def samples(gyro_bias_radps: float = 0.0, lateral_bias_mps2: float = 0.0, z_bias_mps2: float = 0.0) -> TipSamples:
    """Readings of a wing that swings, exactly: both tips alike, the fuselage rolling; biases are the left sensor's."""
    slope, _ = slope_rad()
    roll_radps = 0.3 * np.sin(2.0 * np.pi * 0.1 * T_S)
    # the tip's acceleration is that of its swing: lift = slope / 1.39, upwards against z
    up_mps2 = -((2.0 * np.pi * SWING_HZ) ** 2) * 0.03 * np.sin(2.0 * np.pi * SWING_HZ * T_S) / 1.39
    body_z = -GRAVITY_MPS2 - up_mps2
    lateral, vertical, rolls = [], [], []
    for sign, bias in ((1.0, 1.0), (-1.0, 0.0)):
        place_m = -sign * 1.0
        turn = sign * slope
        rate = np.gradient(roll_radps, 1.0 / RATE_HZ)
        # the tip's place across the body turns about it: -p^2 y across, p' y down
        across, down = -(roll_radps**2) * place_m, body_z + rate * place_m
        lateral.append(np.cos(turn) * across + np.sin(turn) * down + bias * lateral_bias_mps2)
        vertical.append(np.cos(turn) * down - np.sin(turn) * across + bias * z_bias_mps2)
        rolls.append(roll_radps + np.gradient(turn, 1.0 / RATE_HZ) + bias * gyro_bias_radps)
    root_z = np.full(len(T_S), -GRAVITY_MPS2)
    rigid = {"y": (T_S, np.zeros(len(T_S))), "p": (T_S, roll_radps)}
    return TipSamples(T_S, np.stack(lateral), np.stack(vertical), np.stack(rolls), root_z, rigid)


UNFILTERED = dataclasses.replace(
    AIRFRAME, root=dataclasses.replace(AIRFRAME.root, lowpass_accel_hz=0.0, lowpass_gyro_hz=0.0)
)


@pytest.mark.parametrize(
    ("gyro_bias_radps", "lateral_bias_mps2", "z_bias_mps2"),
    [(0.0, 0.0, 0.0), (1e-3, 0.0, 0.0), (0.0, 0.02, 0.0), (1e-3, 0.02, 0.8)],
)
def test_a_swinging_wing_shows_its_slow_tilt(
    gyro_bias_radps: float, lateral_bias_mps2: float, z_bias_mps2: float
) -> None:
    """Both tips together, about a level: 2 x 6 mrad of slow gust within a hundredth, whatever biases there are."""
    tilt, covariance = tip_tilt(samples(gyro_bias_radps, lateral_bias_mps2, z_bias_mps2), UNFILTERED, AT_S).together()
    gain = float(slow_response(np.array([SLOW_HZ]), AIRFRAME.wing.symmetric.frequency_hz.value)[0])
    true = 2.0 * gain * 0.006 * np.sin(2.0 * np.pi * SLOW_HZ * AT_S)
    error = tilt - true
    assert np.std(error) < 0.01 * 2.0 * 0.006
    assert np.std(error) < np.sqrt(np.mean(np.diag(covariance - covariance.mean())))


def test_the_error_of_some_instants_is_a_part_of_the_whole() -> None:
    all_instants = tip_tilt(samples(), UNFILTERED, AT_S)
    inside = AT_S > 20.0
    slope_of_part, covariance = all_instants.taken(inside).together()
    assert len(slope_of_part) == len(covariance) == np.count_nonzero(inside)
    # fewer instants tell no more of any difference; levels are nothing that either tells
    apart = np.diff(np.eye(len(covariance)), axis=0)
    of_part = np.diag(apart @ covariance @ apart.T)
    of_whole = np.diag(apart @ all_instants.together()[1][np.ix_(inside, inside)] @ apart.T)
    assert np.all(of_part > of_whole * (1.0 - 1e-3))


def test_the_tilt_tells_nothing_of_a_bend_that_follows_the_load() -> None:
    """Such a bend moves toe and tilt alike: a toe that follows the tilt shows none, and the tilt is not judged."""
    load = 1.0 + 0.2 * np.sin(2.0 * np.pi * 0.05 * T_S) + 0.1 * np.sin(2.0 * np.pi * 0.11 * T_S)
    pulled = dataclasses.replace(samples(), root_z_mps2=-GRAVITY_MPS2 * load)
    tilt = tip_tilt(pulled, UNFILTERED, AT_S)
    _, covariance = tilt.together()
    assert abs(np.corrcoef(tilt.load_shapes[0], np.interp(AT_S, T_S, load))[0, 1]) > 0.99
    for shape in tilt.load_shapes:
        assert shape @ np.linalg.solve(covariance, shape) < 1.01 / 0.1**2, "no better than a tenth of a radian"


def test_lateral_forces_tell_nothing_without_weight() -> None:
    falling = dataclasses.replace(samples(), root_z_mps2=np.full(len(T_S), -1.0))
    tilt = tip_tilt(falling, UNFILTERED, AT_S)
    assert not tilt.tells.any()
    assert np.all(np.isfinite(tilt.together()[0]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("wide")
    wider = (NamedEffect("baseline-error", {"error_m": 0.12}),)
    write_csv(build_flight(AIRFRAME, WINDY_SEED, 60.0, effects=wider), made)
    return made


def without_tilt(observations: Observations) -> Observations:
    assert observations.toe is not None
    return dataclasses.replace(observations, toe=dataclasses.replace(observations.toe, tilt=None))


def baseline_z(model: FlightModel) -> float:
    fitted = Flights([model]).null()
    (candidate,) = screen([model], fitted, [EffectTerm(catalogue()["baseline-error"]())]).candidates
    return candidate.z


def test_a_minute_in_wind_tells_a_wrong_baseline(folder: Path) -> None:
    """Six centimetres to either side are 1.7 mrad as the distance changes; the slow gust of this flight is 7 mrad."""
    (model,) = models_of([folder], AIRFRAME)
    before = FlightModel(model.belief, without_tilt(model.observations), model.top_hz)
    assert baseline_z(model) > 7.0
    assert baseline_z(model) > 1.5 * baseline_z(before)


def test_the_toe_that_is_left_untold_is_a_fraction_and_holds_what_is_left(folder: Path) -> None:
    (model,) = models_of([folder], AIRFRAME)
    before = FlightModel(model.belief, without_tilt(model.observations), model.top_hz)
    after_rad, before_rad = (
        np.sqrt(np.mean(np.diag(entry.expect(np.zeros(len(model.belief.nuisances))).toe_posterior)))
        for entry in (model, before)
    )
    assert after_rad < 0.25 * before_rad


def test_a_recording_with_a_gap_or_without_gyros_has_none(folder: Path) -> None:
    raw = load(folder, AIRFRAME)
    without = {side: dataclasses.replace(tip, roll_radps=None) for side, tip in raw.tips.items()}
    holed = {side: tip.taken(np.flatnonzero((tip.t_s < 30.0) | (tip.t_s > 30.4))) for side, tip in raw.tips.items()}
    for tips in (without, holed):
        (observations,) = observe(dataclasses.replace(raw, tips=tips), AIRFRAME, 40.0)
        assert observations.toe is not None
        assert observations.toe.tilt is None
