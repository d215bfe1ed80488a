"""Averaging epochs: when a tip's first moment tells something of its bending."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.tracking.model import build_model
from companion.core.tracking.parameters import prior_parameters
from companion.core.tracking.rigid_body import MeasurementBuilder
from companion.core.tracking.states import (
    M_LEFT,
    M_RIGHT,
    Y_LEFT,
    Y_RIGHT,
    Z_LEFT,
    Z_RIGHT,
    StateLayout,
    make_layout,
    make_noise,
)
from companion.core.tracking.streams import SampleBuffer
from companion.params.airframe import Airframe
from companion.records import Axis, Station
from sitl_tests.unit.tracking_samples import EPOCH_NS, MS, batch, plain_airframe, swinging

STEP_NS = 4 * MS


def _builder(airframe: Airframe, layout: StateLayout, streams: tuple[SampleBuffer, ...]) -> MeasurementBuilder:
    return MeasurementBuilder(
        layout, make_noise(airframe, layout, STEP_NS * 1e-9), (streams[0], streams[1], streams[2])
    )


@pytest.mark.parametrize(("shaken_hz", "heard_most"), [(0.0, 1.0), (2.0, 1.0), (90.0, 0.2)])
def test_moments_count_where_the_root_moves_as_its_means_say(shaken_hz: float, heard_most: float) -> None:
    """A support that shakes faster than epochs resolve moves the wing inside one; a slow or quiet one does not."""
    airframe = plain_airframe()
    t, values = swinging(1.2, 0.005)
    streams = tuple(SampleBuffer(airframe.sensor(station)) for station in Station)
    for station, v in values.items():
        v[:, 2] += 3.0 * np.sin(2 * np.pi * shaken_hz * (t - EPOCH_NS) * 1e-9)
        streams[station].add(batch(station, t, v), 0)
    layout = make_layout(airframe)
    epochs = _builder(airframe, layout, streams).epochs(EPOCH_NS + 25 * STEP_NS, STEP_NS, 250)
    assert epochs.present[:, [Z_LEFT, Z_RIGHT]].all()
    heard = epochs.present[:, [M_LEFT, M_RIGHT]].mean()
    assert heard == 1.0 if heard_most == 1.0 else heard < heard_most


def test_an_axis_that_is_not_sent_leaks_as_the_rigid_wings() -> None:
    """The vertical axis of a tip that sends no other one leans over all the same: in a side force and in a roll."""
    airframe = plain_airframe()
    layout = make_layout(airframe)
    t, values = swinging(0.6, 0.0)
    streams = tuple(SampleBuffer(airframe.sensor(station)) for station in Station)
    side_mps2, roll_radps = 2.0, 0.8
    for station, v in values.items():
        v[:, 1], v[:, 3] = side_mps2, roll_radps
        sent = batch(station, t, v)
        if station is Station.LEFT:
            hidden = v * np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
            sent = dataclasses.replace(sent, axes=Axis.Z, values=hidden)
        streams[station].add(sent, 0)
    epochs = _builder(airframe, layout, streams).epochs(EPOCH_NS + 25 * STEP_NS, STEP_NS, 100)
    column = layout.bias_parameters.index("left.mx")
    lever_m = airframe.left.position_m[1] - airframe.root.position_m[1]
    leaking = side_mps2 - lever_m * roll_radps**2
    np.testing.assert_allclose(epochs.sensitivity[:, Z_LEFT, column], -leaking, rtol=0.02)


@pytest.mark.parametrize(("axis", "name"), [(3, "root.bp"), (5, "root.br")])
def test_a_bias_of_the_root_s_rates_shows_as_the_tips_centripetal_force(axis: int, name: str) -> None:
    """Against the force itself, reckoned from rates with and without the bias, on a wing that is swept and bent up."""
    airframe = plain_airframe()
    swept = {
        place: dataclasses.replace(sensor, position_m=(0.2, sensor.position_m[1], -0.1))
        for place, sensor in (("left", airframe.left), ("right", airframe.right))
    }
    airframe = dataclasses.replace(airframe, **swept)
    layout, bias_radps = make_layout(airframe), 1e-4

    def measured(bias_radps: float) -> tuple[np.ndarray, np.ndarray]:
        t, values = swinging(0.6, 0.0)
        streams = tuple(SampleBuffer(airframe.sensor(station)) for station in Station)
        for station, v in values.items():
            v[:, 3:] = 0.8, -0.3, 0.5
            v[:, axis] += bias_radps if station is Station.ROOT else 0.0
            streams[station].add(batch(station, t, v), 0)
        epochs = _builder(airframe, layout, streams).epochs(EPOCH_NS + 25 * STEP_NS, STEP_NS, 100)
        return epochs.rows[:, [Z_LEFT, Z_RIGHT, Y_LEFT, Y_RIGHT]], epochs.sensitivity[:, [0, 1, 4, 5]]

    (with_bias, _), (without, sensitivity) = measured(bias_radps), measured(0.0)
    jacobian = (with_bias - without) / bias_radps
    np.testing.assert_allclose(sensitivity[:, :, layout.bias_parameters.index(name)], jacobian, rtol=0.02, atol=1e-3)
    assert np.abs(jacobian).max(axis=0).min() > 0.01


@pytest.mark.parametrize("station", Station)
def test_a_sensor_that_sits_higher_feels_the_turn_of_its_arm(station: Station) -> None:
    """Against the force ``Omega' x r + Omega x (Omega x r)`` itself, while the roll begins and ends."""
    airframe = plain_airframe()
    sensors = {
        place: dataclasses.replace(getattr(airframe, place), height_sigma_m=0.005)
        for place in ("root", "left", "right")
    }
    airframe = dataclasses.replace(airframe, **sensors)
    layout, beat_radps = make_layout(airframe), 2.0 * np.pi * 0.5

    def measured(height_m: float) -> tuple[np.ndarray, np.ndarray]:
        t, values = swinging(1.5, 0.0)
        streams = tuple(SampleBuffer(airframe.sensor(station)) for station in Station)
        turn = beat_radps * (t - EPOCH_NS) * 1e-9
        rate = np.stack([0.5 * np.sin(turn), np.full(len(t), -0.3), np.full(len(t), 0.4)], axis=1)
        change = np.stack([0.5 * beat_radps * np.cos(turn), np.zeros(len(t)), np.zeros(len(t))], axis=1)
        for other, v in values.items():
            arm_m = np.array([0.0, 0.0, -height_m * (other is station)])
            v[:, :3] += np.cross(change, arm_m) + np.cross(rate, np.cross(rate, arm_m))
            v[:, 3:] = rate
            streams[other].add(batch(other, t, v), 0)
        epochs = _builder(airframe, layout, streams).epochs(EPOCH_NS + 25 * STEP_NS, STEP_NS, 320)
        rows = [Z_LEFT, Z_RIGHT, Y_LEFT, Y_RIGHT]
        return epochs.rows[20:, rows], epochs.sensitivity[20:, rows]

    (higher, _), (in_place, sensitivity) = measured(0.005), measured(0.0)
    jacobian = (higher - in_place) / 0.005
    column = layout.bias_parameters.index(f"{station.name.lower()}.height")
    assert np.abs(jacobian).max() > 0.1
    delayed = 1.05 * 0.034 * 0.5**2 * beat_radps  # the sensitivity has the roll of 34 ms before
    np.testing.assert_allclose(sensitivity[:, :, column], jacobian, atol=delayed)


