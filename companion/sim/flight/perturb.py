"""The aircraft as it really is: the believed airframe with every prior drawn."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.params.airframe import Airframe, Camera, NamedEffect, Sensor, Uncertain
from companion.records import ClockName, Floats, Ints, Station

# positive by nature: the prior is log-normal (companion.params.airframe)
_LOG_NORMAL = ("frequency_hz", "damping", "deflection_rms_m")
_CORNER_SPREAD = 0.3  # chosen: log-normal sigma of a gust's corner frequency: a third of it
_NODE_SKEW_PPM = 30.0  # chosen: a cheap crystal is tens of ppm off
_SHORTEST_LATENCY_S = 0.001  # chosen: no camera starts sooner; a draw below it is cut off
_ANTISYMMETRIC_RATIO = 0.6  # chosen: gusts bend both halves alike more than against each other


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Constant errors of one inertial sensor; (3,) arrays are body x, y, z.

    A reading is ``(1 + scale) * exp(-[misalignment]x) true + bias``; it shows the instant ``stamp - time_offset_s``.
    """

    accel_scale: Floats
    gyro_scale: Floats
    misalignment_rad: Floats
    time_offset_s: float


@dataclass(frozen=True, slots=True)
class TrueClock:
    """A clock other than the autopilot's: ``remote = epoch + (1 + skew) boot``."""

    epoch_ns: int
    skew_ppm: float

    def from_boot(self, t_boot_ns: int) -> int:
        """Remote time at an instant of boot time."""
        return self.epoch_ns + t_boot_ns + round(t_boot_ns * self.skew_ppm * 1e-6)

    def to_boot(self, remote_ns: Ints) -> Ints:
        """Boot times (n,) at which the clock shows these."""
        return np.round((remote_ns - self.epoch_ns) / (1 + self.skew_ppm * 1e-6)).astype(np.int64)


@dataclass(frozen=True, slots=True)
class TruthAirframe:
    """The real aircraft.

    Attributes
    ----------
    actual : Airframe
        Same schema as the belief; every value is the true one, every sigma 0, gust corners and effects included.
    errors : mapping of Station to SensorErrors
    clocks : mapping of ClockName to RemoteClock
        The nodes' clocks; the boot clock is the simulation's own.
    antisymmetric_rms_m : float
        Deflection rms that gusts give the antisymmetric mode; ``actual.wing.gust`` holds the symmetric one's.
    """

    actual: Airframe
    errors: Mapping[Station, SensorErrors]
    clocks: Mapping[ClockName, TrueClock]
    antisymmetric_rms_m: float


def draw_truth(airframe: Airframe, rng: np.random.Generator, effects: tuple[NamedEffect, ...] = ()) -> TruthAirframe:
    """Draw every :class:`Uncertain`, the sensor errors, the gust's colour and the clocks; add hidden effects."""
    actual: Airframe = _drawn(airframe, rng)
    low_hz, high_hz = (
        corner_hz * math.exp(_CORNER_SPREAD * rng.standard_normal()) for corner_hz in airframe.wing.gust.corners_hz
    )
    gust = dataclasses.replace(actual.wing.gust, corners_hz=(low_hz, high_hz))
    actual = dataclasses.replace(
        actual, wing=dataclasses.replace(actual.wing, gust=gust), effects=(*airframe.effects, *effects)
    ).with_cameras(lambda _, camera: _mounted(camera, rng))
    errors = {station: _sensor_errors(airframe.sensor(station), rng) for station in Station}
    clocks = {name: _clock(rng) for name in (ClockName.NODE_LEFT, ClockName.NODE_RIGHT)}
    ratio = _ANTISYMMETRIC_RATIO * math.exp(0.2 * rng.standard_normal())
    (later,) = rng.spawn(1)  # what came later to the file leaves the draws of all else as they were
    actual = actual.with_sensors(lambda _, sensor: _placed(sensor, later))
    return TruthAirframe(actual, errors, clocks, ratio * gust.deflection_rms_m.value)


def exact_truth(airframe: Airframe, effects: tuple[NamedEffect, ...] = ()) -> TruthAirframe:
    """Take the belief itself as truth, without sensor errors or clock differences (noise and bias stay): for tests."""
    zero = np.zeros(3)
    errors = {station: SensorErrors(zero, zero, zero, 0.0) for station in Station}
    clocks = {name: TrueClock(0, 0.0) for name in (ClockName.NODE_LEFT, ClockName.NODE_RIGHT)}
    actual = dataclasses.replace(airframe, effects=(*airframe.effects, *effects))
    return TruthAirframe(actual, errors, clocks, _ANTISYMMETRIC_RATIO * airframe.wing.gust.deflection_rms_m.value)


def _drawn(record: Any, rng: np.random.Generator) -> Any:
    """The record with every Uncertain below it drawn, in the order of declaration."""
    changes: dict[str, Any] = {}
    for entry in dataclasses.fields(record):
        value = getattr(record, entry.name)
        if isinstance(value, Uncertain):
            changes[entry.name] = _draw_parameter(entry.name, value, rng)
        elif dataclasses.is_dataclass(value):
            changes[entry.name] = _drawn(value, rng)
        elif isinstance(value, tuple) and all(dataclasses.is_dataclass(element) for element in value):
            changes[entry.name] = tuple(_drawn(element, rng) for element in value)
    return dataclasses.replace(record, **changes)


def _draw_parameter(name: str, belief: Uncertain, rng: np.random.Generator) -> Uncertain:
    if name == "shortening":
        (rng,) = rng.spawn(1)  # what came later to the file leaves the draws of all else as they were
    normal = float(rng.standard_normal())
    if name in _LOG_NORMAL and belief.value > 0:
        return Uncertain(belief.value * math.exp(normal * belief.sigma / belief.value))
    value = belief.value + normal * belief.sigma
    return Uncertain(max(value, _SHORTEST_LATENCY_S) if name == "latency_s" else value)


def _mounted(camera: Camera, rng: np.random.Generator) -> Camera:
    """The camera turned by its rotation prior."""
    turn = np.array(camera.rotation_rad) + camera.rotation_sigma_rad * rng.standard_normal(3)
    x, y, z = turn.tolist()
    return dataclasses.replace(camera, rotation_rad=(x, y, z), rotation_sigma_rad=0.0)


def _placed(sensor: Sensor, rng: np.random.Generator) -> Sensor:
    """The sensor higher or lower by its prior."""
    x, y, z = sensor.position_m
    height_m = sensor.height_sigma_m * float(rng.standard_normal())
    return dataclasses.replace(sensor, position_m=(x, y, z - height_m), height_sigma_m=0.0)


def _sensor_errors(sensor: Sensor, rng: np.random.Generator) -> SensorErrors:
    normal = rng.standard_normal((3, 3))
    return SensorErrors(
        sensor.accel_scale_sigma * normal[0],
        sensor.gyro_scale_sigma * normal[1],
        sensor.misalignment_sigma_rad * normal[2],
        sensor.time_offset_sigma_s * float(rng.standard_normal()),
    )


def _clock(rng: np.random.Generator) -> TrueClock:
    """A node has been up for up to an hour longer, and its crystal is tens of ppm off."""
    return TrueClock(int(rng.integers(10**9, 3600 * 10**9)), _NODE_SKEW_PPM * float(rng.standard_normal()))
