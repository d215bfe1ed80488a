"""The laboratory's format: a folder with ``accel.csv``, ``accel_<place>.csv`` and ``range.csv`` (config/README.md).

Samples become :class:`ImuBatch` on one clock that stands for the host's; covariates, inputs and ranges are tables.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.recording import InertialStream, LoggedRecording, join, merge, rate_of, timed
from companion.adapters.recordings.tables.number_table import read_table
from companion.adapters.recordings.tables.stamps import without_rounding
from companion.adapters.recordings.tables.units import ACCELERATION, ANGULAR_RATE, has_unit, input_in_si
from companion.errors import RecordingError, TableError
from companion.params.airframe import Airframe, Sensor
from companion.records import AXIS_LETTERS, Axis, ClockName, Floats, ImuBatch, Ints, Station
from companion.units import Severity

_PLACES = {station.name.lower(): station for station in Station}
_UNITS = {letter: ACCELERATION if letter in "xyz" else ANGULAR_RATE for letter in AXIS_LETTERS}
_INERTIAL = re.compile(r"([a-z]+)_([a-z])_([a-z0-9/^]+)")
_NEAR = re.compile(r"(?i)(root|left|right)_([xyzpqr])_(.+)")
_BARE = re.compile(rf"[{AXIS_LETTERS}]_[a-z0-9]+")
_COARSEST_STEP_S = 0.2  # of the lowest rate that an airframe may have (derived)
_FEWEST_STEPS = 20  # that show a rate (choice)
_LATEST_S = 9.2e9  # derived: whole nanoseconds of it still fit into 64 bits
_MOST_G = 3.0  # chosen: on average no flight pulls more; a higher mean is a wrong unit
_FEWEST = 100  # chosen: samples that gravity is judged by: fewer may all lie in one manoeuvre
RANGE_OPTIONAL = ("reference_m", "disparity_px", "t_command_s")


@dataclass(frozen=True, slots=True)
class Covariate:
    """A channel beside the inertial ones, ``values`` (n,) at ``t_s`` (n,); inputs are in SI, others as written."""

    name: str
    t_s: Floats
    values: Floats


@dataclass(frozen=True, slots=True)
class RangeTable:
    """``range.csv``: ranges as computed with the rigid extrinsics, at mid-exposure; optional columns may be None.

    ``range_m`` may be infinite where the rigid extrinsics give no finite answer.
    """

    t_s: Floats
    range_m: Floats
    reference_m: Floats | None = None
    disparity_px: Floats | None = None
    t_command_s: Floats | None = None
    further: dict[str, Floats] = field(default_factory=dict)


class CsvRecording(LoggedRecording):
    """A laboratory folder; see :class:`LoggedRecording` for the shared attributes.

    ``airframe`` has the axes and rates that are really there.

    ``streams`` has one stream for each place, rows as they stand; axes that come in two files are interpolated to the
    longer one's stamps.

    Raises
    ------
    RecordingError
        The folder has no accel.csv or accel_<place>.csv.
    TableError
        A column, unit, row or cell is wrong; file and line are named.
    """

    def __init__(self, path: Path, airframe: Airframe) -> None:
        super().__init__(path, airframe, ClockName.HOST)
        self.covariates: dict[str, Covariate] = {}
        parts = [stream for file in accel_files(path) for stream in self._accel(file)]
        if not parts:
            columns = ", ".join(self.covariates) or "t_s alone"
            problem = f"no column <place>_<axis>_<unit>, such as left_z_mps2; the columns are {columns}"
            raise TableError(accel_files(path)[0], 1, problem)
        self.streams = tuple(self._joined_by_station(parts))
        self.airframe = self._fitting(airframe)
        self.ranges = self._ranges(path / "range.csv")
        for stream in self.streams:
            for note in gravity(path, stream):
                self.notes.add(note)
            self.notes.gaps(f"{path.name}: {stream.station.name.lower()}", stream.t_ns)

    def records(self) -> Iterator[ImuBatch]:
        """The samples in batches of 20 ms, in order of time."""
        yield from merge(*map(timed, self.streams))

    def _accel(self, file: Path) -> Iterator[InertialStream]:
        table = read_table(file)
        place = file.stem.removeprefix("accel").lstrip("_")
        t_s, rounded = without_rounding(table["t_s"])
        if rounded:
            self.notes.add(f"{file}: {rounded}", severity=Severity.INFO)
        stations, others = by_station(file, place, table)
        for name, values in others.items():
            if name != "t_s":
                self._covariate(file, name, t_s, values)
        for station, columns in sorted(stations.items()):
            yield stream_of(station, nanoseconds(file, t_s), columns)

    def _covariate(self, file: Path, name: str, t_s: Floats, values: Floats) -> None:
        if not has_unit(name):
            self.notes.add(f"{file}: column '{name}' ends in no unit that is known; taken as a number without unit")
        si_name, factor = input_in_si(name) if name.startswith("input_") else (name, 1.0)
        if si_name in self.covariates:
            self.notes.add(f"{file}: column '{name}' is in another file or unit already, which is used")
            return
        self.covariates[si_name] = Covariate(si_name, t_s, values * factor)

    def _joined_by_station(self, streams: list[InertialStream]) -> Iterator[InertialStream]:
        for station in sorted({stream.station for stream in streams}):
            of_station = [stream for stream in streams if stream.station is station]
            place = station.name.lower()
            if len(of_station) > 1 and of_station[0].axes & of_station[1].axes:
                raise TableError(self.path / f"accel_{place}.csv", 1, f"axes of '{place}' are in accel.csv as well")
            yield join(of_station if len(of_station) == 1 else [increasing(stream) for stream in of_station])

    def _fitting(self, airframe: Airframe) -> Airframe:
        present = {stream.station for stream in self.streams}
        for station in (station for station in Station if station not in present):
            self.say(f"no samples of '{station.name.lower()}'")
        return airframe_as_recorded(airframe, self.streams)

    def _ranges(self, file: Path) -> RangeTable | None:
        if not file.exists():
            return None
        columns = read_table(file, ("range_m",), frozenset({"range_m"}))
        optional: dict[str, Any] = {name: columns.get(name) for name in RANGE_OPTIONAL}
        further = {name: columns[name] for name in columns if name not in ("t_s", "range_m", *RANGE_OPTIONAL)}
        for name in further:
            if not has_unit(name):
                self.notes.add(f"{file}: column '{name}' is none of {', '.join(('range_m', *RANGE_OPTIONAL))}; kept")
        return RangeTable(columns["t_s"], columns["range_m"], **optional, further=further)


def accel_files(folder: Path) -> list[Path]:
    """``accel.csv`` and ``accel_<place>.csv`` of a folder; raise RecordingError for none, or an unknown place."""
    files = [file for file in (folder / "accel.csv", *sorted(folder.glob("accel_*.csv"))) if file.exists()]
    if not files:
        raise RecordingError(f"{folder}: no accel.csv in this folder")
    for file in files:
        if file.stem != "accel" and file.stem.removeprefix("accel_") not in _PLACES:
            raise RecordingError(f"{file}: the place must be one of {', '.join(_PLACES)}, as in accel_left.csv")
    return files


def by_station(
    file: Path, place: str, columns: Mapping[str, Floats]
) -> tuple[dict[Station, list[tuple[int, Floats]]], dict[str, Floats]]:
    """Inertial columns (n,) in SI by station, each with the index of its axis, and the other columns by name.

    ``place`` is that of ``accel_<place>.csv``, or "". Raises TableError where place, axis or unit is wrong.
    """
    stations: dict[Station, list[tuple[int, Floats]]] = {}
    others: dict[str, Floats] = {}
    for name, values in columns.items():
        column = _inertial_column(file, name, place)
        if column is None:
            others[name] = values
        else:
            station, index, factor = column
            stations.setdefault(station, []).append((index, values if factor == 1.0 else values * factor))
    return stations, others


def _inertial_column(file: Path, name: str, place: str) -> tuple[Station, int, float] | None:
    """Station, index of the axis and factor to SI of an inertial column; None for a covariate."""
    if place and _BARE.fullmatch(name):
        name = f"{place}_{name}"
    parts = _INERTIAL.fullmatch(name)
    if parts is None:
        near = _NEAR.fullmatch(name)
        if near is not None:
            units = ", ".join(_UNITS[near[2].lower()])
            problem = f"column '{name}': small letters and one unit of {units} are expected, such as left_z_mps2"
            raise TableError(file, 1, problem)
        if name.split("_")[0] in _PLACES and "_" in name and len(name.split("_")) < 3:
            raise TableError(file, 1, f"column '{name}' must be <place>_<axis>_<unit>, such as left_z_mps2")
        return None
    where, axis, unit = parts.groups()
    inertial_unit = unit in ACCELERATION or unit in ANGULAR_RATE
    if where not in _PLACES:
        if axis in AXIS_LETTERS and inertial_unit and where not in ("input", "base"):
            raise TableError(file, 1, f"column '{name}': place '{where}' must be one of {', '.join(_PLACES)}")
        return None
    if axis not in AXIS_LETTERS:
        raise TableError(file, 1, f"column '{name}': axis '{axis}' must be x, y, z (specific force) or p, q, r (rate)")
    if unit not in _UNITS[axis]:
        raise TableError(file, 1, f"column '{name}': unit '{unit}' must be one of {', '.join(_UNITS[axis])}")
    if place and where != place:
        raise TableError(file, 1, f"column '{name}' does not belong into {file.name}")
    return _PLACES[where], AXIS_LETTERS.index(axis), _UNITS[axis][unit]


def stream_of(station: Station, t_ns: Ints, columns: list[tuple[int, Floats]]) -> InertialStream:
    """A station's stream of axes by index, each (n,)."""
    values = np.zeros((t_ns.size, 6))
    axes = Axis.NONE
    for index, column in columns:
        values[:, index] = column
        axes |= Axis(1 << index)
    return InertialStream(station, ClockName.HOST, axes, t_ns, values)


