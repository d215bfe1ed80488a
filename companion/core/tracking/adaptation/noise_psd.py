"""Power spectral density of the noise in a vertical channel: sensors, differentiated gyro, aliasing, drift."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from companion.records import Complexes, Floats

VIBRATION_HZ = 20.0
"""Propulsion shakes sensors above it (chosen: half of a shaft's 2,400 rpm; below, a wing shakes by gusts)."""
EDGE = 8  # chosen: half length of the smooth derivative, epochs
# rigid roll lies below some 10 Hz; above, the gyro's noise would be differentiated
_SMOOTH = np.hanning(2 * EDGE + 1)[1:-1]
DERIVATIVE = np.convolve(_SMOOTH / _SMOOTH.sum(), [0.5, 0.0, -0.5])
"""Smooth derivative over ``2 EDGE + 1`` epochs, per step."""


@dataclass(frozen=True, slots=True)
class StaticBendResponse:
    """First symmetric mode under a load: frequency, damping, and static bend per load, m per m/s^2."""

    frequency_hz: float
    damping: float
    per_load_s2: float

    def reading(self, frequency_hz: Floats) -> Complexes:
        """Vertical reading, m/s^2, per metre of static bend, (n,) complex: ``omega^2 H(omega)``."""
        square, own_square = frequency_hz**2, self.frequency_hz**2
        response = own_square / (own_square - square + 2j * self.damping * self.frequency_hz * frequency_hz)
        return np.asarray(4.0 * np.pi**2 * square * response)


@dataclass(frozen=True, slots=True)
class NoiseSpectrum:
    """One-sided density of everything that is not the wing's.

    Attributes
    ----------
    white : float
        Of the tips' sensors, (m/s^2)^2/Hz.
    root : float
        Of the root's, which is in the reading itself and in the load factor, whose bend is subtracted.
    bend : StaticBendResponse
        Reading by a load factor.
    roll : float
        Of the root's gyro through the lever arm, (m/s)^2/Hz: differentiated, it grows with frequency.
    aliasing : float
        By samples that the epochs' edges cut; it grows as ``1 - cos(2 pi f h)``.
    drift : float
        Of the drifting biases at 1 Hz; it falls with the square of the frequency.
    step_s : float
        ``h``.
    tips_ratio, root_ratio : float
        By how much ``white`` and ``root`` are louder by vibration, above :data:`VIBRATION_HZ`.
    """

    white: float
    root: float
    bend: StaticBendResponse
    roll: float
    aliasing: float
    drift: float
    step_s: float
    tips_ratio: float = 1.0
    root_ratio: float = 1.0

    def louder(self, tips: float, root: float) -> NoiseSpectrum:
        """The spectrum with so many times the density of tips' and root's sensors above :data:`VIBRATION_HZ`."""
        return replace(self, tips_ratio=tips, root_ratio=root)

    def __call__(self, frequency_hz: Floats) -> Floats:
        """Density at these frequencies, (n,) (m/s^2)^2/Hz."""
        shaken = 1.0 / (1.0 + (VIBRATION_HZ / frequency_hz) ** 4)
        density = self.white * (1.0 + (self.tips_ratio - 1.0) * shaken)
        if self.root:
            root_gain = np.abs(1.0 - self.bend.per_load_s2 * self.bend.reading(frequency_hz)) ** 2
            density += self.root * (1.0 + (self.root_ratio - 1.0) * shaken) * root_gain
        if self.roll:
            density += self.roll * _derivative_power_gain(frequency_hz, self.step_s)
        density += self.drift / frequency_hz**2
        density += self.aliasing * (1.0 - np.cos(2.0 * np.pi * self.step_s * frequency_hz))
        return density


def _derivative_power_gain(frequency_hz: Floats, step_s: float) -> Floats:
    """Squared gain of the smooth derivative, 1/s^2; its kernel is odd, so a sine series suffices."""
    turns = 2.0 * np.pi * step_s * np.arange(1, EDGE + 1)
    sines = 2.0 * DERIVATIVE[EDGE + 1 :, None] * np.sin(turns[:, None] * frequency_hz)
    return np.asarray((sines.sum(axis=0) / step_s) ** 2)
