"""What the fit expects of the vertical channel beside the wing: sensor noise, its derivative, cut samples, drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from companion.core.kernels.compiled import compiled
from companion.records import Floats

Complexes = npt.NDArray[np.complex128]

EDGE = 8
# rigid roll lies below some 10 Hz; above, the gyro's noise would be differentiated
_SMOOTH = np.hanning(2 * EDGE + 1)[1:-1]
DERIVATIVE = np.convolve(_SMOOTH / _SMOOTH.sum(), [0.5, 0.0, -0.5])
"""Smooth derivative over ``2 EDGE + 1`` cells, per step."""


@dataclass(frozen=True, slots=True)
class Bend:
    """The first symmetric mode under a load: its frequency, damping, and static bend per load, m per m/s^2."""

    frequency_hz: float
    damping: float
    per_load_s2: float

    def reading(self, frequency_hz: Floats) -> Complexes:
        """Vertical reading, m/s^2, per metre of static bend: ``omega^2 H(omega)``."""
        square, own = frequency_hz**2, self.frequency_hz**2
        response = own / (own - square + 2j * self.damping * self.frequency_hz * frequency_hz)
        return np.asarray(4.0 * np.pi**2 * square * response)


@dataclass(frozen=True, slots=True)
class Floor:
    """Density of all that is no wing, one-sided.

    Attributes
    ----------
    white : float
        Of the tips' sensors, (m/s^2)^2/Hz.
    root : float
        Of the root's, which is in the reading itself and in the load factor, whose known bend is taken out.
    bend : Bend
        What a load factor does to the reading.
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
    root: float
    bend: Bend
    roll: float
    cut: float
    drift: float
    step_s: float

    def __call__(self, frequency_hz: Floats) -> Floats:
        """Density at these frequencies."""
        felt = np.abs(1.0 - self.bend.per_load_s2 * self.bend.reading(frequency_hz)) ** 2
        density: Floats = self.white + self.root * felt + self.roll * _differentiated(frequency_hz, self.step_s)
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
