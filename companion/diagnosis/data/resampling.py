"""Raw streams of any rate, with gaps and stamps that wander, on uniform grids."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from companion.core.wing.samples import SampleDefect
from companion.diagnosis.data.declipping import impute_clipped
from companion.diagnosis.data.grid import fast_length
from companion.diagnosis.data.imputation import impute_missing
from companion.diagnosis.data.observations import (
    Observations,
    RawRanges,
    RawRecording,
    RawStream,
    ToeData,
    clear_of_ends,
)
from companion.diagnosis.data.raw_streams import finite_rows, in_time_order
from companion.diagnosis.data.recoil import RecoilDelay, recoil_delay
from companion.diagnosis.data.rigid_motion import (
    bending_load,
    lateral_force,
    roll_rate,
    roll_share,
    rotation_forces,
    undo_lowpass,
)
from companion.diagnosis.data.sample_defects import (
    clipped_sides,
    find_sample_defects,
    interpolate_clipped,
    worst_defects,
)
from companion.diagnosis.data.segments import REQUIREMENT, Segment, Span, gaps_of, longest_stretch_s, segments_of
from companion.diagnosis.data.tip_tilt import RigidTip, upright_force
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.records import Bools, Floats, Side
from companion.units import GRAVITY_MPS2

_FEWEST_EXPOSURES = 20  # convention: for a likelihood of the toe
_GAP_MARGIN_S = 1.0  # at most, about a filled gap, where the smoothed motion is not known (choice)
_LEAST_PER_PERIOD = 4.0  # samples per period of the first mode, so that the band about its peak is seen (choice)
_BLOCK_S = 5.0  # chosen: means over some periods of a slow sway tell a distance that changes
_SWAYS = 0.4  # of the scatter within blocks: a wing's means reach 0.26, an aircraft that climbs passes 1.5 (choice)
_INPUT = "input_"
_CROWDED = 0.2  # of the usual step: a spline through stamps nearer than that would swing (choice)


def observe(raw: RawRecording, airframe: Airframe, top_hz: float) -> list[Observations]:
    """Put a recording on grids that carry everything up to ``top_hz``, one for each segment between long gaps.

    Raises
    ------
    RecordingError
        No wing accelerometer, no sample that is a number, less than 8 s can be pieced together, or sampled too slowly
        for the first mode.
    """
    if not raw.tips:
        raise RecordingError("no wing accelerometer in this recording: diagnosis needs left_z or right_z")
    raw, notes = finite_rows(raw)
    ordered, stamp_notes = in_time_order(raw)
    notes += stamp_notes
    streams = [stream.t_s for stream in (*ordered.tips.values(), *([ordered.root] if ordered.root else []))]
    segments = segments_of(streams)
    if not segments:
        raise RecordingError(
            f"the longest stretch without a gap is {longest_stretch_s(streams):.1f} s; record {REQUIREMENT}"
        )
    notes += _gap_notes(streams, segments)
    fine_hz = min(_rate(stream) for stream in ordered.tips.values())
    _refuse_slow_rate(fine_hz, airframe.wing.symmetric.frequency_hz.value)
    if fine_hz < 2.0 * top_hz:
        notes.append(f"sampled at {fine_hz:.0f} Hz: nothing above {0.45 * fine_hz:.0f} Hz can be judged")
    defects = {side: _faults(raw.tips[side], segments, airframe, side) for side in sorted(raw.tips)}
    observed = [_observed(ordered, airframe, segment, top_hz, fine_hz, defects) for segment in segments]
    if observed[0].roll_is_missing:
        notes.append(
            "the root's roll rate was not recorded (root_p_radps): what is slower than the aircraft rolls is not judged"
        )
    ranges = ordered.ranges
    if ranges is not None and ranges.reference_m is None and _distance_changes(ranges, airframe, segments):
        ranges = None
        notes.append("the ranges are left out: the distance changes, and no reference_m says by how much")
    begun_s = segments[0].start_s
    segmented = [
        dataclasses.replace(
            observations,
            notes=tuple(notes),
            used_ratio=observations.duration_s / sum(other.duration_s for other in observed),
            toe=toe,
            start_s=segment.start_s - begun_s,
        )
        for observations, segment, toe in zip(observed, segments, _toe(ranges, airframe, segments), strict=True)
    ]
    return in_common_units([segmented], airframe)[0]


def _refuse_slow_rate(rate_hz: float, first_hz: float) -> None:
    if rate_hz < _LEAST_PER_PERIOD * first_hz:
        raise RecordingError(
            f"sampled at {rate_hz:.3g} Hz, too slowly for a first mode of {first_hz:.3g} Hz, which needs "
            f"{_LEAST_PER_PERIOD * first_hz:.3g} Hz: are the stamps (t_s) in seconds?"
        )


def in_common_units(recorded: Sequence[Sequence[Observations]], airframe: Airframe) -> list[list[Observations]]:
    """Recordings, each by its segments, with covariates about the mean and in the rms of all of them together.

    Recordings that are judged together share a coefficient, so a unit of its channel must be the same in each.
    """
    measured = [[_measured(segment) for segment in segments] for segments in recorded]
    units = _units([channels for entries in measured for channels in entries], airframe)
    return [
        [
            dataclasses.replace(
                segment,
                covariates={name: (values - units[name][0]) / units[name][1] for name, values in channels.items()},
                units=units,
            )
            for segment, channels in zip(segments, entries, strict=True)
        ]
        for segments, entries in zip(recorded, measured, strict=True)
    ]


def _measured(segment: Observations) -> dict[str, Floats]:
    """Covariates in the units that they were recorded in; measured forces are none."""
    return {
        name: values * segment.units[name][1] + segment.units[name][0] if name in segment.units else values
        for name, values in segment.covariates.items()
        if not name.startswith(_INPUT)
    }


def _observed(
    raw: RawRecording,
    airframe: Airframe,
    segment: Segment,
    top_hz: float,
    fine_hz: float,
    defects: Mapping[Side, Sequence[SampleDefect]],
) -> Observations:
    """One segment, its covariates still in their own units."""
    fine_t = segment.start_s + np.arange(int((segment.stop_s - segment.start_s) * fine_hz)) / fine_hz
    rate_hz, keep = _coarse(len(fine_t), fine_hz, top_hz)
    sides = tuple(sorted(raw.tips))
    up, root, turning, recoil = _against_root(raw, _tips_on_grid(raw, defects, fine_t), fine_t, fine_hz, airframe)
    missing = _missing(raw, sides, fine_t)
    up = impute_missing(np.ascontiguousarray(up.T), missing).T if missing.any() else up
    load = _resample(-root / GRAVITY_MPS2 + root.mean() / GRAVITY_MPS2, keep) - root.mean() / GRAVITY_MPS2
    grid_t = segment.start_s + np.arange(keep) / rate_hz
    channels = {name: np.interp(grid_t, t_s, values) for name, (t_s, values) in raw.covariates.items()}

    def bending(values: Floats) -> Floats:
        return bending_load(values, rate_hz, airframe.wing.symmetric.frequency_hz.value)

    return Observations(
        rate_hz,
        sides,
        _resample(up - up.mean(0), keep),
        -up.mean(0),
        raw.root is not None,
        load,
        channels,
        None,
        {name: bending(np.interp(grid_t, t_s, values)) for name, (t_s, values) in raw.rigid.items()},
        None if turning is None else bending(_resample(turning, keep)),
        {name: values - values.mean() for name, values in channels.items() if name.startswith(_INPUT)},
        up - up.mean(0),
        fine_hz,
        worst_defects([entry for side in sides for entry in defects[side]]),
        recorded_ratio=1.0 - float(missing.mean()),
        bending_factor=bending(load) if raw.root else None,
        recoil=recoil,
    )


def _gap_notes(streams: Sequence[Floats], segments: Sequence[Segment]) -> list[str]:
    """Gaps and how they are treated, in words."""
    gaps = {gap for t_s in streams for gap in gaps_of(t_s)}
    if not gaps:
        return []
    inside = sum(len(segment.gaps) for segment in segments)
    count, longest_ms = len(gaps), max(stop - start for start, stop in gaps) * 1e3
    recorded_s = sum(segment.recorded_s for segment in segments)
    judged = f"{recorded_s:.1f} s in {len(segments)} segment{'s' if len(segments) > 1 else ''} are judged"
    filled = f", {inside} gap{'s' if inside > 1 else ''} in them bridged" if inside else ""
    return [f"{count} gap{'s' if count > 1 else ''}, the longest {longest_ms:.0f} ms; {judged}{filled}"]


def _missing(raw: RawRecording, sides: Sequence[Side], t_s: Floats) -> Bools:
    """Where a tip against the rigid aircraft was not recorded, (c, m)."""
    of_root = _inside(gaps_of(raw.root.t_s), t_s) if raw.root is not None else np.zeros(len(t_s), dtype=np.bool_)
    return np.stack([_inside(gaps_of(raw.tips[side].t_s), t_s) | of_root for side in sides])


def _inside(gaps: Sequence[Span], t_s: Floats, margin_s: float = 0.0) -> Bools:
    """Which instants lie in a gap, or nearer to one than its length, at most ``margin_s``."""
    inside = np.zeros(len(t_s), dtype=np.bool_)
    for start, stop in gaps:
        near = min(stop - start, margin_s)
        inside |= (t_s > start - near) & (t_s < stop + near)
    return inside


def _tips_on_grid(raw: RawRecording, faults: Mapping[Side, Sequence[SampleDefect]], t_s: Floats) -> Floats:
    """Vertical specific force of the tips (m, c) at ``t_s`` (m,), clipped samples drawn beyond their limit."""
    sides = sorted(faults)
    tips = np.stack([_on_grid(_mended(raw.tips[side], faults[side]), t_s) for side in sides], 1)
    clipped = [clipped_sides(raw.tips[side].force_z_mps2, faults[side]) for side in sides]
    if not any(np.any(entry) for entry in clipped):
        return tips
    return _imputed(tips, [raw.tips[side] for side in sides], clipped, t_s)


def _against_root(
    raw: RawRecording, tips: Floats, t_s: Floats, rate_hz: float, airframe: Airframe
) -> tuple[Floats, Floats, Floats | None, RecoilDelay | None]:
    """Upward acceleration of the tips (m, c) against the root, its force (m,), what turning adds (m, c), the recoil."""
    if raw.root is None:
        root: Floats = np.full(len(t_s), -GRAVITY_MPS2)
        return root[:, None] - tips, root, None, None
    root = undo_lowpass(_on_grid(raw.root, t_s), rate_hz, airframe.root.lowpass_accel_hz)
    recoil = recoil_delay(tips, root, rate_hz, airframe)
    tips, turning = _against_rigid(raw, tips, root, t_s, rate_hz, airframe)
    return root[:, None] - tips, root, turning, recoil


def _against_rigid(
    raw: RawRecording, tips: Floats, root: Floats, t_s: Floats, rate_hz: float, airframe: Airframe
) -> tuple[Floats, Floats]:
    """Tips (m, c) in the aircraft's axes without what its turning adds, and that, (m, c), by the root's force (m,)."""
    sides, upright = sorted(raw.tips), tips.copy()
    rolled = roll_share(raw.rigid, t_s, rate_hz, airframe, tips)
    felt = rotation_forces(raw.rigid, t_s, rate_hz, airframe, sides, rolled)
    lateral = lateral_force(raw.rigid, t_s, rate_hz, airframe)
    roll_radps = roll_rate(raw.rigid, t_s, rate_hz, airframe)
    for i, side in enumerate(sides):
        recorded = raw.tips[side].force_y_mps2
        if recorded is not None and lateral is not None:
            lateral_y = _on_grid(RawStream(raw.tips[side].t_s, recorded), t_s)
            arm_m = (airframe.left, airframe.right)[side].position_m[1] - airframe.root.position_m[1]
            rigid = RigidTip(lateral + felt[i, 1], root + felt[i, 2], roll_radps, arm_m)
            upright[:, i] = upright_force(lateral_y, tips[:, i], rigid, airframe.wing, rate_hz)
    turning = felt[:, 2].T
    return upright - turning, turning


def _rate(stream: RawStream) -> float:
    return float(1.0 / np.median(np.diff(stream.t_s)))


def _faults(stream: RawStream, segments: Sequence[Segment], airframe: Airframe, side: Side) -> list[SampleDefect]:
    """Defects that the samples show as they were recorded."""
    inside = (stream.t_s >= segments[0].start_s) & (stream.t_s <= segments[-1].stop_s)
    sensor = airframe.left if side is Side.LEFT else airframe.right
    return find_sample_defects(stream.t_s[inside], stream.force_z_mps2[inside], sensor)


def _mended(stream: RawStream, faults: Sequence[SampleDefect]) -> RawStream:
    return RawStream(stream.t_s, interpolate_clipped(stream.t_s, stream.force_z_mps2, faults))


def _imputed(tips: Floats, streams: Sequence[RawStream], cut: Sequence[Floats], t_s: Floats) -> Floats:
    """Tips (m, c) on their grid with what was cut drawn anew."""
    limits, beyond = tips.T.copy(), np.zeros(tips.T.shape)
    for i, (stream, clipped) in enumerate(zip(streams, cut, strict=True)):
        nearest = np.clip(np.searchsorted(0.5 * (stream.t_s[1:] + stream.t_s[:-1]), t_s), 0, len(stream.t_s) - 1)
        beyond[i] = clipped[nearest]
        limits[i] = np.where(beyond[i] != 0.0, stream.force_z_mps2[nearest], limits[i])
    return np.ascontiguousarray(impute_clipped(limits, beyond, tips.T).T)


def _on_grid(stream: RawStream, t_s: Floats) -> Floats:
    """A stream at other instants by a cubic spline: a straight line would lose 5 % of a tone at a fifth of the rate."""
    inside = stream.t_s[(stream.t_s >= t_s[0] - 1e-9) & (stream.t_s <= t_s[-1] + 1e-9)]
    if len(inside) == len(t_s) and np.allclose(inside, t_s, rtol=0.0, atol=1e-6):
        return np.asarray(np.interp(t_s, stream.t_s, stream.force_z_mps2))
    step = np.diff(stream.t_s)
    if float(step.min()) < _CROWDED * float(np.median(step)):  # a spline through crowded samples would swing
        return np.asarray(np.interp(t_s, stream.t_s, stream.force_z_mps2))
    splined = np.asarray(CubicSpline(stream.t_s, stream.force_z_mps2)(t_s))
    in_gap = _inside(gaps_of(stream.t_s), t_s)
    return np.where(in_gap, np.interp(t_s, stream.t_s, stream.force_z_mps2), splined) if in_gap.any() else splined


def _coarse(count: int, fine_hz: float, top_hz: float) -> tuple[float, int]:
    keep = fast_length(math.ceil(count * 2.2 * top_hz / fine_hz), up=True)
    if keep > count:
        keep = fast_length(count, up=False)
    return fine_hz * keep / count, keep


def _resample(values: Floats, count: int) -> Floats:
    """Keep the lower part of the spectrum; a straight line between the ends is set aside against ringing."""
    n = len(values)
    if n == count:
        return values
    line = np.linspace(0.0, 1.0, n, endpoint=False)
    across = values[-1] - values[0]
    flat = values - np.multiply.outer(line, across)
    spectrum = np.fft.rfft(flat, axis=0)[: count // 2 + 1]
    thin = np.fft.irfft(spectrum, count, axis=0) * (count / n)
    return np.asarray(thin + np.multiply.outer(np.linspace(0.0, 1.0, count, endpoint=False), across))


def _units(covariates: Sequence[Mapping[str, Floats]], airframe: Airframe) -> dict[str, tuple[float, float]]:
    """Mean and rms that each covariate is counted in: those of an effect in force that follows it, or its own."""
    units = {}
    for name in dict.fromkeys(name for entry in covariates for name in entry):
        values = np.concatenate([entry[name] for entry in covariates if name in entry])
        units[name] = float(values.mean()), float(values.std()) if np.ptp(values) > 0.0 else 1.0
    for effect in airframe.effects:
        if effect.channel in units and effect.channel_rms > 0.0:
            units[effect.channel] = (effect.channel_mean, effect.channel_rms)
    return units


def _toe(ranges: RawRanges | None, airframe: Airframe, segments: Sequence[Segment]) -> list[ToeData | None]:
    """Toe in each segment; without a reference the mean distance of all of them stands for it."""
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
        )
        if exposures.sum() >= _FEWEST_EXPOSURES
        else None
        for exposures in used
    ]


def _distance_changes(ranges: RawRanges, airframe: Airframe, segments: Sequence[Segment]) -> bool:
    """Whether means of the ranges wander more than the believed toe and the wing's sway make them."""
    left_camera, right_camera = airframe.left_camera, airframe.right_camera
    used = np.any([_exposures(ranges, segment) for segment in segments], axis=0)
    if left_camera is None or right_camera is None or used.sum() < _FEWEST_EXPOSURES:
        return False
    at_s = ranges.t_s[used]
    toe_rad = (right_camera.position_m[1] - left_camera.position_m[1]) / ranges.range_m[used]
    blocks = np.array_split(toe_rad, max(int(np.ptp(at_s) / _BLOCK_S), 2))
    scatter = float(np.std(np.concatenate([block - block.mean() for block in blocks])))
    believed = math.sqrt(2.0) * left_camera.rotation_sigma_rad
    return float(np.std([block.mean() for block in blocks])) > max(believed, _SWAYS * scatter)


def _exposures(ranges: RawRanges, segment: Segment) -> Bools:
    """Which ranges were made where the smoothed wing is known."""
    inside = clear_of_ends(ranges.t_s, segment.start_s, segment.stop_s) & (ranges.range_m != 0.0)
    return np.asarray(inside & ~_inside(segment.gaps, ranges.t_s, _GAP_MARGIN_S))
