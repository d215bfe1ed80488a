"""Measurement rows from averaged streams, with the motion of the rigid aircraft removed.

A tip at ``r`` from the root feels ``f_root + omega' x r + omega x (omega x r) + (0, 0, -w'')``, and a lateral force by
its own motion in the turning body (the filter's: ``native/filter.c``), rotated by its own bending slope. The lift of
the roll acceleration stays in: at the wing's lever it is as large as the bending, and it is a state of the filter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.error_jacobians import AVERAGED, EARLIER, error_columns
from companion.core.tracking.root_vibration import RootVibration
from companion.core.tracking.states import M_LEFT, P_ROOT, ROWS, Z_LEFT, SensorNoise, StateLayout
from companion.core.tracking.streams import CHANNELS, SampleBuffer, StreamSamples
from companion.native.library import ARRAY, INTEGER, RECORD, kernel, packed
from companion.records import Axis, Bools, Floats, Ints

_ROOT_NOISE_SIGMAS = 6.0  # chosen: of the root's epochs; smoothing removes more than that of motion only
_MAX_GATED_RATIO = 0.2  # chosen: where more epochs are gated, the wing really moves so
_PADDING = 2  # derived: epochs at either end that central differences of smoothed values need
BEFORE = _PADDING + EARLIER + AVERAGED - 1
"""Epochs before the first one that are built with it: those over which rigid motion is averaged (derived)."""


def without_gate_excess(epochs: Epochs, gate_excess: Floats) -> Epochs:
    """Epochs less the part of their rows that the filter gated; the load factors of such epochs are interpolated.

    Parameters
    ----------
    epochs : Epochs
        n of them.
    gate_excess : (n, 9) float64
        See :class:`companion.core.kernels.arrays.History`.

    Returns
    -------
    Epochs
    """
    gated, load_g = gate_excess[:, Z_LEFT:M_LEFT].any(axis=1), epochs.load_g
    if gated.any() and not gated.all():
        at = np.arange(epochs.length, dtype=np.float64)
        load_g = np.interp(at, at[~gated], epochs.load_g[~gated])
    return epochs._replace(rows=epochs.rows - gate_excess, load_g=load_g)


class RareGates:
    """Takes gated outliers out of epochs, unless there are so many that the wing really moves so."""

    def __init__(self) -> None:
        self._epochs = 0.0  # gated in the last second

    def without(self, epochs: Epochs, gate_excess: Floats, step_s: float, *, learning: bool) -> Epochs:
        """Epochs less their gate excess (n, 9); unchanged while ``learning``: wrong parameters gate right samples."""
        gated = int(np.count_nonzero(gate_excess.any(axis=1))) if np.count_nonzero(gate_excess) else 0
        self._epochs += gated - self._epochs * min(1.0, epochs.length * step_s)
        rare = self._epochs * step_s < _MAX_GATED_RATIO and not learning
        return without_gate_excess(epochs, gate_excess) if gated and rare else epochs


def join(runs: list[Epochs]) -> Epochs:
    """Concatenation of consecutive runs of epochs."""
    return Epochs(*(np.concatenate(columns) for columns in zip(*runs, strict=True)))


class MeasurementBuilder:
    """Epochs from the three streams: averages, rigid motion removed, Jacobians."""

    def __init__(self, layout: StateLayout, noise: SensorNoise, streams: tuple[SampleBuffer, ...]) -> None:
        self._streams = streams
        root, left, right = (np.array(stream.sensor.position_m) for stream in streams)
        self._levers_m = np.stack([left - root, right - root])
        usual_sigma = _ROOT_NOISE_SIGMAS * np.sqrt(
            [noise.root_z_variance, noise.root_y_variance, noise.sensor_variance[P_ROOT]]
        )
        self._noise = _RootNoise(streams[0].sensor.accel_noise_mps2_rthz, usual_sigma)
        self._error_columns, self._parameter_count = error_columns(layout), len(layout.bias_parameters)
        self._axes: tuple[Axis, ...] = ()
        self._sends = np.zeros((3, CHANNELS), dtype=np.bool_)
        self._last: tuple[float, Floats] = (0.0, np.zeros(3))  # load factor less one and body rate, measured last
        self._vibration = RootVibration()

    def epochs(self, first_ns: int, step_ns: int, count: int) -> Epochs:
        """Build the next ``count`` consecutive epochs of ``step_ns``, from ``first_ns`` on."""
        epochs = self._bridged(self._measured(first_ns, step_ns, count))
        self._last = float(epochs.load_g[-1]), epochs.body_rate_radps[-1].copy()
        motion_variance = epochs.root_motion_variance[:, 0]
        self._vibration.note(first_ns, motion_variance)
        return epochs._replace(root_vibrates=self._vibration.includes(motion_variance))

    def preview(self, first_ns: int, step_ns: int, count: int) -> Epochs:
        """The same from samples that others may still overtake, to be built again once none can."""
        epochs = self._bridged(self._measured(first_ns, step_ns, count))
        return epochs._replace(root_vibrates=self._vibration.includes(epochs.root_motion_variance[:, 0]))

    def _measured(self, first_ns: int, step_ns: int, count: int) -> Epochs:
        """Epochs of what the streams hold."""
        root, left, right = self._streams
        axes = (root.axes, left.axes, right.axes)
        if axes != self._axes:
            self._axes = axes
            self._sends = np.stack([(stream.axes & stream.sensor.axes).mask for stream in self._streams])
        fixed = (self._sends, self._levers_m, self._noise, self._error_columns, self._parameter_count)
        until_ns = first_ns + step_ns * (count + _PADDING)
        at_root, at_left, at_right = (stream.plain(until_ns) for stream in (root, left, right))
        padded = build_epochs(at_root, at_left, at_right, first_ns, step_ns, count, *fixed)
        return padded.span(BEFORE, BEFORE + count)

    def _bridged(self, epochs: Epochs) -> Epochs:
        """Epochs whose load factor and body rate are the last measured ones where the root has a gap.

        Nothing would make the wing hang at one g there, and the body stand still.
        """
        if not epochs.root_covered.all():
            last = np.maximum.accumulate(np.where(epochs.root_covered, np.arange(epochs.length), -1))
            load_g, body_rate_radps = epochs.load_g[last], epochs.body_rate_radps[last]
            load_g[last < 0], body_rate_radps[last < 0] = self._last
            earlier_load_g = np.where(epochs.root_covered, epochs.earlier_load_g, load_g)
            return epochs._replace(load_g=load_g, body_rate_radps=body_rate_radps, earlier_load_g=earlier_load_g)
        return epochs


class _RootNoise(NamedTuple):
    """Density of the root's accelerometer; usual change by smoothing (vertical, lateral force, roll rate)."""

    mps2_rthz: float
    usual_sigma: Floats


