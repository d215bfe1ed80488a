"""Vibration of the propulsion at one sensor: lines that follow the shaft, and broadband noise.

Both are evaluated at several instants inside every sample's averaging window, cut at the converter's range there and
averaged: so a line above the Nyquist frequency comes out at its alias with the window's gain, as in a real sensor, and
one that clips leaves an offset. What the autopilot's low-pass makes of it follows later, on the averaged samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.params.airframe import Sensor
from companion.records import Floats

_INSTANTS = 8  # inside a window: a line at the sampling rate is averaged to 3 % of the true mean of its sine (choice)
_RATE_STEP_S = 0.01  # chosen: of the table of the shaft's turns: throttle moves slower


@dataclass(frozen=True, slots=True, eq=False)
class ShaftTurns:
    """Turns of the shaft since boot on a table of :data:`_RATE_STEP_S`; between its entries the rate is constant."""

    turns: Floats

    @classmethod
    def from_rate(cls, rate_hz: Floats) -> ShaftTurns:
        """Integrate rates (n,) that hold for a hundredth of a second each."""
        return cls(np.concatenate([[0.0], np.cumsum(rate_hz) * _RATE_STEP_S]))

    @staticmethod
    def table_s(duration_s: float) -> Floats:
        """Instants (n,) for which :meth:`from_rate` wants rates."""
        return np.arange(math.ceil(duration_s / _RATE_STEP_S) + 1) * np.float64(_RATE_STEP_S)

    def at(self, t_s: Floats) -> Floats:
        """Turns at instants of any shape."""
        return np.interp(t_s, np.arange(len(self.turns)) * _RATE_STEP_S, self.turns)


@dataclass(frozen=True, slots=True, eq=False)
class VibrationLine:
    """A line at one station: order of the shaft rate; amplitude and phase of each of the six axes."""

    order: float
    amplitude: Floats
    phase_rad: Floats


@dataclass(frozen=True, slots=True, eq=False)
class StationVibration:
    """All vibration at one station. ``density`` (6,) is one-sided, inside ``band_hz``."""

    shaft: ShaftTurns
    lines: tuple[VibrationLine, ...]
    density: Floats
    band_hz: tuple[float, float]

    def added(self, values: Floats, t_s: Floats, period_s: float, sensor: Sensor, rng: np.random.Generator) -> Floats:
        """Samples (n, 6) as the sensor's averaging converter gives them on top of ``values`` taken at ``t_s``."""
        inside_s = t_s[:, None] + ((np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5) * period_s
        turn_rad = 2.0 * math.pi * self.shaft.at(inside_s)
        limits = np.repeat([sensor.accel_range_mps2, sensor.gyro_range_radps], 3)
        out = np.empty_like(values)
        for axis in range(6):
            shaken = self._broadband(axis, inside_s.shape, period_s, rng)
            for line in self.lines:
                shaken += line.amplitude[axis] * np.sin(line.order * turn_rad + line.phase_rad[axis])
            out[:, axis] = np.clip(values[:, axis, None] + shaken, -limits[axis], limits[axis]).mean(axis=1)
        return out

    def _broadband(self, axis: int, shape: tuple[int, ...], period_s: float, rng: np.random.Generator) -> Floats:
        if not self.density[axis]:
            return np.zeros(shape)
        from scipy.signal import butter, sosfilt  # 0.8 s to import, so late

        rate_hz = _INSTANTS / period_s
        white = self.density[axis] * math.sqrt(rate_hz / 2.0) * rng.standard_normal(shape[0] * shape[1])
        sections = butter(2, self.band_hz, "bandpass", fs=rate_hz, output="sos")
        return np.asarray(sosfilt(sections, white)).reshape(shape)


@dataclass(frozen=True, slots=True, eq=False)
class SensorDisturbance:
    """Disturbance of one sensor by its world: warm-up drift of its biases (6,), and vibration."""

    thermal: Floats
    thermal_s: float
    vibration: StationVibration | None

    def felt(self, values: Floats, t_s: Floats, period_s: float, sensor: Sensor, rng: np.random.Generator) -> Floats:
        """Samples (n, 6) with both added."""
        warmed = values - np.expm1(-t_s / self.thermal_s)[:, None] * self.thermal
        if self.vibration is None:
            return warmed
        return self.vibration.added(warmed, t_s, period_s, sensor, rng)
