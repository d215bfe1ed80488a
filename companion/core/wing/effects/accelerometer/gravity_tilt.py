"""Gravity that leaks into a wing accelerometer because the station tilts with the bending."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter, with_vertical
from companion.records import Complexes, Floats, Station
from companion.units import GRAVITY_MPS2

_SLOWEST_RADPS = 1.5  # below, the leak is a bias (choice)


@dataclass(frozen=True, slots=True)
class GravityTilt(Effect):
    """Upward acceleration reads w'' + leak w: the slope s w of a sensor mounted epsilon off level feels g s epsilon w.

    A slope of 1.4 rad/m and 3 degrees make 0.7 1/s^2, a thousandth of omega^2 at 5 Hz: real, and hardly ever seen.
    """

    name: ClassVar[str] = "gravity-tilt"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "bend the wing slowly by hand: only tilt shows then"

    leak_ps2: float = parameter("1/s^2", 0.7, "acceleration per deflection")

    def response(self, station: Station, f_hz: Floats) -> Complexes:
        """Gain 1 - leak/omega^2 on the acceleration."""
        if station is Station.ROOT:
            return np.ones(len(f_hz), dtype=np.complex128)
        omega = np.maximum(2.0 * np.pi * f_hz, _SLOWEST_RADPS)
        return np.asarray(1.0 - self.leak_ps2 / omega**2, dtype=np.complex128)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Filter a block of samples on an even grid."""
        if station is Station.ROOT or len(t_s) < 2:
            return values
        f_hz: Floats = np.asarray(np.fft.rfftfreq(len(t_s), float(t_s[1] - t_s[0])), dtype=np.float64)
        spectrum = self.response(station, f_hz) * np.fft.rfft(values[:, 2] + GRAVITY_MPS2)
        return with_vertical(values, np.fft.irfft(spectrum, len(t_s)) - GRAVITY_MPS2)
