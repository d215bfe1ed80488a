"""A free decay on a grid that carries the modes' band and no more, with the strength of its impulses.

The impulses were not measured. They are broad in frequency: the rms of the acceleration above the band, where no mode
of interest is, shows when they came and how strong they were relative to each other. One factor per recording scales it
to a load.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from companion.errors import RecordingError
from companion.records import Bools, Floats

_ABOVE = (4.0, 15.0)  # times the band's top: band in which impulses are seen and modes of interest are not (choice)
_LEAST_S = 2.0  # chosen: ten periods at 5 Hz, of fewer the damping is not known
_GAP_RATIO = 2.5  # chosen: of the usual step: one sample may be lost, two may not
_ROOM = 1.3  # times the band's upper edge, kept by the anti-alias filter (choice)
_VIBRATES = 0.3  # share of power above the band's lower edge from which a channel is a response (choice)
_ECHO = 20  # chosen: samples on either side of an impulse over which the edge of the band rings
_QUIET = 0.02  # chosen: of the mean square above the band, up to which a sample has no impulse


@dataclass(frozen=True, slots=True)
class RawFreeDecay:
    """One accelerometer as recorded: ``t_s``, ``up_mps2`` (n,), and channels beside it (n,)."""

    name: str
    t_s: Floats
    up_mps2: Floats
    channels: Mapping[str, Floats]


@dataclass(frozen=True, slots=True)
class FreeDecay:
    """One recording on its grid.

    Attributes
    ----------
    rate_hz : float
    t_s : (n,)
        From the start of the recording.
    up_mps2 : (n,)
        In the band below half the rate, mean removed.
    impulse_mps2 : (n,)
        Rms above the band, in each step.
    leakage_mps2 : (n,)
        Rms that the edge of the band makes of impulses in the samples before and after them.
    channels : dict of str to (n,)
        About the mean of all recordings, in units of their rms.
    amplitude : (n,)
        Of the deflection over its rms, as the null's filter follows it; ones before that was fitted.
    rms_m : float
        Rms of the deflection in all recordings.
    notes : tuple of str
    """

    name: str
    rate_hz: float
    t_s: Floats
    up_mps2: Floats
    impulse_mps2: Floats
    leakage_mps2: Floats
    channels: dict[str, Floats]
    amplitude: Floats
    rms_m: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Scale:
    """Mean and rms of a channel: ``recorded = mean + rms * channel``."""

    mean: float
    rms: float


def prepare(raws: Sequence[RawFreeDecay], band_hz: tuple[float, float]) -> tuple[list[FreeDecay], dict[str, Scale]]:
    """Put recordings on their grids; channels that all of them have are scaled alike.

    Raises
    ------
    RecordingError
        Sampled too slowly to see impulses above the band, or shorter than 2 s without a gap.
    """
    cut = [_longest(raw) for raw in raws]
    shared = sorted(set.intersection(*(set(raw.channels) for raw, _ in cut)))
    vibrating = [name for name in shared if any(_vibrates(raw, name, band_hz) for raw, _ in cut)]
    shared = [name for name in shared if name not in vibrating]
    coarse = [_coarse(raw, band_hz, shared, note) for raw, note in cut]
    scales = {}
    for name in shared:
        pooled = np.concatenate([record.channels[name] for record in coarse])
        if float(pooled.std()) > 0.0:
            scales[name] = Scale(float(pooled.mean()), float(pooled.std()))
    vibration_notes = [
        f"{name} vibrates with the structure: taken for a response, not for a cause" for name in vibrating
    ]
    records = [
        FreeDecay(
            record.name,
            record.rate_hz,
            record.t_s,
            record.up_mps2,
            record.impulse_mps2,
            record.leakage_mps2,
            {name: (record.channels[name] - scale.mean) / scale.rms for name, scale in scales.items()},
            record.amplitude,
            record.rms_m,
            (*record.notes, *vibration_notes) if record is coarse[0] else record.notes,
        )
        for record in coarse
    ]
    return records, scales


def _vibrates(raw: RawFreeDecay, name: str, band_hz: tuple[float, float]) -> bool:
    """Whether a channel has more than 0.3 of its power in the band of the modes or above."""
    values = raw.channels[name] - raw.channels[name].mean()
    f_hz = np.fft.rfftfreq(len(values), float(np.median(np.diff(raw.t_s))))
    power = np.abs(np.fft.rfft(values)) ** 2
    return float(power[f_hz > band_hz[0]].sum()) > _VIBRATES * float(power.sum())


def _longest(raw: RawFreeDecay) -> tuple[RawFreeDecay, tuple[str, ...]]:
    """The longest stretch without a gap, and a note where that is not all."""
    steps = np.diff(raw.t_s)
    wide = np.flatnonzero(steps > _GAP_RATIO * np.median(steps))
    edges = [0, *(wide + 1).tolist(), len(raw.t_s)]
    first, last = max(itertools.pairwise(edges), key=lambda pair: pair[1] - pair[0])
    length_s = float(raw.t_s[last - 1] - raw.t_s[first])
    if length_s < _LEAST_S:
        raise RecordingError(
            f"{raw.name}: the longest stretch without a gap is {length_s:.1f} s; {_LEAST_S:g} s needed"
        )
    segment = slice(first, last)
    longest = RawFreeDecay(
        raw.name, raw.t_s[segment], raw.up_mps2[segment], {k: v[segment] for k, v in raw.channels.items()}
    )
    if not wide.size:
        return longest, ()
    note = f"{raw.name}: {wide.size} gaps; judged is the longest stretch without one, {length_s:.1f} s"
    return longest, (note,)


def _coarse(
    raw: RawFreeDecay, band_hz: tuple[float, float], shared: Sequence[str], notes: tuple[str, ...]
) -> FreeDecay:
    count = len(raw.t_s)
    fine_hz = (count - 1) / float(raw.t_s[-1] - raw.t_s[0])
    if fine_hz < 2.5 * _ABOVE[0] * band_hz[1]:
        raise RecordingError(
            f"{raw.name}: sampled at {fine_hz:.0f} Hz; to see impulses above a band up to {band_hz[1]:g} Hz it takes "
            f"{2.5 * _ABOVE[0] * band_hz[1]:.0f} Hz"
        )
    even_t = raw.t_s[0] + np.arange(count) / fine_hz
    up = np.interp(even_t, raw.t_s, raw.up_mps2 - raw.up_mps2.mean())
    keep = 2 * math.ceil(count * _ROOM * band_hz[1] / fine_hz)
    rate_hz = fine_hz * keep / count
    f_hz = np.fft.rfftfreq(count, 1.0 / fine_hz)
    spectrum = np.fft.rfft(up)
    f_low = f_hz[: keep // 2 + 1]
    # a sharp edge would ring like a mode of its own at every impulse
    edge = np.clip((f_low - band_hz[1]) / (0.5 * rate_hz - band_hz[1]), 0.0, 1.0)
    passed = np.where(f_low < 0.5 * band_hz[0], 0.0, 0.5 + 0.5 * np.cos(np.pi * edge))
    low = np.fft.irfft(passed * spectrum[: keep // 2 + 1], keep)
    above = (f_hz > _ABOVE[0] * band_hz[1]) & (f_hz < min(_ABOVE[1] * band_hz[1], 0.45 * fine_hz))
    loud = np.fft.irfft(np.where(above, spectrum, 0.0), count) ** 2
    edges = np.linspace(0, count, keep + 1).astype(int)
    impulse = np.sqrt(np.add.reduceat(loud, edges[:-1]) / np.diff(edges))
    thin = np.asarray(low * keep / count)
    channels = {name: np.add.reduceat(raw.channels[name], edges[:-1]) / np.diff(edges) for name in shared}
    t_s = np.arange(keep) / rate_hz
    return FreeDecay(
        raw.name, rate_hz, t_s, thin, impulse, leakage_of(impulse), channels, np.ones_like(thin), notes=notes
    )


def leakage_of(impulse: Floats) -> Floats:
    """Rms (m,) that the edge of the band makes of impulses (m,) in the samples around them."""
    lags = np.arange(-_ECHO, _ECHO + 1)
    return np.asarray(np.sqrt(np.convolve(impulse**2, 1.0 / (1.0 + np.abs(np.pi * lags) ** 4), mode="same")))


def quiet_samples(record: FreeDecay, ahead: int) -> Bools:
    """Samples (m,) before which no impulse came within ``ahead`` steps."""
    loud = record.impulse_mps2**2 > _QUIET * float(np.mean(record.impulse_mps2**2))
    near = np.convolve(loud, np.ones(ahead + 2))[: len(loud)] > 0.5
    return np.asarray(~near)
