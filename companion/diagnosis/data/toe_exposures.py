"""Exposures of a recording: the toe that the pair measured, and what tips tell of their slow tilt there."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from companion.diagnosis.data.interpolation import in_gaps, on_grid
from companion.diagnosis.data.observations import RawRanges, RawRecording, RawStream, ToeData, clear_of_ends
from companion.diagnosis.data.rigid_motion import undo_lowpass
from companion.diagnosis.data.segments import Segment
from companion.diagnosis.data.tilt_measurement import TipSamples, tip_tilt
from companion.diagnosis.data.tip_tilt import TipTilt
from companion.params.airframe import Airframe
from companion.records import Bools, Floats, Side

_FEWEST_EXPOSURES = 20  # convention: for a likelihood of the toe
_GAP_MARGIN_S = 1.0  # about a bridged gap, at most: there the smoothed wing is not known (choice)
_NEARLY_CUT = 0.99  # of a gyro's range: a rate that was cut has no integral (choice)


def toe_of(raw: RawRecording, airframe: Airframe, segments: Sequence[Segment]) -> list[ToeData | None]:
    """Toe (k,) at the exposures of each segment; without a reference the mean distance of all of them stands for it."""
    ranges = raw.ranges
    left_camera, right_camera = airframe.left_camera, airframe.right_camera
    if ranges is None or left_camera is None or right_camera is None:
        return [None] * len(segments)
    baseline_m = right_camera.position_m[1] - left_camera.position_m[1]
    used = [_exposures(ranges, segment) for segment in segments]
    inverse = np.zeros(len(ranges.t_s))  # of an infinite range it is 0, which is what was measured
    np.divide(1.0, ranges.range_m, out=inverse, where=ranges.range_m != 0.0)
    if ranges.reference_m is not None:
        reference = 1.0 / ranges.reference_m
    else:
        reference = np.full(len(inverse), inverse[np.any(used, axis=0)].mean() if np.any(used) else 0.0)
    toe_rad = baseline_m * (inverse - reference)
    return [
        ToeData(
            ranges.t_s[exposures] - segments[0].start_s,
            toe_rad[exposures],
            reference[exposures],
            ranges.reference_m is not None,
            _tilt(raw, airframe, segment, ranges.t_s[exposures], segments[0].start_s),
        )
        if exposures.sum() >= _FEWEST_EXPOSURES
        else None
        for exposures, segment in zip(used, segments, strict=True)
    ]


def _exposures(ranges: RawRanges, segment: Segment) -> Bools:
    """Which ranges were made where the smoothed wing is known."""
    inside = clear_of_ends(ranges.t_s, segment.start_s, segment.stop_s) & (ranges.range_m != 0.0)
    return np.asarray(inside & ~in_gaps(segment.gaps, ranges.t_s, _GAP_MARGIN_S))


def _tilt(raw: RawRecording, airframe: Airframe, segment: Segment, at_s: Floats, begun_s: float) -> TipTilt | None:
    """Tilt at the exposures ``at_s`` (k,); None where an axis is missing, a gyro was cut or samples were lost."""
    if segment.gaps or raw.root is None or "p" not in raw.rigid or len(raw.tips) < len(Side):
        return None
    step_s = max(float(np.median(np.diff(stream.t_s))) for stream in raw.tips.values())
    t_s: Floats = segment.start_s + np.arange(int((segment.stop_s - segment.start_s) / step_s)) * np.float64(step_s)
    forces, lateral, rolls = [], [], []
    for side in Side:
        stream, sensor = raw.tips[side], (airframe.left, airframe.right)[side]
        if stream.force_y_mps2 is None or stream.roll_radps is None:
            return None
        if float(np.abs(stream.roll_radps).max()) > _NEARLY_CUT * sensor.gyro_range_radps:
            return None
        forces.append(on_grid(stream, t_s))
        lateral.append(on_grid(RawStream(stream.t_s, stream.force_y_mps2), t_s))
        rolls.append(on_grid(RawStream(stream.t_s, stream.roll_radps), t_s))
    root_z = undo_lowpass(on_grid(raw.root, t_s), 1.0 / step_s, airframe.root.lowpass_accel_hz)
    samples = TipSamples(t_s, np.stack(lateral), np.stack(forces), np.stack(rolls), root_z, dict(raw.rigid))
    tilt = tip_tilt(samples, airframe, at_s)
    return dataclasses.replace(tilt, t_s=tilt.t_s - begun_s)
