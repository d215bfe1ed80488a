"""Reads recordings of any format for ``spanwise diagnose``: tip streams, root, covariates, ranges, on one clock."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.adapters.recordings.csv import CsvRecording
from companion.adapters.recordings.mapped_recording import MappedRecording
from companion.adapters.recordings.mapping import TableMapping
from companion.adapters.recordings.opening import open_recording
from companion.adapters.recordings.recording import Recording
from companion.core.clock.bank import ClockBank
from companion.diagnosis.observations import RawRanges, RawRecording, RawStream
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Axis, ClockRestart, Floats, ImuBatch, Ints, Reject, Side, Station, TimesyncReply

_SIDES = {Station.LEFT: Side.LEFT, Station.RIGHT: Side.RIGHT}
_ROLL_SMOOTHED_S = 0.05
_ROLL, _PITCH = 3, 4


def airframe_of(name: str | None, recordings: list[str]) -> Airframe:
    """The airframe that was asked for, or the one that travels with the first recording."""
    if name is not None:
        return load_airframe(name)
    return open_recording(Path(recordings[0])).airframe


def load(path: Path, airframe: Airframe, mapping: TableMapping | None = None) -> RawRecording:
    """Read one recording; a table in another layout through its mapping.

    Raises
    ------
    RecordingError
        It cannot be read, or has no wing accelerometer.
    """
    recording = MappedRecording(path, mapping, airframe) if mapping else open_recording(path, airframe)
    streams = _streams(recording)
    tips = {side: streams[station] for station, side in _SIDES.items() if station in streams}
    if not tips:
        raise RecordingError(f"{path}: no vertical wing accelerometer (left_z, right_z): nothing to diagnose")
    root = streams.get(Station.ROOT)
    raw_tips = {side: _tip(stream, root, recording.airframe, side) for side, stream in tips.items()}
    covariates, ranges = _tables(recording)
    raw_root = RawStream(root[0], root[1][:, 2]) if root is not None else None
    return RawRecording(raw_tips, raw_root, ranges, covariates, _rigid(root) if root is not None else {})


def _rigid(root: tuple[Floats, Floats]) -> dict[str, tuple[Floats, Floats]]:
    """The root's further axes, where they were measured."""
    t_s, values = root
    columns = {"x": 0, "y": 1, "p": 3, "q": 4, "r": 5}
    return {
        name: (t_s, values[:, column])
        for name, column in columns.items()
        if np.all(np.isfinite(values[:, column])) and np.any(values[:, column])
    }


def _streams(recording: Recording) -> dict[Station, tuple[Floats, Floats]]:
    """Times in seconds and values of every station that has a vertical accelerometer."""
    bank = ClockBank()
    bank.identity(recording.hub)
    found: dict[Station, tuple[list[Ints], list[Floats]]] = {}
    for record in recording.records():
        if isinstance(record, TimesyncReply):
            bank.exchange(record)
        elif isinstance(record, ClockRestart):
            bank.restart(record)
        elif isinstance(record, ImuBatch) and record.axes & Axis.Z:
            there = bank.to_host(record.clock, record.t_ns, record.received_host_ns)
            if not isinstance(there, Reject):
                times, values = found.setdefault(record.station, ([], []))
                times.append(there[0])
                values.append(record.values)
    return {station: _ordered(*parts) for station, parts in found.items()}


def _ordered(times: list[Ints], values: list[Floats]) -> tuple[Floats, Floats]:
    """Samples by time; of equal stamps the first is kept."""
    t_ns, first = np.unique(np.concatenate(times), return_index=True)
    return np.asarray(t_ns * 1e-9, dtype=np.float64), np.concatenate(values)[first]


def _tip(
    stream: tuple[Floats, Floats], root: tuple[Floats, Floats] | None, airframe: Airframe, side: Side
) -> RawStream:
    """A tip's vertical specific force without what rigid roll and pitch add over its lever arm."""
    t_s, values = stream
    force = values[:, 2]
    if root is not None:
        x, y, _ = airframe.sensor(Station.LEFT if side is Side.LEFT else Station.RIGHT).position_m
        lever = y * _angular_acceleration(root, _ROLL) - x * _angular_acceleration(root, _PITCH)
        force = force - np.interp(t_s, root[0], lever)
    return RawStream(t_s, np.asarray(force))


def _angular_acceleration(root: tuple[Floats, Floats], column: int) -> Floats:
    t_s, rate = root[0], np.nan_to_num(root[1][:, column])
    width = max(round(_ROLL_SMOOTHED_S / float(np.median(np.diff(t_s)))), 1)
    smooth = np.convolve(np.pad(rate, width, mode="edge"), np.ones(width) / width, mode="same")[width:-width]
    return np.asarray(np.gradient(smooth, t_s))


def _tables(recording: Recording) -> tuple[dict[str, tuple[Floats, Floats]], RawRanges | None]:
    if not isinstance(recording, CsvRecording | MappedRecording):
        return {}, None
    covariates = {entry.name: (entry.t_s, entry.values) for entry in recording.covariates.values()}
    table = recording.ranges
    if table is None:
        return covariates, None
    return covariates, RawRanges(table.t_s, table.range_m, table.reference_m)
