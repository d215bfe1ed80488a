"""A low-pass that nobody declared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Complexes, Effect, Group, parameter
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class SensorFilter(Effect):
    """Both accelerometers pass a first-order lag of ``lag_s``."""

    name: ClassVar[str] = "sensor-filter"
    group: ClassVar[Group] = Group.SENSING
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "read the filter setting of the nodes; set lowpass_accel_hz"

    lag_s: float = parameter("s", 0.003, "time constant; its corner is 1/(2 pi lag) Hz")

    def response(self, station: Station, f_hz: Floats) -> Complexes:
        """A single pole."""
        if station is Station.ROOT:
            return np.ones(len(f_hz), dtype=np.complex128)
        return np.asarray(1.0 / (1.0 + 2j * np.pi * f_hz * self.lag_s), dtype=np.complex128)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Filter a block of samples on an even grid."""
        if station is Station.ROOT or len(t_s) < 2:
            return values
        f_hz: Floats = np.asarray(np.fft.rfftfreq(len(t_s), float(t_s[1] - t_s[0])), dtype=np.float64)
        spectrum = self.response(station, f_hz)[:, None] * np.fft.rfft(values[:, :3], axis=0)
        return np.hstack([np.fft.irfft(spectrum, len(t_s), axis=0), values[:, 3:]])
