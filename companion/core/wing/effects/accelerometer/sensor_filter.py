"""A low-pass that nobody declared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Complexes, Floats, Station


@dataclass(frozen=True, slots=True)
class SensorFilter(Effect):
    """Both accelerometers pass ``1 / (1 + lag s + second s^2)``.

    A first-order lag has no second term; of a Butterworth filter of second order it is ``lag_s**2 / 2``.
    """

    name: ClassVar[str] = "sensor-filter"
    group: ClassVar[Group] = Group.SENSING
    one_way: ClassVar[bool] = True
    own_law: ClassVar[str] = "both sides lagging"
    advice: ClassVar[str] = "read the filter setting of the nodes; set lowpass_accel_hz"

    lag_s: float = parameter("s", 0.003, "time constant; its corner is 1/(2 pi lag) Hz")
    second_s2: float = parameter("s^2", 5e-6, "of a filter of second order: one over its squared corner, rad/s")

    def response(self, station: Station, f_hz: Floats) -> Complexes:
        """Gain of one pole, or of two."""
        if station is Station.ROOT:
            return np.ones(len(f_hz), dtype=np.complex128)
        omega = 2.0 * np.pi * f_hz
        # below 0 it would be unstable: a gain that falls and turns no phase, which is none of a filter
        second_s2 = max(self.second_s2, 0.0)
        return np.asarray(1.0 / (1.0 - second_s2 * omega**2 + 1j * omega * self.lag_s), dtype=np.complex128)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Filter a block of samples on an even grid."""
        if station is Station.ROOT or len(t_s) < 2:
            return values
        f_hz: Floats = np.asarray(np.fft.rfftfreq(len(t_s), float(t_s[1] - t_s[0])), dtype=np.float64)
        spectrum = self.response(station, f_hz)[:, None] * np.fft.rfft(values[:, :3], axis=0)
        return np.hstack([np.fft.irfft(spectrum, len(t_s), axis=0), values[:, 3:]])
