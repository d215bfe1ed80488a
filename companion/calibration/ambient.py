"""Modes from flight: output only. Gusts drive the wing, nobody measures them, and their spectrum is taken as smooth.

The correlation function of a structure under white load is a sum of its free decays, so the positive half of the
spectrum (transform of the correlation at positive lags) has the structure's poles (Peeters and Van der Auweraer,
"PolyMAX: a revolution in operational modal analysis", 2005). An exponential window on the lags adds a known damping,
which is taken out again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.calibration.poles import Complex, stable_poles
from companion.records import Floats

_LAGS_S = 4.0  # of the correlations: some ten periods of a damped mode (choice)
_WINDOW_END = 0.03  # of the correlation window at its last lag: damping it adds is taken off again (choice)
_BLOCKS = 6  # of a recording, whose scatter gives the sigma (choice)
# chosen, of the decay that the correlation window adds: a line that decays more slowly is a tone, or a mode whose
# damping the window hides (at 7 Hz below 0.2 %)
_RESOLVED = 0.1
_NEAR = 0.08  # of the frequency: the same mode in another block (choice)


@dataclass(frozen=True, slots=True)
class AmbientMode:
    """A mode under unknown load; sigmas are those of the mean over blocks of the record."""

    frequency_hz: float
    frequency_sigma_hz: float
    damping: float
    damping_sigma: float
    blocks: int

    @property
    def resolved(self) -> bool:
        """Whether the line decays fast enough to be told from a steady tone."""
        return bool(2.0 * np.pi * self.frequency_hz * self.damping >= _RESOLVED * -np.log(_WINDOW_END) / _LAGS_S)


def ambient_modes(samples: Floats, rate_hz: float, band_hz: tuple[float, float]) -> list[AmbientMode]:
    """Modes of evenly sampled accelerations.

    Parameters
    ----------
    samples : (n, channels) float64
        Channels of one kind of motion: all symmetric, or all antisymmetric.
    rate_hz : float
        Of the samples.
    band_hz : tuple
        Where modes are looked for.

    Returns
    -------
    list of AmbientMode
        By frequency; those that the whole record and at least half of its blocks show.
    """
    record_poles = _poles(samples, rate_hz, band_hz)
    blocks = [_poles(block, rate_hz, band_hz) for block in np.array_split(samples, _BLOCKS)]
    modes = []
    for frequency, damping in record_poles:
        near = [_nearest(block, frequency) for block in blocks]
        block_poles = np.array([each for each in near if each is not None])
        if len(block_poles) >= 0.5 * _BLOCKS:
            spread = block_poles.std(axis=0, ddof=1) / np.sqrt(len(block_poles))
            modes.append(AmbientMode(frequency, float(spread[0]), damping, float(spread[1]), len(block_poles)))
    return modes


def half_spectrum(samples: Floats, rate_hz: float, band_hz: tuple[float, float]) -> tuple[Floats, Complex, float]:
    """Frequencies (k,), positive half spectra (channels^2, k), and the decay rate (1/s) that the window added."""
    n, lags = len(samples), min(round(_LAGS_S * rate_hz), len(samples) // 4)
    padded = np.fft.rfft(samples - samples.mean(axis=0), n=2 * n, axis=0)
    decay = -np.log(_WINDOW_END) / (lags / rate_hz)
    window = np.exp(-decay * np.arange(lags) / rate_hz)
    pairs = [(i, j) for i in range(samples.shape[1]) for j in range(samples.shape[1])]
    correlations = [np.fft.irfft(padded[:, i] * np.conj(padded[:, j]))[:lags] * window for i, j in pairs]
    size = 4 * lags
    frequency: Floats = np.asarray(np.fft.rfftfreq(size, 1.0 / rate_hz), dtype=np.float64)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    halves = [np.fft.rfft(correlation, n=size)[inside] for correlation in correlations]
    return frequency[inside], np.array(halves, dtype=np.complex128), float(decay)


def _poles(samples: Floats, rate_hz: float, band_hz: tuple[float, float]) -> Floats:
    """(n, 2) frequency and damping ratio, the window's share taken out."""
    frequency, response, decay = half_spectrum(samples, rate_hz, band_hz)
    poles = []
    for pole in stable_poles(frequency, response, range(8, 31, 2), most_damping=0.3):
        value = pole.value + decay
        if value.real < 0.0:
            poles.append((abs(value) / (2.0 * np.pi), -value.real / abs(value)))
    return np.array(poles, dtype=np.float64).reshape(-1, 2)


def _nearest(poles: Floats, frequency_hz: float) -> Floats | None:
    if not len(poles):
        return None
    best = poles[np.argmin(np.abs(poles[:, 0] - frequency_hz))]
    return best if abs(best[0] - frequency_hz) < _NEAR * frequency_hz else None
