"""Which inertial message of which component belongs to which station, from the airframe's sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from companion.adapters.mavlink.decode.layouts import LAYOUTS
from companion.adapters.mavlink.link.dialect import ID_OF
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Source
from companion.records import Axis, ClockName, Floats, Ints, Station

AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1 (MAVLink common.xml)
_NANOSECONDS = 1_000_000_000  # per second (by definition)


@dataclass(frozen=True, slots=True)
class MappedSource:
    """One station's source, ready for use.

    ``body_from_sensor`` is (3, 3), or None where the axes agree; ``sends`` the body axes that are really measured.
    """

    station: Station
    message: int
    component: int
    instance: str
    clock: ClockName
    stamp_offset_ns: int
    body_from_sensor: Floats | None
    sends: Axis

    @property
    def order(self) -> Ints:
        """Sensor axis behind each body axis, (6,)."""
        matrix = np.eye(3) if self.body_from_sensor is None else self.body_from_sensor
        order = np.abs(matrix).argmax(axis=1)
        return np.concatenate([order, order + 3])

    @property
    def signs(self) -> Floats:
        """Sign of each body axis, (6,)."""
        matrix = np.eye(3) if self.body_from_sensor is None else self.body_from_sensor
        return np.tile(matrix.sum(axis=1), 2)


@dataclass(frozen=True, slots=True)
class SourceMap:
    """All stations' sources, and the clock of every component that has one."""

    sources: tuple[MappedSource, ...]
    clocks: dict[int, ClockName]

    @property
    def messages(self) -> frozenset[int]:
        """Ids of the inertial messages that any station listens to."""
        return frozenset(source.message for source in self.sources)


def build_mapping(airframe: Airframe) -> SourceMap:
    """Read the mapping from an airframe.

    Raises
    ------
    ConfigError
        An unknown message, axes that are no permutation (or mirror a gyro), two stations on one source, or one
        component with two clocks; the message names the airframe and the station.
    """
    sources = tuple(_mapped(airframe, station) for station in Station)
    stations: dict[tuple[int, int, str], Station] = {}
    clocks: dict[int, ClockName] = {AUTOPILOT_COMPONENT: ClockName.BOOT}
    for entry in sources:
        key = (entry.message, entry.component, entry.instance)
        if key in stations:
            _fail(airframe, entry.station, f"has the same source as {stations[key].name.lower()}: give each its own")
        stations[key] = entry.station
        if clocks.setdefault(entry.component, entry.clock) != entry.clock:
            problem = f"component {entry.component} has two clocks, {clocks[entry.component]} and {entry.clock}"
            _fail(airframe, entry.station, problem)
    return SourceMap(sources, clocks)


def _mapped(airframe: Airframe, station: Station) -> MappedSource:
    sensor = airframe.sensor(station)
    source = sensor.source
    message = ID_OF.get(source.message, -1)
    layout = LAYOUTS.get(message)
    if layout is None:
        inertial = ", ".join(sorted(entry.message for entry in LAYOUTS.values()))
        _fail(airframe, station, f"message '{source.message}' is not an inertial message; known: {inertial}")
    if layout.named and not source.instance:
        _fail(airframe, station, f"{source.message} needs 'instance', the name that the node gives it")
    sends = layout.axes & sensor.axes
    matrix = _rotation(airframe, station, source)
    if sends & Axis.GYRO and np.linalg.det(matrix) < 0:
        _fail(airframe, station, f"axes {list(source.axes)} mirror the sensor; a gyro can only be turned")
    instance = source.instance or ("" if layout.named else "0")
    return MappedSource(
        station,
        message,
        source.component,
        instance,
        source.clock,
        round(source.stamp_offset_s * _NANOSECONDS),
        None if np.array_equal(matrix, np.eye(3)) else matrix,
        sends,
    )


def _rotation(airframe: Airframe, station: Station, source: Source) -> Floats:
    matrix = np.zeros((3, 3))
    for row, spelled in enumerate(source.axes):
        letter = spelled.lstrip("+-")
        if len(letter) != 1 or letter not in "xyz" or len(spelled) > 2:
            _fail(airframe, station, f"axis '{spelled}' must be x, y or z with an optional sign")
        matrix[row, "xyz".index(letter)] = -1.0 if spelled.startswith("-") else 1.0
    if not np.array_equal(np.abs(matrix).sum(axis=0), np.ones(3)):
        _fail(airframe, station, f"axes {list(source.axes)} must name each of x, y, z once")
    return matrix


def _fail(airframe: Airframe, station: Station, problem: str) -> NoReturn:
    raise ConfigError(f"airframe '{airframe.name}', [{station.name.lower()}].source: {problem}")
