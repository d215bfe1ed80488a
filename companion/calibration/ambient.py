"""Modes from flight: output only. Gusts drive the wing, nobody measures them, and their spectrum is taken as smooth.

The correlation function of a structure under white load is a sum of its free decays, so the positive half of the
spectrum (transform of the correlation at positive lags) has the structure's poles (Peeters and Van der Auweraer,
"PolyMAX: a revolution in operational modal analysis", 2005). An exponential window on the lags adds a known damping,
which is taken out again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.calibration.poles import stable_poles
from companion.records import Complexes, Floats

_LAGS_S = 4.0  # of the correlations: some ten periods of a damped mode (choice)
_WINDOW_END = 0.03  # of the correlation window at its last lag: damping it adds is taken off again (choice)
_BLOCKS = 6  # of a recording, whose scatter gives the sigma (choice)
# chosen, of the decay that the correlation window adds: a line that decays more slowly is a tone, or a mode whose
# damping the window hides (at 7 Hz below 0.2 %)
_RESOLVED = 0.1
_NEAR = 0.08  # of the frequency: the same mode in another block (choice)


@dataclass(frozen=True, slots=True)
class AmbientMode:
    """A mode under unknown load; sigmas are the scatter of the blocks' mean, and how far the record is from it."""

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
        By frequency; those that the whole record and at least half of its blocks show. A pole of a block counts for one
        mode alone: where the whole record splits what each block shows as one, that one is the mean of the blocks.
    """
    record_poles = _poles(samples, rate_hz, band_hz)
    blocks = [_poles(block, rate_hz, band_hz) for block in np.array_split(samples, _BLOCKS)]
    claimed: list[list[Floats]] = [[] for _ in record_poles]
    for block in blocks:
        for mode, pole in _pairs(record_poles, block):
            claimed[mode].append(pole)
    modes_held = [mode for mode, poles in enumerate(claimed) if len(poles) >= 0.5 * _BLOCKS]
    modes = []
    for mode in modes_held:
        poles = np.array(claimed[mode])
        near = [other for other, pole in enumerate(record_poles) if _is_near(pole, record_poles[mode])]
        is_split = any(
            other not in modes_held and _nearest_of(modes_held, record_poles, other) == mode for other in near
        )
        value = poles.mean(axis=0) if is_split else record_poles[mode]
        # a record and its blocks that disagree by more than the blocks' scatter know the mode no better than that
        spread = np.hypot(poles.std(axis=0, ddof=1) / np.sqrt(len(poles)), value - poles.mean(axis=0))
        modes.append(AmbientMode(float(value[0]), float(spread[0]), float(value[1]), float(spread[1]), len(poles)))
    return modes


def half_spectrum(samples: Floats, rate_hz: float, band_hz: tuple[float, float]) -> tuple[Floats, Complexes, float]:
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


def _pairs(record_poles: Floats, block_poles: Floats) -> list[tuple[int, Floats]]:
    """Modes of the record with the pole of a block that is theirs, each at most once, the nearest pairs first."""
    near = [
        (_distance(record, block), mode, at)
        for mode, record in enumerate(record_poles)
        for at, block in enumerate(block_poles)
        if _is_near(block, record)
    ]
    pairs: dict[int, int] = {}
    for _, mode, at in sorted(near):
        if mode not in pairs and at not in pairs.values():
            pairs[mode] = at
    return [(mode, block_poles[at]) for mode, at in pairs.items()]


def _is_near(pole: Floats, record_pole: Floats) -> bool:
    return bool(abs(pole[0] - record_pole[0]) < _NEAR * record_pole[0])


def _distance(first: Floats, second: Floats) -> float:
    """Distance of two poles (frequency, damping ratio) in the complex plane over their frequency."""
    return float(np.hypot(first[0] / second[0] - 1.0, first[1] - second[1]))


def _nearest_of(modes: list[int], poles: Floats, other: int) -> int:
    return min(modes, key=lambda mode: _distance(poles[other], poles[mode]))
