"""Samples of a wing that swings in one pure mode, as the three stations of nadir-2m would send them at 1 kHz."""

from __future__ import annotations

import dataclasses

import numpy as np

from companion.core.tracking.parameters import ModeParameters, prior_parameters
from companion.core.tracking.states import SensorNoise, StateLayout, make_layout, make_noise
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Station

G = 9.80665
EPOCH_NS = 7_000_000_000
MS = 1_000_000


def plain_airframe() -> Airframe:
    """The demo's aircraft with an unfiltered 1 kHz root."""
    airframe = load_airframe("nadir-2m")
    root = dataclasses.replace(airframe.root, rate_hz=1000.0, lowpass_accel_hz=0.0, lowpass_gyro_hz=0.0)
    return dataclasses.replace(airframe, root=root)


def prior_of(
    airframe: Airframe, step_s: float
) -> tuple[StateLayout, SensorNoise, tuple[ModeParameters, ModeParameters]]:
    """The states, the noise per step and both families' prior parameters that the filter starts with."""
    layout = make_layout(airframe)
    gust = airframe.wing.gust
    believed = (prior_parameters(layout.symmetric, gust), prior_parameters(layout.antisymmetric, gust))
    return layout, make_noise(airframe, layout, step_s), believed


def swinging(seconds: float, amplitude_m: float) -> tuple[np.ndarray, dict[Station, np.ndarray]]:
    """A symmetric 5 Hz bending that is seen by the vertical axes and, by its slope, by the other two.

    The lateral axes feel the bent wing's way inboard, too.
    """
    t = np.arange(round(seconds * 1000)) * 1e-3
    w, rng = 2 * np.pi * 5.0, np.random.default_rng(2)
    bend = amplitude_m * np.cos(w * t)
    values = {}
    for station in Station:
        v = rng.normal(size=(len(t), 6)) * np.repeat([0.016, 0.0011], 3)
        v[:, 2] -= G
        if station is not Station.ROOT:
            side = 1.0 if station is Station.LEFT else -1.0
            lift, slope = bend + 0.0149, 1.39 * (bend + 0.0149)
            across = side * 1.16194 * ((w * amplitude_m * np.sin(w * t)) ** 2 - lift * w**2 * bend)
            down = -G + w**2 * bend
            v[:, 1] += np.cos(slope) * across + side * np.sin(slope) * down
            v[:, 2] += G + np.cos(slope) * down - side * np.sin(slope) * across
            v[:, 3] -= side * 1.39 * w * amplitude_m * np.sin(w * t)
        values[station] = v
    return EPOCH_NS + np.round(t * 1e9).astype(np.int64), values


def batch(station: Station, t_ns: np.ndarray, values: np.ndarray) -> ImuBatch:
    """Host-stamped samples of all six axes, received with the last."""
    return ImuBatch(station, ClockName.HOST, t_ns, values, Axis.ALL, int(t_ns[-1]))
