"""The 2nd-order Butterworth that autopilots apply to inertial data (INS_ACCEL_FILTER, IMU_ACCEL_CUTOFF).

Continuous: H(s) = wc^2 / (s^2 + sqrt(2) wc s + wc^2). Discrete: the bilinear transform, prewarped at the cutoff,
with the coefficients of ArduPilot libraries/Filter/LowPassFilter2p.cpp, which PX4's math::LowPassFilter2p shares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.records import Complexes, Floats


@dataclass(frozen=True, slots=True)
class Butterworth2:
    """The filter as a continuous system, for a model that does not know the autopilot's inner rate."""

    cutoff_hz: float

    def __post_init__(self) -> None:
        _check_cutoff(self.cutoff_hz)

    def response(self, frequency_hz: Floats) -> Complexes:
        """Complex gain (k,) at each frequency."""
        r = np.asarray(frequency_hz, dtype=np.float64) / self.cutoff_hz
        return np.asarray(1.0 / (1.0 - r**2 + 1j * math.sqrt(2.0) * r))


@dataclass(frozen=True, slots=True)
class Biquad:
    """The filter as the autopilot runs it, sample by sample."""

    b: tuple[float, float, float]
    a: tuple[float, float]
    rate_hz: float

    @classmethod
    def lowpass(cls, cutoff_hz: float, rate_hz: float) -> Biquad:
        """ArduPilot's coefficients for a cutoff at a sample rate.

        Raises
        ------
        ValueError
            If the cutoff is not positive or reaches half the rate.
        """
        _check_cutoff(cutoff_hz)
        if cutoff_hz >= 0.5 * rate_hz:
            raise ValueError(
                f"a cutoff of {cutoff_hz:g} Hz needs more than {2 * cutoff_hz:g} samples/s, not {rate_hz:g}"
            )
        ohm = math.tan(math.pi * cutoff_hz / rate_hz)
        c = 1.0 + 2.0 * math.cos(math.pi / 4.0) * ohm + ohm * ohm
        b0 = ohm * ohm / c
        a1 = 2.0 * (ohm * ohm - 1.0) / c
        a2 = (1.0 - 2.0 * math.cos(math.pi / 4.0) * ohm + ohm * ohm) / c
        return cls((b0, 2.0 * b0, b0), (a1, a2), rate_hz)

    def run(self, samples: Floats) -> Floats:
        """Filter (m,) or (m, k) samples along time, starting settled on the first, as ArduPilot's reset does."""
        rows = np.asarray(samples, dtype=np.float64)
        z1 = rows[0] * (1.0 / (1.0 + self.a[0] + self.a[1]))
        z2 = z1
        filtered = np.empty_like(rows)
        for i, sample in enumerate(rows):
            z0 = sample - z1 * self.a[0] - z2 * self.a[1]
            filtered[i] = z0 * self.b[0] + z1 * self.b[1] + z2 * self.b[2]
            z1, z2 = z0, z1
        return filtered


def _check_cutoff(cutoff_hz: float) -> None:
    if not (math.isfinite(cutoff_hz) and cutoff_hz > 0.0):
        raise ValueError(f"a low-pass needs a cutoff > 0 Hz, not {cutoff_hz}")
