"""Reads a ground vibration test: MATLAB files of force and roving accelerometers, and the layout that explains them.

The layout is a TOML file::

    rate_hz = 2000.0
    band_hz = [4.0, 35.5]
    force = { column = 1, newton_per_volt = 9.4967 }
    accelerometers = { columns = [2, 3], mps2_per_volt = 9.5396 }
    [[points]]   # one per point; span_m > 0 right, edge is "leading" or "trailing"
    number = 1
    span_m = 0.454
    aft_m = 0.483
    edge = "leading"
    [[runs]]
    file = "run_Run1.mat"
    points = [1, 2]   # one per column of accelerometers
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.calibration.modes import FrequencyResponse
from companion.errors import ConfigError, RecordingError
from companion.params.toml import read_toml
from companion.records import Floats, Ints

_SIGNALS = "signalIn"
_EDGES = ("leading", "trailing")
_LEAST_LINES = 16  # chosen: halves of eight lines, a mode's unknowns in each response
_FASTEST_HZ = 1e6  # a higher rate is a wrong unit (choice)


@dataclass(frozen=True, slots=True)
class Point:
    """A measured point: span station (right positive), distance aft, and which edge it is on."""

    number: int
    span_m: float
    aft_m: float
    leading: bool


@dataclass(frozen=True, slots=True)
class VibrationTest:
    """A test that has been read."""

    points: list[Point]
    runs: list[FrequencyResponse]


def read_vibration_test(
    layout_path: Path, folder: Path, read_matlab: Callable[[Path], Mapping[str, Any]]
) -> VibrationTest:
    """Read layout and runs; ``read_matlab`` gives the variables of a file by name.

    Raises
    ------
    ConfigError
        The layout is missing, no TOML, or lacks a key, a value of it is of the wrong kind, or its points and runs do
        not belong to each other.
    RecordingError
        A run's file is missing or has no such channel, or a channel has samples that are no numbers.
    """
    layout = _layout(layout_path)
    if "test" in layout and "points" not in layout:
        raise ConfigError(f"{layout_path}: is a mapping for spanwise diagnose, not a layout of points and runs")
    try:
        points = [_point(entry) for entry in layout["points"]]
        place = {point.number: index for index, point in enumerate(points)}
        if len(place) < len(points):
            raise ValueError(f"point {_twice([point.number for point in points])} stands twice in points")
        if not layout["runs"]:
            raise ValueError("runs is empty: name each run's file and points")
        runs = [_run(layout, entry, place, folder, read_matlab) for entry in layout["runs"]]
    except KeyError as error:
        raise ConfigError(f"{layout_path}: key {error} is missing") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{layout_path}: a value that cannot be: {error}") from error
    return VibrationTest(points, runs)


def _point(entry: dict[str, Any]) -> Point:
    number, edge = int(entry["number"]), entry["edge"]
    if edge not in _EDGES:
        raise ValueError(f"edge of point {number} must be {' or '.join(_EDGES)}, not '{edge}'")
    return Point(number, float(entry["span_m"]), float(entry["aft_m"]), edge == _EDGES[0])


def _twice(numbers: list[int]) -> int | None:
    """The first number that stands there before; None where all differ."""
    return next((number for k, number in enumerate(numbers) if number in numbers[:k]), None)


def frequency_response(
    force: Floats, answers: Floats, rate_hz: float, band_hz: tuple[float, float]
) -> FrequencyResponse:
    """Responses of a whole record to its force: one transform, no window, for sweeps that start and end at rest.

    Parameters
    ----------
    force : (n,) float64
        Newton.
    answers : (n, m) float64
        Metres per second squared.
    rate_hz : float
        Of the samples.
    band_hz : tuple
        Which lines are kept.

    Returns
    -------
    FrequencyResponse
        Without a name; its points are counted from 0.
    """
    frequency: Floats = np.asarray(np.fft.rfftfreq(len(force), 1.0 / rate_hz), dtype=np.float64)
    inside = (frequency > band_hz[0]) & (frequency < band_hz[1])
    pushed = np.fft.rfft(force - force.mean())[inside]
    answered = np.fft.rfft(answers - answers.mean(axis=0), axis=0)[inside]
    return FrequencyResponse("", np.arange(answers.shape[1]), frequency[inside], (answered / pushed[:, np.newaxis]).T)


def _run(
    layout: dict[str, Any],
    entry: dict[str, Any],
    place: dict[int, int],
    folder: Path,
    read_matlab: Callable[[Path], Mapping[str, Any]],
) -> FrequencyResponse:
    path = folder / str(entry["file"])
    numbers = _measured_points(layout, entry, place)
    signals, pushed, answering = _signals(path, layout, read_matlab)
    band_hz = layout["band_hz"]
    if not (isinstance(band_hz, list) and len(band_hz) == 2 and all(isinstance(end, int | float) for end in band_hz)):
        raise ValueError("band_hz must be two frequencies, as [4.0, 35.5]")
    low, high = band_hz
    if not 0.0 < float(layout["rate_hz"]) <= _FASTEST_HZ:
        raise ValueError(f"rate_hz must be above 0 and at most {_FASTEST_HZ:g}")
    if not 0.0 <= float(low) < float(high) <= 0.5 * float(layout["rate_hz"]):
        raise ValueError("band_hz must be two frequencies, the lower first, up to half of rate_hz")
    if not np.ptp(signals[:, pushed]) > 0.0:
        raise RecordingError(f"{path}: the force, column {pushed}, never changes: check force.column and its sensor")
    run = frequency_response(
        signals[:, pushed] * float(layout["force"]["newton_per_volt"]),
        signals[:, answering] * float(layout["accelerometers"]["mps2_per_volt"]),
        float(layout["rate_hz"]),
        (float(low), float(high)),
    )
    if len(run.frequency_hz) < _LEAST_LINES:
        lines = f"{len(run.frequency_hz)} lines of the spectrum lie in band_hz"
        raise RecordingError(f"{path}: {lines}, {_LEAST_LINES} are needed: record longer or widen the band")
    return FrequencyResponse(path.stem, numbers, run.frequency_hz, run.response)


def _measured_points(layout: dict[str, Any], entry: dict[str, Any], place: dict[int, int]) -> Ints:
    """Places among the points of those that a run measured, (accelerometers,)."""
    numbers, columns = [int(number) for number in entry["points"]], layout["accelerometers"]["columns"]
    run = f"the run of {entry['file']}"
    if len(numbers) != len(columns):
        raise ValueError(f"{run} names {len(numbers)} points for {len(columns)} columns of accelerometers")
    again, unknown = _twice(numbers), [number for number in numbers if number not in place]
    if again is not None:
        raise ValueError(f"{run} names point {again} twice")
    if unknown:
        raise ValueError(f"{run} names point {unknown[0]}, which is not among the points")
    return np.array([place[number] for number in numbers], dtype=np.int64)


def _signals(
    path: Path, layout: dict[str, Any], read_matlab: Callable[[Path], Mapping[str, Any]]
) -> tuple[Floats, int, list[int]]:
    """Table of a run's signals, (n, channels), with the columns of the force and of the accelerometers."""
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    table = read_matlab(path).get(_SIGNALS)
    if table is None or table.dtype.kind not in "iuf" or table.ndim != 2:
        raise RecordingError(f"{path}: has no table of numbers '{_SIGNALS}'")
    wanted = [int(column) for column in (layout["force"]["column"], *layout["accelerometers"]["columns"])]
    worst = max(wanted, key=abs)
    if not all(0 <= column < table.shape[1] for column in wanted):
        raise RecordingError(f"{path}: has {table.shape[1]} channels, the layout asks for column {worst}")
    signals: Floats = table.astype(np.float64)
    holed = [column for column in wanted if not np.isfinite(signals[:, column]).all()]
    if holed:
        raise RecordingError(f"{path}: column {holed[0]} has samples that are no numbers: record the run once more")
    return signals, wanted[0], wanted[1:]


def _layout(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ConfigError(f"{path}: no such file; the layout of the test names points, channels and runs")
    return read_toml(path)