def increasing(stream: InertialStream) -> InertialStream:
    """The samples by their stamps, of equal ones the first: axes in two files can be joined by nothing else."""
    t_ns, rows = np.unique(stream.t_ns, return_index=True)
    return dataclasses.replace(stream, t_ns=t_ns, values=stream.values[rows])


def gravity(path: Path, stream: InertialStream) -> Iterator[str]:
    """Look for gravity in the vertical axis: a sentence where it is missing.

    Raises
    ------
    RecordingError
        It has the wrong sign, or is more than any wing bears: the unit must be another one.
    """
    if not stream.axes & Axis.Z or stream.t_ns.size < _FEWEST:
        return
    median_g = float(np.median(stream.values[:, 2])) / ACCELERATION["g"]  # a wild sample may be as large as it likes
    reads = f"'{stream.station.name.lower()}_z' reads {median_g:+.2f} g in the median"
    if median_g > 0.5:
        raise RecordingError(f"{path}: {reads}; body z points down, so at rest it must read -1 g: turn its sign")
    if median_g < -_MOST_G:
        raise RecordingError(f"{path}: {reads}, where about -1 g is expected: is its unit right?")
    if median_g > -0.5:
        yield f"{reads}, where about -1 g is expected: gravity was taken out, or its unit is another"


