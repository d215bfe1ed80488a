"""Wing motion in flight on an even time grid: symmetric and antisymmetric acceleration of the tips against the root."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.signal import firwin, upfirdn

from companion.calibration.ambient import AmbientMode, ambient_modes
from companion.core.clock.bank import ClockBank
from companion.errors import ConfigError, RecordingError
from companion.params.airframe import Airframe
from companion.records import ClockName, Floats, ImuBatch, Ints, Record, Station, TimesyncReply

_VERTICAL = 2  # column of body z in ImuBatch.values (convention)
_RATE_HZ = 200.0  # twice the band and more (choice)
_LEAST_BAND_HZ = 1.0  # chosen: sixteen lines of the spectrum of correlations over four seconds
_TAPS = 129  # chosen: taps of the anti-alias low-pass: steep enough for 0.8 of the new Nyquist rate
_LEAST_S = 20.0  # a hundred periods of 5 Hz (choice)
_LEAST_RMS = 0.25  # of the other tip's: gusts move either side of a wing (choice)
_GAP_NS = 200_000_000  # chosen: one period at 5 Hz; across a longer one a mode is not interpolated


@dataclass(frozen=True, slots=True)
class WingMotion:
    """Accelerations of the tips relative to the root, up positive: (n,) each, m/s^2, evenly spaced."""

    rate_hz: float
    symmetric: Floats
    antisymmetric: Floats

    def modes(self, band_hz: tuple[float, float]) -> dict[str, list[AmbientMode]]:
        """Identify both families of modes.

        Raises
        ------
        ConfigError
            The band is no band, or reaches above half of the rate.
        """
        if not 0.0 <= band_hz[0] <= band_hz[1] - _LEAST_BAND_HZ or band_hz[1] > 0.5 * self.rate_hz:
            raise ConfigError(
                f"the band from {band_hz[0]:g} to {band_hz[1]:g} Hz cannot be: give the lower frequency first, "
                f"{_LEAST_BAND_HZ:g} Hz apart or more, up to {0.5 * self.rate_hz:g} Hz"
            )
        return {
            name: ambient_modes(samples[:, np.newaxis], self.rate_hz, band_hz)
            for name, samples in (("symmetric", self.symmetric), ("antisymmetric", self.antisymmetric))
        }


def wing_motion(records: Iterable[Record], airframe: Airframe, hub: ClockName) -> WingMotion:
    """Put the samples of all three stations onto one grid of host time.

    The rigid part is the root's own specific force, and what roll acceleration adds at the tips, from the root's gyro.
    Only the longest segment without a gap is used.

    Raises
    ------
    RecordingError
        A station sent nothing, there is no segment of 20 s that all three share, or a tip hardly moves.
    """
    streams = station_samples(records, hub)
    for station in Station:
        if not len(streams[station][0]):
            raise RecordingError(f"the recording has no samples of the {station.name.lower()} station")
    first, last = _shared(streams)
    if last - first < _LEAST_S * 1e9:
        shared_s = max(last - first, 0) * 1e-9
        raise RecordingError(
            f"root, left and right share only {shared_s:.1f} s without a gap; {_LEAST_S:g} s are needed"
        )
    grid = np.arange(first, last, round(1e9 / _RATE_HZ))
    root, left, right = (_on_grid(*streams[station], grid) for station in Station)
    _both_move(left[:, _VERTICAL], right[:, _VERTICAL])
    roll_rate = root[:, 3]
    roll_accel = np.gradient(roll_rate, 1.0 / _RATE_HZ)
    span = 0.5 * (airframe.right.position_m[1] - airframe.left.position_m[1])
    up_left, up_right = -left[:, _VERTICAL], -right[:, _VERTICAL]
    symmetric = 0.5 * (up_left + up_right) + root[:, _VERTICAL]
    return WingMotion(_RATE_HZ, symmetric, 0.5 * (up_right - up_left) + roll_accel * span)


def _both_move(left: Floats, right: Floats) -> None:
    """Refuse a tip that hardly moves: of the other one alone both families would have its modes."""
    (less, quiet), (more, loud) = sorted([(float(left.std()), "left"), (float(right.std()), "right")])
    if less < _LEAST_RMS * more:
        raise RecordingError(
            f"{quiet}_z moves by {less:.3g} m/s^2 rms, {loud}_z by {more:.3g}: check the sensor of the {quiet} tip"
        )


def station_samples(records: Iterable[Record], hub: ClockName) -> dict[Station, tuple[Ints, Floats]]:
    """Samples of every station on the host's clock: stamps (n,), ns, values (n, 6); what is not synced is left out."""
    bank = ClockBank()
    bank.identity(hub)
    streams: dict[Station, list[tuple[Ints, Floats]]] = {station: [] for station in Station}
    for record in records:
        if isinstance(record, TimesyncReply):
            bank.exchange(record)
        elif isinstance(record, ImuBatch):
            answer = bank.to_host(record.clock, record.t_ns)
            if isinstance(answer, tuple):
                streams[record.station].append((answer[0], record.values))
    return {station: _joined(batches) for station, batches in streams.items()}


def _joined(batches: list[tuple[Ints, Floats]]) -> tuple[Ints, Floats]:
    if not batches:
        return np.empty(0, dtype=np.int64), np.empty((0, 6))
    t_ns, first = np.unique(np.concatenate([t for t, _ in batches]), return_index=True)
    return t_ns, np.concatenate([values for _, values in batches])[first]


def _shared(streams: dict[Station, tuple[Ints, Floats]]) -> tuple[int, int]:
    """Longest segment in which no station has a gap."""
    start = max(int(t[0]) for t, _ in streams.values())
    end = min(int(t[-1]) for t, _ in streams.values())
    holes = [(start, start), (end, end)]
    for t_ns, _ in streams.values():
        wide = np.flatnonzero(np.diff(t_ns) > _GAP_NS)
        holes += [(int(t_ns[i]), int(t_ns[i + 1])) for i in wide if t_ns[i + 1] > start and t_ns[i] < end]
    holes.sort()
    behind = itertools.accumulate((hole[1] for hole in holes), max)  # holes of several stations overlap
    segments = [(after, hole[0]) for after, hole in zip(behind, holes[1:], strict=False)]
    return max(segments, key=lambda each: each[1] - each[0], default=(start, end))


def _on_grid(t_ns: Ints, values: Floats, grid: Ints) -> Floats:
    """Low-pass and sample: interpolation to a dense even grid first, so that the filter's taps are evenly spaced."""
    dense = max(1, round(float(np.median(1e9 / np.maximum(np.diff(t_ns), 1))) / _RATE_HZ))
    fine = np.linspace(grid[0], grid[-1], (len(grid) - 1) * dense + 1)
    channels = [np.interp(fine, t_ns, values[:, axis]) for axis in range(values.shape[1])]
    if dense > 1:
        taps = firwin(_TAPS, 0.8 / dense)
        channels = [upfirdn(taps, channel)[_TAPS // 2 :][: len(fine)] for channel in channels]
    return np.column_stack([channel[::dense] for channel in channels])
