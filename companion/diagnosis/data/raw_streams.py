"""Streams of a recording as they were written, made fit for a grid: rows of numbers alone, in order of time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from companion.diagnosis.data.observations import RawRecording, RawStream
from companion.diagnosis.data.stamps import by_stamp, in_order
from companion.errors import RecordingError
from companion.records import Floats


def finite_rows(raw: RawRecording) -> tuple[RawRecording, list[str]]:
    """The recording without rows that are no numbers, and sentences on how many were left out of each stream."""
    notes: list[str] = []
    tips = {side: _rows_of_numbers(stream, side.name.lower(), {}, notes)[0] for side, stream in raw.tips.items()}
    root, rigid = raw.root, dict(raw.rigid)
    if root is not None:
        root, rigid = _rows_of_numbers(root, "root", rigid, notes)
    covariates = {
        name: (t_s[good], values[good])
        for name, (t_s, values) in raw.covariates.items()
        if (good := np.isfinite(t_s) & np.isfinite(values)).any()
    }
    ranges = raw.ranges
    if ranges is not None:
        reference_m = ranges.range_m if ranges.reference_m is None else ranges.reference_m
        measured = np.isfinite(ranges.t_s) & ~np.isnan(ranges.range_m) & ~np.isnan(reference_m)  # infinite ones are
        ranges = ranges if measured.all() else ranges.taken(np.flatnonzero(measured))
    return RawRecording(tips, root, ranges, covariates, rigid), notes


def _rows_of_numbers(
    stream: RawStream, name: str, beside: Mapping[str, tuple[Floats, Floats]], notes: list[str]
) -> tuple[RawStream, dict[str, tuple[Floats, Floats]]]:
    """Rows of a stream, and of what was recorded with it, in which everything is a number."""
    columns = [stream.t_s, stream.force_z_mps2, *(values for _, values in beside.values())]
    lateral = stream.force_y_mps2
    good = np.all([np.isfinite(column) for column in (*columns, *([] if lateral is None else [lateral]))], axis=0)
    if len(stream.t_s) > 1 and good.any() and np.ptp(stream.force_z_mps2[good]) == 0.0:
        raise RecordingError(f"{name}_z never changes: check its sensor, or leave it out of the recording")
    if good.all():
        return stream, dict(beside)
    if not good.any():
        raise RecordingError(f"{name}: none of its {len(good)} samples is a number; look at what wrote the recording")
    notes.append(f"{name}: {np.count_nonzero(~good)} of {len(good)} samples are no numbers and count as lost")
    finite = RawStream(stream.t_s[good], stream.force_z_mps2[good], None if lateral is None else lateral[good])
    return finite, {key: (t_s[good], values[good]) for key, (t_s, values) in beside.items()}


def in_time_order(raw: RawRecording) -> tuple[RawRecording, list[str]]:
    """The recording with every stream in order of time, and what had to be done for it."""
    notes: list[str] = []
    tips = {side: _stream_in_order(stream, side.name.lower(), notes) for side, stream in raw.tips.items()}
    root, rigid = raw.root, dict(raw.rigid)
    if raw.root is not None:
        ordered = in_order(raw.root.t_s, raw.root.force_z_mps2)
        root = _stream_in_order(raw.root, "root", notes)
        rigid = {name: (ordered.t_s, values[ordered.rows]) for name, (_, values) in raw.rigid.items()}
    covariates = {name: _sorted(t_s, values) for name, (t_s, values) in raw.covariates.items()}
    return RawRecording(tips, root, raw.ranges and raw.ranges.taken(by_stamp(raw.ranges.t_s)), covariates, rigid), notes


def _stream_in_order(stream: RawStream, name: str, notes: list[str]) -> RawStream:
    ordered = in_order(stream.t_s, stream.force_z_mps2)
    if ordered.note:
        notes.append(f"{name}: {ordered.note}")
    lateral = None if stream.force_y_mps2 is None else stream.force_y_mps2[ordered.rows]
    return RawStream(ordered.t_s, stream.force_z_mps2[ordered.rows], lateral)


def _sorted(t_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    order = by_stamp(t_s)
    return t_s[order], values[order]
