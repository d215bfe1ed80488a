"""Steady tone in one accelerometer: frequency, amplitude and phase with sigma, for a station that stands alone.

For recordings in which every sensor is a station of its own (a shaker, a simulator's injected sine): no rigid-body
subtraction, no wing model. Over a sliding window of T the vertical axis is fitted with ``c + d t + a cos + b sin``;
with noise of one-sided density S and amplitude A the errors are those of the Cramer-Rao bound, ``var(phase at tau from
the window's middle) = S/(A^2 T) (1 + 12 (tau/T)^2)`` and ``var(f) = 12 S / ((2 pi)^2 A^2 T^3)`` (Rife and Boorstyn,
IEEE TIT 20, 1974). The source's 2nd-order Butterworth low-pass is undone by its closed-form gain and phase at the
tone's frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.core.tracking.streams import SampleBuffer
from companion.core.wing.lowpass import Butterworth2
from companion.params.airframe import Sensor
from companion.records import Floats, ImuBatch, Reject, Rejected, Station

_VERTICAL = 2  # channel (convention)
_MIN_FILL = 0.9  # chosen: of the window
_NOISE_BAND_HZ = 1.5  # chosen: on either side of the tone, for the noise density
_MIN_EXPLAINED = 0.85  # chosen: of the power around the tone; turbulence explains a third
_MIN_LINE_RATIO = 40.0  # derived: line over the density around it times 1/T; chance exceeds it once in 1e17
_SCAN_PER_BIN = 4  # numerical: scallop loss 1 %
_FINER = 2  # times the samples, of the even grid that the scan transforms: stamps may wander (numerical)
_GAUSS_NEWTON_STEPS = 6  # numerical: convergence is quadratic from the scan on


@dataclass(frozen=True, slots=True)
class ToneEstimate:
    """Tone ahead of the source's low-pass: ``f_z(t) = amplitude cos(phase(t))``.

    Attributes
    ----------
    t_ns : int
        The instant that ``phase_rad`` belongs to.
    amplitude_mps2, amplitude_sigma_mps2 : float
    phase_rad, phase_sigma_rad : float
        In (-pi, pi].
    explained : float
        Ratio of the power around the tone that the tone explains.
    """

    station: Station
    t_ns: int
    frequency_hz: float
    frequency_sigma_hz: float
    amplitude_mps2: float
    amplitude_sigma_mps2: float
    phase_rad: float
    phase_sigma_rad: float
    explained: float


@dataclass(frozen=True, slots=True)
class _Line:
    frequency_hz: float
    coefficients: Floats  # a, b about the window's middle
    density: float
    explained: float
    ratio: float


class ToneTracker:
    """Tone of one station through a sliding window."""

    def __init__(
        self, station: Station, sensor: Sensor, frequency_hz: tuple[float, float], window_s: float = 4.0
    ) -> None:
        """Search between the two frequencies."""
        self._station, self._search_hz, self._window_s = station, frequency_hz, window_s
        self._stream = SampleBuffer(sensor)
        self._cutoff_hz = sensor.lowpass_accel_hz

    def add(self, batch: ImuBatch) -> list[Rejected]:
        """Take samples; refusals."""
        refused = self._stream.add(batch, -(2**62))
        if self._stream.newest_ns is not None:
            self._stream.forget(self._stream.newest_ns - round(2.0 * self._window_s * 1e9))
        return refused

    def estimate(self, t_ns: int) -> ToneEstimate | Reject:
        """Tone at ``t_ns``, from the window centred on it or, near an end of what is at hand, the nearest one.

        Returns
        -------
        ToneEstimate or Reject
            ``NOT_SETTLED`` without enough samples, ``OUT_OF_WINDOW`` far from them, ``NO_MODE`` without a clear tone.
        """
        t, z, middle_ns = self._window(t_ns)
        span = t[-1] - t[0] if len(t) > 1 else 0.0
        if span < _MIN_FILL * self._window_s or len(t) < _MIN_FILL * span * self._stream.sensor.rate_hz * 0.7:
            return Reject.NOT_SETTLED
        if abs(t_ns - middle_ns) > self._window_s * 1e9:
            return Reject.OUT_OF_WINDOW
        line = self._line(t, z)
        if line.explained < _MIN_EXPLAINED or line.ratio < _MIN_LINE_RATIO:
            return Reject.NO_MODE
        return self._describe(line, t_ns, (t_ns - middle_ns) * 1e-9)

    def _window(self, t_ns: int) -> tuple[Floats, Floats, int]:
        stamps, values = self._stream.samples()
        if not len(stamps):
            return np.empty(0), np.empty(0), t_ns
        half_ns = round(0.5 * self._window_s * 1e9)
        middle_ns = max(min(t_ns, int(stamps[-1]) - half_ns), int(stamps[0]) + half_ns)
        first, last = np.searchsorted(stamps, [middle_ns - half_ns, middle_ns + half_ns])
        seconds = np.asarray(1e-9 * (stamps[first:last] - middle_ns), dtype=np.float64)
        return seconds, values[first:last, _VERTICAL], middle_ns

    def _line(self, t: Floats, z: Floats) -> _Line:
        taper = 0.5 * (1.0 + np.cos(2.0 * np.pi * t / self._window_s))
        low, high = self._search_hz
        spacing = 1.0 / (_SCAN_PER_BIN * self._window_s)
        tried = np.arange(low, high + spacing, spacing)
        centred = (z - z.mean()) * taper
        scanned = float(tried[int(np.argmax(_amplitudes(t, centred, tried, spacing)))])
        frequency, coefficients, residual = _refine(t, z, scanned, (low, high))
        span = float(t[-1] - t[0])
        density, around = _density_around(t, residual, frequency, span)
        square = float(coefficients @ coefficients)
        total = 0.5 * square + around  # 0 where the sensor sends the same value for ever
        return _Line(
            frequency,
            coefficients,
            density,
            0.5 * square / total if total > 0.0 else 0.0,
            square * span / (4.0 * max(density, 1e-30)),
        )

    def _describe(self, line: _Line, t_ns: int, from_middle_s: float) -> ToneEstimate:
        gain, lag = _response(line.frequency_hz, self._cutoff_hz)
        a, b = line.coefficients
        measured = float(np.hypot(a, b))
        window, omega = self._window_s, 2.0 * np.pi * line.frequency_hz
        unit = line.density / (measured**2 * window)
        phase = float(np.arctan2(-b, a)) + omega * from_middle_s - lag
        return ToneEstimate(
            station=self._station,
            t_ns=t_ns,
            frequency_hz=line.frequency_hz,
            frequency_sigma_hz=float(np.sqrt(12.0 * unit) / (2.0 * np.pi * window)),
            amplitude_mps2=measured / gain,
            amplitude_sigma_mps2=float(np.sqrt(unit)) * measured / gain,
            phase_rad=float(np.angle(np.exp(1j * phase))),
            phase_sigma_rad=float(np.sqrt(unit * (1.0 + 12.0 * (from_middle_s / window) ** 2))),
            explained=line.explained,
        )


def _amplitudes(t: Floats, values: Floats, frequency_hz: Floats, spacing_hz: float) -> Floats:
    """Size of the spectrum of samples (m,) at frequencies (f,), near enough to tell where it is largest."""
    even, step_s = np.linspace(t[0], t[-1], _FINER * len(t), retstep=True)
    bins = max(len(even), math.ceil(1.0 / (step_s * spacing_hz)))
    count = 1 << (bins - 1).bit_length()
    spectrum = np.fft.rfft(np.interp(even, t, values), count)
    return np.asarray(np.interp(frequency_hz, np.fft.rfftfreq(count, step_s), np.abs(spectrum)))


def _refine(t: Floats, z: Floats, frequency_hz: float, limits_hz: tuple[float, float]) -> tuple[float, Floats, Floats]:
    """Gauss-Newton least squares of ``c + d t + a cos(w t) + b sin(w t)`` in all five."""
    for _ in range(_GAUSS_NEWTON_STEPS):
        omega = 2.0 * np.pi * frequency_hz
        cos, sin = np.cos(omega * t), np.sin(omega * t)
        base = np.stack([np.ones_like(t), t, cos, sin], axis=1)
        linear, *_ = np.linalg.lstsq(base, z, rcond=None)
        residual = z - base @ linear
        by_omega = t * (linear[3] * cos - linear[2] * sin)
        moved, *_ = np.linalg.lstsq(np.column_stack([base, by_omega]), residual, rcond=None)
        step = float(moved[4]) / (2.0 * np.pi)
        if not np.isfinite(step) or abs(step) < 1e-7:
            break
        frequency_hz = float(np.clip(frequency_hz + np.clip(step, -0.1, 0.1), *limits_hz))
    return frequency_hz, np.asarray(linear[2:4], dtype=np.float64), np.asarray(residual, dtype=np.float64)


def _density_around(t: Floats, residual: Floats, frequency_hz: float, span_s: float) -> tuple[float, float]:
    """One-sided density of what the tone leaves around its frequency, and its power within that band."""
    around_hz = np.arange(max(frequency_hz - _NOISE_BAND_HZ, 1.0 / span_s), frequency_hz + _NOISE_BAND_HZ, 1.0 / span_s)
    spectrum = np.exp(-2j * np.pi * around_hz[:, None] * t) @ residual
    density = 2.0 * span_s * np.abs(spectrum / len(t)) ** 2
    mean = float(density.mean())
    return mean, mean * len(around_hz) / span_s


def _response(frequency_hz: float, cutoff_hz: float) -> tuple[float, float]:
    """Gain and phase (rad, negative) of the sensor's filter; cutoff 0 is none."""
    if cutoff_hz <= 0.0:
        return 1.0, 0.0
    response = Butterworth2(cutoff_hz).response(np.array([frequency_hz]))[0]
    return float(np.abs(response)), float(np.angle(response))
