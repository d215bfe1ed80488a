"""A free decay on a grid that carries the modes' band, with the strength of its impulses.

The impulses were not measured. They are broad in frequency: what the acceleration above the band, where no mode of
interest is, has beyond the sensor's noise shows when they came and how strong they were relative to each other. One
factor per recording scales it to a load.

The band ends smoothly, so that an impulse rings for a few samples only, and what is folded back by the lower rate keeps
white noise white. Nothing is taken away below the band: the filter follows the sensor's zero.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from companion.diagnosis.channel_defects import unbroken
from companion.errors import RecordingError
from companion.records import Bools, Complexes, Floats, Ints

_ABOVE = (4.0, 15.0)  # times the band's top: band in which impulses are seen and modes of interest are not (choice)
_LEAST_S = 2.0  # chosen: ten periods at 5 Hz, of fewer the damping is not known
_LEAST_STEPS = 30  # chosen: ten periods of the band's upper edge
_GAP_RATIO = 2.5  # chosen: of the usual step: one sample may be lost, two may not
_ROOM = 1.5  # times the band's upper edge, half the rate: leaves an octave for the edge (choice)
_BEYOND = 4.0  # chosen: periods of the band's upper edge, by which a recording is reflected at its ends
_VIBRATES = 0.3  # share of power above the band's lower edge from which a channel is a response (choice)
_ECHO = 20  # chosen: samples on either side of an impulse over which the edge's ringing is computed
_RINGS = 7  # derived: samples within which the edge's ringing falls below 0.005 of an impulse
_QUIET_SHARE = 0.2  # chosen: of the steps, at least so many have no impulse
_BY_CHANCE = 1e-5  # chosen: share of quiet steps that are taken for an impulse
_FREEDOMS = 2.0  # by definition: of noise in a narrow band, its two phases, however short the step
_STILL = 0.5  # chosen: of the later range, up to which motion before the first impulse is left out
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
        Below the band's upper edge, mean removed.
    impulse_mps2 : (n,)
        Rms above the band beyond the sensor's noise, in each step; 0 where there is no impulse.
    leakage_mps2 : (n,)
        Rms that the edge of the band makes of impulses in the samples before and after them.
    channels : dict of str to (n,)
        About the mean of all recordings, in units of their rms.
    amplitude : (n,)
        Of the deflection over its rms, as the filter of the last fit follows it; ones before the first.
    rms_m : float
        Rms of the deflection in all recordings.
    lowest_hz : float
        Lower edge of the band.
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
    lowest_hz: float = 0.0
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
        Sampled too slowly to see impulses above the band, or too short without a gap: 2 s are needed, and ten periods
        of the band's upper edge beside the ends that are dropped.
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
        dataclasses.replace(
            record,
            channels={name: (record.channels[name] - scale.mean) / scale.rms for name, scale in scales.items()},
            notes=(*record.notes, *vibration_notes) if record is coarse[0] else record.notes,
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
    segment, gaps = unbroken(raw.t_s, _GAP_RATIO * float(np.median(np.diff(raw.t_s))))
    t_s = raw.t_s[segment]
    length_s = float(t_s[-1] - t_s[0])
    if length_s < _LEAST_S:
        raise RecordingError(
            f"{raw.name}: the longest stretch without a gap is {length_s:.1f} s; {_LEAST_S:g} s needed"
        )
    longest = RawFreeDecay(raw.name, t_s, raw.up_mps2[segment], {k: v[segment] for k, v in raw.channels.items()})
    if not gaps:
        return longest, ()
    note = f"{raw.name}: {gaps} gaps; judged is the longest stretch without one, {length_s:.1f} s"
    return longest, (note,)


def _coarse(
    raw: RawFreeDecay, band_hz: tuple[float, float], shared: Sequence[str], notes: tuple[str, ...]
) -> FreeDecay:
    """One recording on its grid, its channels in their own units."""
    count, fine_hz = len(raw.t_s), _fast_enough_hz(raw, band_hz[1])
    even_t = raw.t_s[0] + np.arange(count) / fine_hz
    # the transform is periodic: beyond its ends the recording goes on as its odd reflection, which bends there
    beyond = round(_BEYOND / band_hz[1] * fine_hz)
    up = np.pad(np.interp(even_t, raw.t_s, raw.up_mps2), beyond, mode="reflect", reflect_type="odd")
    keep = 2 * math.ceil(len(up) * _ROOM * band_hz[1] / fine_hz)
    rate_hz = fine_hz * keep / len(up)
    f_hz = np.asarray(np.fft.rfftfreq(len(up), 1.0 / fine_hz), dtype=np.float64)
    spectrum = np.fft.rfft(up)
    low_pass = rise((rate_hz - band_hz[1] - f_hz) / (rate_hz - 2.0 * band_hz[1]))
    thin = _thinned(low_pass * spectrum, keep) * keep / len(up)
    edges = np.linspace(0, len(up), keep + 1).astype(int)
    above = _above(f_hz, band_hz[1], fine_hz)
    loud = _by_step(np.fft.irfft(above * spectrum, len(up)) ** 2, edges)
    power = beyond_noise(loud, 2.0 * float(np.sum(above**2)) / keep)
    outside = math.ceil(beyond * keep / len(up)) + _RINGS
    if keep - 2 * outside < _LEAST_STEPS:
        raise _too_short(raw.name, count / fine_hz, band_hz[1])
    inside = slice(_first(thin, power, outside, rate_hz), keep - outside)
    leakage = leakage_of(power, low_pass, edges)
    channels = {name: _by_step(np.pad(raw.channels[name], beyond, mode="edge"), edges)[inside] for name in shared}
    thin = np.asarray(thin[inside] - thin[inside].mean())
    t_s = np.asarray((np.arange(keep)[inside] + 0.5) / rate_hz - beyond / fine_hz, dtype=np.float64)
    return FreeDecay(
        raw.name,
        rate_hz,
        t_s,
        thin,
        np.sqrt(power[inside]),
        np.sqrt(leakage[inside]),
        channels,
        np.ones_like(thin),
        lowest_hz=band_hz[0],
        notes=notes,
    )


def _fast_enough_hz(raw: RawFreeDecay, top_hz: float) -> float:
    """Rate of a recording, or :class:`RecordingError`: too low to see impulses above the band."""
    rate_hz = (len(raw.t_s) - 1) / float(raw.t_s[-1] - raw.t_s[0])
    if rate_hz < 2.5 * _ABOVE[0] * top_hz:
        raise RecordingError(
            f"{raw.name}: sampled at {rate_hz:.0f} Hz; to see impulses above a band up to {top_hz:g} Hz it takes "
            f"{2.5 * _ABOVE[0] * top_hz:.0f} Hz"
        )
    return rate_hz


def _too_short(name: str, length_s: float, top_hz: float) -> RecordingError:
    needed_s = (_LEAST_STEPS + 2 * _RINGS + 2) / (2.0 * _ROOM * top_hz)  # two for what is rounded
    return RecordingError(
        f"{name}: the longest stretch without a gap is {length_s:.1f} s; for a band up to {top_hz:g} Hz "
        f"{needed_s:.1f} s are needed"
    )


def beyond_noise(power: Floats, freedoms: float) -> Floats:
    """Variance (m,) that impulses add to the sensor's noise above the band, whose level is that of the quiet steps.

    Noise of ``freedoms`` degrees of freedom in a step has a power distributed as chi squared.
    """
    freedoms = max(freedoms, _FREEDOMS)
    level = float(np.quantile(power, _QUIET_SHARE) / chi2.ppf(_QUIET_SHARE, freedoms))
    return np.where(power > level * chi2.isf(_BY_CHANCE, freedoms), power - level * freedoms, 0.0)


def rise(x: Floats) -> Floats:
    """Smooth step (n,) from 0 at x = 0 to 1 at x = 1, for x (n,); its square and that of 1 - x add to 1 (Meyer's)."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(np.sin(0.5 * np.pi * x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)))


def _first(up: Floats, power: Floats, outside: int, rate_hz: float) -> int:
    """Step from which a recording is judged: a little before the first impulse, if there was less motion before.

    A hand that pulls or steadies a structure is no impulse, and moves it in the band.
    """
    struck = np.flatnonzero(power[outside:-outside] > 0.0)
    first = outside + int(struck[0]) - _RINGS if struck.size else outside
    if first <= outside or len(up) - outside - first < max(_LEAST_S * rate_hz, _LEAST_STEPS):
        return outside
    return first if np.ptp(up[outside:first]) < _STILL * np.ptp(up[first:-outside]) else outside


def _above(f_hz: Floats, top_hz: float, fine_hz: float) -> Floats:
    lowest, highest = _ABOVE[0] * top_hz, min(_ABOVE[1] * top_hz, 0.45 * fine_hz)
    slope = 0.25 * (highest - lowest)
    return rise((f_hz - lowest) / slope) * rise((highest - f_hz) / slope)


def _by_step(values: Floats, edges: Ints) -> Floats:
    """Mean of each step, (m,)."""
    return np.asarray(np.add.reduceat(values, edges[:-1]) / np.diff(edges))


def _thinned(spectrum: Complexes, keep: int) -> Floats:
    """Samples (keep,) at the middles of steps, of a spectrum that ends below twice their Nyquist frequency."""
    half = keep // 2
    moved = spectrum[: keep + 1] * np.exp(1j * np.pi * np.arange(keep + 1) / keep)
    return np.asarray(np.fft.irfft(moved[: half + 1] + np.conj(moved[half:][::-1]), keep))


def leakage_of(power: Floats, low_pass: Floats, edges: Ints) -> Floats:
    """Variance (m,) that the edge of the band makes of impulses of some variance (m,) in the steps around them."""
    middle, ratio = len(power) // 2, edges[-1] / len(power)
    kernel = np.roll(np.fft.irfft(low_pass, edges[-1]), round((middle + 0.5) * ratio)) * ratio
    kernel[edges[middle] : edges[middle + 1]] -= 1.0
    kernel = _by_step(kernel**2, edges)[middle - _ECHO : middle + _ECHO + 1]
    return np.asarray(np.convolve(power, kernel, mode="same"))


def quiet_samples(record: FreeDecay, ahead: int) -> Bools:
    """Samples (m,) that an impulse neither shakes, nor did within ``ahead`` steps and the edge's ringing."""
    loud = record.impulse_mps2**2 > _QUIET * float(np.mean(record.impulse_mps2**2))
    near = np.convolve(loud, np.ones(ahead + 2 + 2 * _RINGS))[_RINGS : _RINGS + len(loud)] > 0.5
    return np.asarray(~near)
