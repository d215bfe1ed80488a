"""Delay of the tips' readings against the root's, from the recoil of the fuselage against a bending wing.

In a symmetric mode a free fuselage moves against the tips, in proportion and at once: the root's sensor is a clock for
the tips' sensors and their filters, and none for the cameras. The gust also lifts the fuselage directly, in proportion
to the load of the mode. A tip's acceleration is -omega^2 R load, so this part is -1/(omega^2 R) times that of the tips:

    root(f) = [-rho + kappa (1 - (f_0/f)^2 - 2j zeta f_0/f)] tips(f) e^(j omega tau) + noise

rho, kappa and tau (s) are fitted by least squares about the first mode f_0 (Hz), with its believed damping ratio zeta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.core.wing.lowpass import Butterworth2
from companion.params.airframe import Airframe
from companion.records import Floats, Side

_BAND = 0.2  # of the first mode's frequency, to either side: most of the mode's power, and little of any other (choice)
# least share of the root's power that the fit explains; with less another mode takes part (choice)
_COHERENT = 0.95
_PASSES = 3  # chosen: linear fits in the delay, each about the last: a small delay converges at once
# derived: bins of a Hann window for each independent product of two transforms, n sum w^4 / (sum w^2)^2
_BINS_PER_INDEPENDENT = 35.0 / 18.0
_FEWEST_BINS = 12  # in the band, for three real numbers and their error (choice)


@dataclass(frozen=True, slots=True)
class RecoilDelay:
    """How late the tips' readings are against the root's, beyond their believed filters, at one frequency."""

    frequency_hz: float
    delay_s: float
    sigma_s: float


def recoil_delay(tips_mps2: Floats, root_mps2: Floats, rate_hz: float, airframe: Airframe) -> RecoilDelay | None:
    """Measure it on tips (m, 2) and root (m,), whose own filter is undone, m/s^2; None where no recoil shows.

    An error of the believed damping turns the phase of the directly lifted part, and adds to the sigma.
    """
    mode = airframe.wing.symmetric
    first_hz, zeta = mode.frequency_hz.value, mode.damping.value
    f_hz = np.asarray(np.fft.rfftfreq(len(root_mps2), 1.0 / rate_hz))
    band = np.abs(f_hz / first_hz - 1.0) < _BAND
    if tips_mps2.shape[1] < len(Side) or np.count_nonzero(band) < _FEWEST_BINS:
        return None
    omega = 2.0 * np.pi * f_hz[band]
    window = np.hanning(len(root_mps2))
    root, *tips = (np.fft.rfft(window * (x - x.mean()))[band] for x in (root_mps2, *tips_mps2.T))
    corners_hz = [sensor.lowpass_accel_hz for sensor in (airframe.left, airframe.right)]
    passed = [Butterworth2(corner).response(f_hz[band]) if corner else 1.0 for corner in corners_hz]
    both = sum(tip / gain for tip, gain in zip(tips, passed, strict=True)) / len(tips)
    ratio = 2.0 * np.pi * first_hz / omega
    lifted = 1.0 - ratio**2 - 2j * zeta * ratio
    delay_s = 0.0
    for _ in range(_PASSES):
        delayed = both * np.exp(1j * omega * delay_s)
        columns = np.stack([delayed, lifted * delayed, 1j * omega * delayed], axis=1)
        table, wanted = np.vstack([columns.real, columns.imag]), np.concatenate([root.real, root.imag])
        weights = np.linalg.lstsq(table, wanted, rcond=None)[0]
        delay_s += float(weights[2] / weights[0])
    left = float(np.sum((wanted - table @ weights) ** 2))
    if left > (1.0 - _COHERENT) * float(wanted @ wanted):
        return None
    scatter = left / (len(wanted) - len(weights)) * _BINS_PER_INDEPENDENT
    chance_s = math.sqrt(scatter * float(np.linalg.inv(table.T @ table)[2, 2])) / abs(float(weights[0]))
    of_damping_s = 2.0 * mode.damping.sigma * abs(float(weights[1] / weights[0])) / (2.0 * math.pi * first_hz)
    return RecoilDelay(first_hz, delay_s, math.hypot(chance_s, of_damping_s, airframe.root.time_offset_sigma_s))