def test_what_is_lost_between_samples_is_each_tips_own() -> None:
    """Nodes sample at instants of their own: under a load that moves both tips alike their moments still differ."""
    airframe = plain_airframe()
    layout, gust = make_layout(airframe), airframe.wing.gust
    loud, still = (prior_parameters(family, gust) for family in layout.families)
    hardly_loaded = tuple(dataclasses.replace(mode, load=1e-9 * mode.load) for mode in still.modes)
    still = dataclasses.replace(still, modes=hardly_loaded)
    noise = make_noise(airframe, layout, 0.004)
    without_gaps = dataclasses.replace(noise, sample_s=0.0)
    rows = slice(M_LEFT, Y_LEFT)
    with_loss, without = (
        build_model(layout, kind, (loud, still), (-1.0, 1.0), 0.004).process_noise_in_rows[rows, rows]
        for kind in (noise, without_gaps)
    )
    lost = with_loss - without
    alike, apart = (0.5 * np.array([1.0, sign]) @ lost @ np.array([1.0, sign]) for sign in (1.0, -1.0))
    assert apart == pytest.approx(alike, rel=1e-6)
    assert apart > 0.0


@pytest.mark.parametrize("error", ["kz", "ky", "tau"])
def test_an_error_of_a_tip_that_leans_in_a_side_force_moves_its_slope_as_said(error: str) -> None:
    """Against the slope itself, from samples with the error and without: a side force that both feel is no lean."""
    airframe = plain_airframe()
    layout, size = make_layout(airframe), 1e-4
    lean_rad, beat_radps = 0.05, 2.0 * np.pi * 0.4

    def measured(size: float) -> tuple[np.ndarray, np.ndarray]:
        t, _ = swinging(0.8, 0.0)
        streams = tuple(SampleBuffer(airframe.sensor(station)) for station in Station)
        for station in Station:
            off = size if station is Station.LEFT else 0.0
            felt_s = (t - EPOCH_NS) * 1e-9 - (off if error == "tau" else 0.0)
            side, down = 1.5 + 0.5 * np.sin(beat_radps * felt_s), -9.8 - 2.0 * np.cos(beat_radps * felt_s)
            values = np.zeros((len(t), 6))
            turn = lean_rad if station is Station.LEFT else 0.0
            values[:, 1] = (side * np.cos(turn) + down * np.sin(turn)) * (1.0 + (off if error == "ky" else 0.0))
            values[:, 2] = (down * np.cos(turn) - side * np.sin(turn)) * (1.0 + (off if error == "kz" else 0.0))
            streams[station].add(batch(station, t, values), 0)
        epochs = _builder(airframe, layout, streams).epochs(EPOCH_NS + 25 * STEP_NS, STEP_NS, 150)
        return epochs.rows[:, Y_LEFT], epochs.sensitivity[:, Y_LEFT]

    (with_error, _), (without, _) = measured(size), measured(-size)
    jacobian = (with_error - without) / (2.0 * size)
    said = measured(0.0)[1][:, layout.bias_parameters.index(f"left.{error}")]
    np.testing.assert_allclose(said[5:-5], jacobian[5:-5], rtol=0.05, atol=0.03 * np.abs(jacobian).max())