_pack_samples, _pack_noise, _pack_epochs = packed(StreamSamples), packed(_RootNoise), packed(Epochs)
_build = kernel("epochs_build", RECORD, RECORD, RECORD, ARRAY, ARRAY, ARRAY, RECORD, ARRAY, INTEGER, INTEGER, RECORD)


def build_epochs(
    root: StreamSamples,
    left: StreamSamples,
    right: StreamSamples,
    first_ns: int,
    step_ns: int,
    count: int,
    sends: Bools,
    levers_m: Floats,
    noise: _RootNoise,
    error_columns: Ints,
    parameter_count: int,
) -> Epochs:
    """Epochs with ``BEFORE`` and ``_PADDING`` more on either side, for derivatives and smoothing.

    ``sends`` (3, 6) by stream and axis, ``levers_m`` (2, 3) of the tips from the root, ``error_columns`` as
    :func:`companion.core.tracking.error_jacobians.error_columns` gives them.
    """
    edges_ns = first_ns + step_ns * np.arange(-BEFORE, count + _PADDING + 1)
    epochs = _empty(count + BEFORE + _PADDING, parameter_count)
    _build(
        _pack_samples(root),
        _pack_samples(left),
        _pack_samples(right),
        edges_ns,
        sends,
        levers_m,
        _pack_noise(noise),
        error_columns,
        EARLIER,
        AVERAGED,
        _pack_epochs(epochs),
    )
    return epochs


def _empty(n: int, parameters: int) -> Epochs:
    """Epochs that are yet to be filled."""
    return Epochs(
        start_ns=np.empty(n, np.int64),
        rows=np.empty((n, ROWS)),
        present=np.empty((n, ROWS), np.bool_),
        vertical_mps2=np.empty((n, 2)),
        lateral_mps2=np.empty((n, 2)),
        slope_rate_gain=np.empty((n, 2)),
        lateral_gain=np.empty((n, 2)),
        load_g=np.empty(n),
        body_rate_radps=np.empty((n, 3)),
        earlier_roll_radps2=np.empty(n),
        earlier_load_g=np.empty(n),
        sensitivity=np.empty((n, ROWS, parameters)),
        aliasing_noise=np.empty((n, 2)),
        root_motion_variance=np.empty((n, 3)),
        root_vibrates=np.zeros(n, np.bool_),
        root_covered=np.empty(n, np.bool_),
    )