def airframe_as_recorded(airframe: Airframe, streams: Iterable[InertialStream]) -> Airframe:
    """The airframe with the axes and the rates that are really there."""
    sensors: dict[str, Any] = {
        stream.station.name.lower(): _as_recorded(airframe.sensor(stream.station), stream) for stream in streams
    }
    return dataclasses.replace(airframe, **sensors)


def _as_recorded(sensor: Sensor, stream: InertialStream) -> Sensor:
    sends = "".join(AXIS_LETTERS[column] for column in stream.axes.columns)
    source = dataclasses.replace(sensor.source, clock=ClockName.HOST, stamp_offset_s=0.0)
    return dataclasses.replace(sensor, sends=sends, rate_hz=rate_of(stream.t_ns, sensor.rate_hz), source=source)


def nanoseconds(path: Path, t_s: Floats) -> Ints:
    """Seconds (n,) as whole nanoseconds.

    Raises
    ------
    RecordingError
        They do not fit, or come more rarely than any sensor's: the stamps are in another unit.
    """
    largest = float(np.max(np.abs(t_s), initial=0.0))
    if largest > _LATEST_S:
        raise RecordingError(f"{path}: t_s reaches {largest:.4g}, t_s must be in seconds: convert it, or map its unit")
    steps_s = np.diff(t_s)
    steps_s = steps_s[steps_s > 0.0]
    step_s = float(np.median(steps_s)) if len(steps_s) >= _FEWEST_STEPS else 0.0
    if step_s > _COARSEST_STEP_S:
        raise RecordingError(
            f"{path}: samples come every {step_s:.4g} s, and a sensor's at {1.0 / _COARSEST_STEP_S:g} Hz and more: "
            "is t_s in seconds? Convert it, or map its unit"
        )
    return np.rint(t_s * 1e9).astype(np.int64)
