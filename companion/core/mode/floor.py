"""What the fit expects of the vertical channel beside the wing: sensor noise, its derivative, cut samples, drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.compiled import compiled
from companion.records import Floats

EDGE = 8
# rigid roll lies below some 10 Hz; above, the gyro's noise would be differentiated
_SMOOTH = np.hanning(2 * EDGE + 1)[1:-1]
DERIVATIVE = np.convolve(_SMOOTH / _SMOOTH.sum(), [0.5, 0.0, -0.5])
"""Smooth derivative over ``2 EDGE + 1`` cells, per step."""


@dataclass(frozen=True, slots=True)
class Floor:
    """Density of all that is no wing, one-sided.

    Attributes
    ----------
    white : float
        Of the sensors, (m/s^2)^2/Hz.
    roll : float
        Of the root's gyro through the lever arm, (m/s)^2/Hz: differentiated, it grows with frequency.
    cut : float
        Of samples that the cells' edges cut; it grows as ``1 - cos(2 pi f h)``.
    drift : float
        Of the biases at 1 Hz; it falls with the square of the frequency.
    step_s : float
        ``h``.
    """

    white: float
    roll: float
    cut: float
    drift: float
    step_s: float

    def __call__(self, frequency_hz: Floats) -> Floats:
        """Density at these frequencies."""
        density: Floats = self.white + self.roll * _differentiated(frequency_hz, self.step_s)
        density += self.drift / frequency_hz**2
        density += self.cut * (1.0 - np.cos(2.0 * np.pi * self.step_s * frequency_hz))
        return density


@compiled
def _differentiated(frequency_hz: Floats, step_s: float) -> Floats:
    """Squared gain of the smooth derivative, 1/s^2: it is odd, so sines are all there is."""
    turn = np.zeros(len(frequency_hz))
    for k in range(1, EDGE + 1):
        turn += 2.0 * DERIVATIVE[EDGE + k] * np.sin(2.0 * np.pi * step_s * k * frequency_hz)
    return (turn / step_s) ** 2
