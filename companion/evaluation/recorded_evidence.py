"""Reads recordings of any format for ``spanwise diagnose``: tip streams, root, covariates, ranges, on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.recording_factory import open_recording
from companion.adapters.recordings.tables.csv import CsvRecording
from companion.adapters.recordings.tables.mapped_recording import MappedRecording
from companion.adapters.recordings.tables.mapping import TableMapping
from companion.core.clock.bank import ClockBank
from companion.diagnosis.data.observations import RawRanges, RawRecording, RawStream
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Axis, ClockRestart, Floats, ImuBatch, Ints, Reject, Side, Station, TimesyncReply

_SIDES = {Station.LEFT: Side.LEFT, Station.RIGHT: Side.RIGHT}


def airframe_of(name: str | None, recordings: list[str]) -> Airframe:
    """The airframe that was asked for, or the one that travels with the first recording."""
    if name is not None:
        return load_airframe(name)
    return open_recording(Path(recordings[0])).airframe


def open_mapped(path: Path, airframe: Airframe, mapping: TableMapping | None) -> Recording:
    """Open a recording; a table in another layout through its mapping."""
    return MappedRecording(path, mapping, airframe) if mapping else open_recording(path, airframe)


def load(path: Path, airframe: Airframe, mapping: TableMapping | None = None) -> RawRecording:
    """Read one recording; a table in another layout through its mapping.

    Raises
    ------
    RecordingError
        It cannot be read, has no wing accelerometer, or two tips of the same samples.
    """
    recording = open_mapped(path, airframe, mapping)
    streams = _streams(recording)
    tips = {side: _tip(streams[station]) for station, side in _SIDES.items() if station in streams}
    if not tips:
        raise RecordingError(f"{path}: no vertical wing accelerometer (left_z, right_z): nothing to diagnose")
    _two_sensors(path, tips)
    root = streams.get(Station.ROOT)
    covariates, ranges = _tables(recording)
    if root is None:
        return RawRecording(tips, None, ranges, covariates)
    return RawRecording(tips, RawStream(root[0], root[1][:, 2]), ranges, covariates, _rigid(root))


def _tip(stream: tuple[Floats, Floats]) -> RawStream:
    t_s, values = stream
    return RawStream(t_s, values[:, 2], values[:, 1] if _measured(values[:, 1]) else None)


def _two_sensors(path: Path, tips: Mapping[Side, RawStream]) -> None:
    first, *others = (tip.force_z_mps2 for tip in tips.values())
    if any(np.array_equal(first, other) and np.ptp(first) > 0.0 for other in others):
        raise RecordingError(f"{path}: left_z and right_z are the same samples, those of one sensor: check the mapping")


def _rigid(root: tuple[Floats, Floats]) -> dict[str, tuple[Floats, Floats]]:
    """The root's further axes, where they were measured."""
    t_s, values = root
    columns = {"x": 0, "y": 1, "p": 3, "q": 4, "r": 5}
    return {name: (t_s, values[:, column]) for name, column in columns.items() if _measured(values[:, column])}


def _measured(column: Floats) -> bool:
    return bool(np.all(np.isfinite(column)) and np.any(column))


def _streams(recording: Recording) -> dict[Station, tuple[Floats, Floats]]:
    """Times in seconds and values of every station that has a vertical accelerometer."""
    bank = ClockBank()
    bank.identity(recording.hub)
    by_station: dict[Station, tuple[list[Ints], list[Floats]]] = {}
    for record in recording.records():
        if isinstance(record, TimesyncReply):
            bank.exchange(record)
        elif isinstance(record, ClockRestart):
            bank.restart(record)
        elif isinstance(record, ImuBatch) and record.axes & Axis.Z:
            host_stamps = bank.to_host(record.clock, record.t_ns, record.received_host_ns)
            if not isinstance(host_stamps, Reject):
                times, values = by_station.setdefault(record.station, ([], []))
                times.append(host_stamps[0])
                values.append(record.values)
    return {
        station: (np.concatenate(times) * np.float64(1e-9), np.concatenate(values))
        for station, (times, values) in by_station.items()
    }


def _tables(recording: Recording) -> tuple[dict[str, tuple[Floats, Floats]], RawRanges | None]:
    if not isinstance(recording, CsvRecording | MappedRecording):
        return {}, None
    covariates = {entry.name: (entry.t_s, entry.values) for entry in recording.covariates.values()}
    table = recording.ranges
    if table is None:
        return covariates, None
    return covariates, RawRanges(table.t_s, table.range_m, table.reference_m)
