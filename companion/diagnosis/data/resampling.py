"""Raw streams of any rate, with gaps, on the one uniform grid of a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from companion.core.wing.samples import SampleDefect
from companion.diagnosis.data.declipping import impute_clipped
from companion.diagnosis.data.grid import fast_length
from companion.diagnosis.data.observations import (
    Observations,
    RawRanges,
    RawRecording,
    RawStream,
    ToeData,
    clear_of_ends,
)
from companion.diagnosis.data.rigid_motion import lateral_force, rotation_forces, tip_axes_corrected, undo_lowpass
from companion.diagnosis.data.sample_defects import (
    clipped_sides,
    find_sample_defects,
    interpolate_clipped,
    worst_defects,
)
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.records import Floats, Side
from companion.units import GRAVITY_MPS2

_SHORTEST_S = 8.0
_LONGEST_GAP_S = 0.02
_INPUT = "input_"
_CROWDED = 0.2  # of the usual step: stamps so close together carry no slope


def observe(raw: RawRecording, airframe: Airframe, top_hz: float) -> Observations:
    """Put a recording on a grid that carries everything up to ``top_hz``.

    Raises
    ------
    RecordingError
        No wing accelerometer, too slow, or no gap-free stretch of at least 8 s.
    """
    if not raw.tips:
        raise RecordingError("no wing accelerometer in this recording: diagnosis needs left_z or right_z")
    notes: list[str] = []
    streams = [*raw.tips.values(), *([raw.root] if raw.root else [])]
    start_s, stop_s = _longest_stretch(streams, notes)
    fine_hz = min(_rate(stream) for stream in raw.tips.values())
    if fine_hz < 2.0 * top_hz:
        notes.append(f"sampled at {fine_hz:.0f} Hz: nothing above {0.45 * fine_hz:.0f} Hz can be judged")
    fine_t = start_s + np.arange(int((stop_s - start_s) * fine_hz)) / fine_hz
    rate_hz, keep = _coarse(len(fine_t), fine_hz, top_hz)
    sides = tuple(sorted(raw.tips))
    faults = {side: _faults(raw.tips[side], start_s, stop_s, airframe, side) for side in sides}
    tips = _tips_on_grid(raw, faults, fine_t)
    root, turning = np.full(len(fine_t), -GRAVITY_MPS2), None
    if raw.root:
        root = undo_lowpass(_on_grid(raw.root, fine_t), fine_hz, airframe.root.lowpass_accel_hz)
        tips, turning = _against_rigid(raw, tips, fine_t, fine_hz, airframe)
    up = root[:, None] - tips
    load = -root / GRAVITY_MPS2
    grid_t = start_s + np.arange(keep) / rate_hz
    channels = {name: np.interp(grid_t, t_s, values) for name, (t_s, values) in raw.covariates.items()}
    units = _units(channels, airframe)
    return Observations(
        rate_hz,
        sides,
        _resample(up - up.mean(0), keep),
        np.asarray(tips.mean(0) - root.mean()),
        raw.root is not None,
        _resample(load - load.mean(), keep) + load.mean(),
        {name: (values - units[name][0]) / units[name][1] for name, values in channels.items() if name in units},
        _toe(raw.ranges, airframe, start_s, stop_s),
        {name: np.interp(grid_t, t_s, values) for name, (t_s, values) in raw.rigid.items()},
        None if turning is None else _resample(turning, keep),
        {name: values - values.mean() for name, values in channels.items() if name.startswith(_INPUT)},
        up - up.mean(0),
        fine_hz,
        worst_defects([entry for side in sides for entry in faults[side]]),
        notes=tuple(notes),
        centre_s=0.5 * keep / rate_hz,
        units=units,
    )


def _tips_on_grid(raw: RawRecording, faults: Mapping[Side, Sequence[SampleDefect]], t_s: Floats) -> Floats:
    """Vertical specific force of the tips (m, c) at ``t_s`` (m,), clipped samples drawn beyond their limit."""
    sides = sorted(faults)
    tips = np.stack([_on_grid(_mended(raw.tips[side], faults[side]), t_s) for side in sides], 1)
    clipped = [clipped_sides(raw.tips[side].force_z_mps2, faults[side]) for side in sides]
    if not any(np.any(entry) for entry in clipped):
        return tips
    return _imputed(tips, [raw.tips[side] for side in sides], clipped, t_s)


def _against_rigid(
    raw: RawRecording, tips: Floats, t_s: Floats, rate_hz: float, airframe: Airframe
) -> tuple[Floats, Floats]:
    """Tips (m, c) in the aircraft's axes without what its turning adds, and that, (m, c)."""
    sides, upright = sorted(raw.tips), tips.copy()
    felt = rotation_forces(raw.rigid, t_s, rate_hz, airframe, sides)
    lateral = lateral_force(raw.rigid, t_s, rate_hz, airframe)
    for i, side in enumerate(sides):
        recorded = raw.tips[side].force_y_mps2
        if recorded is not None and lateral is not None:
            lateral_y = _on_grid(RawStream(raw.tips[side].t_s, recorded), t_s)
            upright[:, i] = tip_axes_corrected(lateral_y, tips[:, i], lateral + felt[i, 1])
    turning = felt[:, 2].T
    return upright - turning, turning


