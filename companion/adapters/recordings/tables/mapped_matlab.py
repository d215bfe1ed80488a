"""The channels of a MATLAB v5 file, by the names of a mapping."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.tables.mapping import ColumnMapping, MatlabLayout, TableMapping
from companion.adapters.recordings.tables.matlab_file import read_matlab
from companion.errors import RecordingError, TableError
from companion.records import Floats


def matlab_columns(path: Path, mapping: TableMapping, layout: MatlabLayout) -> dict[str, Floats]:
    """Channels by the mapping's names: columns of ``array`` (rows, if it is wide), or variables.

    An optional one may be missing; a single number holds for the whole recording.

    Raises
    ------
    RecordingError
        No MATLAB v5 file, or not the variables that the mapping names, or as many names as neither side has.
    TableError
        A channel is missing, is not numbers, or is of another length; row and channel are named.
    """
    variables = read_matlab(path)
    names = _names(path, variables, layout)
    array = _array(path, variables, layout, len(names))
    channels: dict[str, Floats] = {}
    for column in mapping.columns:
        values = _channel(path, column, variables, array, names)
        if values is None and not column.optional:
            available = [*names, *sorted(name for name in variables if not name.startswith("__"))]
            raise RecordingError(
                f"{path}: no channel {column.label} of {mapping.origin}; it has {', '.join(available)}"
            )
        if values is not None:
            channels[column.name] = _checked(path, column, values)
    longest = max((len(values) for values in channels.values()), default=0)
    # a single number was set once for the whole recording
    channels = {name: np.full(longest, values[0]) if len(values) == 1 else values for name, values in channels.items()}
    lengths = {len(values) for values in channels.values()}
    if len(lengths) > 1:
        lengths_text = ", ".join(f"'{name}' {len(values)}" for name, values in channels.items())
        raise RecordingError(f"{path}: channels of different length: {lengths_text}")
    return channels


def _array(path: Path, variables: dict[str, Any], layout: MatlabLayout, channels: int) -> Any:
    if not layout.array:
        return None
    if layout.array not in variables:
        available = ", ".join(sorted(name for name in variables if not name.startswith("__")))
        raise RecordingError(f"{path}: no variable '{layout.array}'; it has {available}")
    array = variables[layout.array]
    if array.ndim != 2 or array.dtype.kind not in "iuf":
        raise RecordingError(f"{path}: variable '{layout.array}' is no table of numbers")
    if not layout.names:  # the longer side is time
        return array if array.shape[0] >= array.shape[1] else array.T
    if channels not in array.shape:
        raise RecordingError(
            f"{path}: '{layout.names}' has {channels} names, '{layout.array}' is {array.shape[0]} by {array.shape[1]}: "
            "give one name for each channel"
        )
    return array if array.shape[1] == channels else array.T


def _names(path: Path, variables: dict[str, Any], layout: MatlabLayout) -> list[str]:
    if not layout.names:
        return []
    if layout.names not in variables:
        raise RecordingError(f"{path}: no variable '{layout.names}' with the channels' names")
    entries = [np.asarray(entry).reshape(-1) for entry in variables[layout.names].reshape(-1)]
    return [str(entry[0]).strip() if entry.size else "" for entry in entries]


def _channel(path: Path, column: ColumnMapping, variables: dict[str, Any], array: Any, names: list[str]) -> Any:
    number = column.name[1:]
    if column.name.startswith("#") and number.isdigit():
        if array is None or not 0 < int(number) <= array.shape[1]:
            has = "no array" if array is None else f"{array.shape[1]} channels"
            raise RecordingError(f"{path}: column '{column.name}' ({column.channel}) is asked for, but there are {has}")
        return array[:, int(number) - 1]
    if array is not None and column.name in names:
        return array[:, names.index(column.name)]
    return variables.get(column.name)


def _checked(path: Path, column: ColumnMapping, values: Any) -> Floats:
    try:
        numbers: Floats = np.asarray(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise RecordingError(f"{path}: channel '{column.name}' ({column.channel}) is not numbers") from None
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        problem = f"column {column.label}: {numbers[bad[0]]} is not a finite number"
        raise TableError(path, int(bad[0]) + 1, problem)
    return numbers
