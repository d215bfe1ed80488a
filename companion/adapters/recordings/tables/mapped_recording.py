"""A flight, or a wing in a laboratory, recorded as a table in another layout: read through a mapping."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.recordings.recording import InertialStream, LoggedRecording, merge, timed
from companion.adapters.recordings.tables.csv import (
    Covariate,
    RangeTable,
    airframe_as_recorded,
    by_station,
    gravity,
    nanoseconds,
    stream_of,
)
from companion.adapters.recordings.tables.mapped_table import MAY_BE_MISSING, MappedTable, read_mapped
from companion.adapters.recordings.tables.mapping import TableMapping
from companion.adapters.recordings.tables.stamps import without_rounding
from companion.errors import TableError
from companion.params.airframe import Airframe
from companion.records import ClockName, ImuBatch
from companion.units import Severity


class MappedRecording(LoggedRecording):
    """A mapped table as a recording, with what :class:`~companion.adapters.recordings.tables.csv.CsvRecording` has.

    Raises
    ------
    RecordingError, TableError
        As :func:`~companion.adapters.recordings.tables.mapped_table.read_mapped`; and where no channel is of an
        inertial sensor.
    """

    def __init__(self, path: Path, mapping: TableMapping, airframe: Airframe) -> None:
        super().__init__(path, airframe, ClockName.HOST)
        table = read_mapped(path, mapping)
        t_s, rounded = without_rounding(table.t_s)
        table = dataclasses.replace(table, t_s=t_s)
        for note in table.notes:
            self.notes.add(note)
        if rounded:
            self.notes.add(f"{path}: {rounded}", severity=Severity.INFO)
        self.covariates: dict[str, Covariate] = {}
        self.streams = tuple(self._streams(table, mapping))
        self.ranges = _ranges(table)
        self.airframe = airframe_as_recorded(airframe, self.streams)
        for note in (note for stream in self.streams for note in gravity(path, stream)):
            self.notes.add(note)
        for stream in self.streams[:1]:  # all have the same stamps
            self.notes.gaps(path.name, stream.t_ns)

    def records(self) -> Iterator[ImuBatch]:
        """The samples in batches of 20 ms, in order of time."""
        yield from merge(*map(timed, self.streams))

    def _streams(self, table: MappedTable, mapping: TableMapping) -> Iterator[InertialStream]:
        stations, others = by_station(Path(mapping.origin), "", table.channels)
        for name, values in others.items():
            if name not in MAY_BE_MISSING:
                self.covariates[name] = Covariate(name, table.t_s, values)
        if not stations:
            raise TableError(Path(mapping.origin), 1, "no channel <place>_<axis>_<unit>, such as left_z_mps2")
        t_ns = nanoseconds(table.path, table.t_s)
        for station, columns in sorted(stations.items()):
            yield stream_of(station, t_ns, columns)


def _ranges(table: MappedTable) -> RangeTable | None:
    """Rows in which the pair made a range."""
    range_m = table.channels.get("range_m")
    if range_m is None:
        return None
    measured = ~np.isnan(range_m)
    others = {name: values[measured] for name, values in table.channels.items() if name in MAY_BE_MISSING}
    complete: dict[str, Any] = {name: others[name] for name in others if not np.isnan(others[name]).any()}
    complete.pop("range_m", None)
    return RangeTable(table.t_s[measured], range_m[measured], **complete)