def _rate(stream: RawStream) -> float:
    return float(1.0 / np.median(np.diff(stream.t_s)))


def _longest_stretch(streams: list[RawStream], notes: list[str]) -> tuple[float, float]:
    """The longest time in which no stream has a gap."""
    start = max(float(stream.t_s[0]) for stream in streams)
    stop = min(float(stream.t_s[-1]) for stream in streams)
    holes: list[tuple[float, float]] = []
    for stream in streams:
        step = np.diff(stream.t_s)
        wide = np.flatnonzero(step > max(_LONGEST_GAP_S, 5.0 * float(np.median(step))))
        holes += [(float(stream.t_s[i]), float(stream.t_s[i + 1])) for i in wide]
    edges = sorted([(start, start), *[hole for hole in holes if start < hole[0] < stop], (stop, stop)])
    pieces = [(edges[i][1], edges[i + 1][0]) for i in range(len(edges) - 1)]
    best = max(pieces, key=lambda piece: piece[1] - piece[0], default=(0.0, 0.0))
    if holes:
        count = len(set(holes))
        notes.append(
            f"{count} gap{'s' if count > 1 else ''}, the longest {max(b - a for a, b in holes) * 1e3:.0f} ms; "
            f"judged is the longest stretch without one, {best[1] - best[0]:.1f} s"
        )
    if best[1] - best[0] < _SHORTEST_S:
        raise RecordingError(
            f"the longest stretch without a gap is {best[1] - best[0]:.1f} s; {_SHORTEST_S:g} s needed"
        )
    return best


def _faults(stream: RawStream, start_s: float, stop_s: float, airframe: Airframe, side: Side) -> list[SampleDefect]:
    inside = (stream.t_s >= start_s) & (stream.t_s <= stop_s)
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
    return np.asarray(CubicSpline(stream.t_s, stream.force_z_mps2)(t_s))


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


def _units(channels: Mapping[str, Floats], airframe: Airframe) -> dict[str, tuple[float, float]]:
    """Mean and rms that each covariate is counted in: those of an effect in force that follows it, or its own."""
    units = {
        name: (float(values.mean()), float(values.std()) or 1.0)
        for name, values in channels.items()
        if not name.startswith(_INPUT)
    }
    for effect in airframe.effects:
        if effect.channel in units and effect.channel_rms > 0.0:
            units[effect.channel] = (effect.channel_mean, effect.channel_rms)
    return units


def _toe(ranges: RawRanges | None, airframe: Airframe, start_s: float, stop_s: float) -> ToeData | None:
    left_camera, right_camera = airframe.left_camera, airframe.right_camera
    if ranges is None or left_camera is None or right_camera is None:
        return None
    baseline_m = right_camera.position_m[1] - left_camera.position_m[1]
    inside = clear_of_ends(ranges.t_s, start_s, stop_s) & (ranges.range_m != 0.0)
    inverse = 1.0 / ranges.range_m[inside]  # of an infinite range it is 0, which is what was measured
    t_s = ranges.t_s[inside] - start_s
    if len(t_s) < 20:
        return None
    has_reference = ranges.reference_m is not None
    reference = (
        1.0 / ranges.reference_m[inside] if ranges.reference_m is not None else np.full(len(t_s), inverse.mean())
    )
    return ToeData(t_s, baseline_m * (inverse - reference), reference, has_reference)
