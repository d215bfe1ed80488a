"""Amplitude, frequency and growth of a vibration by windows of some periods, without a model of their causes.

With z(t) the complex envelope of a channel about its strongest frequency, averaged over two periods so that neither the
mean nor harmonics are in it, amplitude is |z|, frequency the slope of its phase, growth the slope of ln |z|.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import medfilt

from companion.diagnosis.channel_defects import CLIPPED, SPIKE, is_clipped, wild_samples
from companion.errors import RecordingError
from companion.records import Bools, Complexes, Floats

_WINDOW = 2  # periods: as long as the averaging, short against a growth (choice)
_UNEVEN = 0.15  # rms of ln z about its line, from which a window has a blow or a beat in it (choice)
# chosen, growth of ln amplitude in a period: a steeper rise is a blow's though it lies on a line (damping ratio -0.08)
_RISE = 0.5
_LEAST_CYCLES = 20  # periods of steady amplitude that are a limit cycle: a slow growth changes more (choice)
_LEAST_PASSED = 0.3  # least gain of the average over two periods by which an amplitude is divided (choice)
_FINER = 8  # zero padding of a spectrum whose peak is interpolated (choice)
_ABOVE = 3.0  # times the band's top, up to which a stronger vibration is looked for (choice)
_CLEAR = 10.0  # chosen: times the median of a spectrum: the largest of 1000 bins of noise has 3.2
_NOISE_FLOOR = 6.0  # times the rms beside the mode, below which an envelope counts as noise (choice)
_COHERENT = 0.9  # chosen: of the sum of a cross-spectrum without phases: 0.45 rad rms of phase
STEADY = 0.06
"""Relative range of the amplitude in what counts as a limit cycle (choice)."""


@dataclass(frozen=True, slots=True)
class RawVibration:
    """One recording: ``t_s`` (n,), responses by name (n,), the airspeed that it says (None: none), measured forces."""

    name: str
    t_s: Floats
    responses: Mapping[str, Floats]
    airspeed_mps: float | None
    forces: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class VibrationTrack:
    """One recording by windows (w,).

    Attributes
    ----------
    t_s, frequency_hz, growth_radps : (w,)
        Middle of each window, slope of the phase, slope of ln amplitude.
    amplitude : dict of str to (w,)
        By response, in its own unit.
    steady : (w,)
        Whether the window is part of a limit cycle.
    forces, driven_by : tuple of str
        Forces that were measured, and those with a line in step with the limit cycle.
    """

    name: str
    airspeed_mps: float | None
    t_s: Floats
    frequency_hz: Floats
    growth_radps: Floats
    amplitude: dict[str, Floats]
    steady: Bools
    forces: tuple[str, ...] = ()
    driven_by: tuple[str, ...] = ()


def track(raw: RawVibration, band_hz: tuple[float, float]) -> VibrationTrack:
    """Follow the strongest frequency of a band; the first response leads.

    Raises
    ------
    RecordingError
        Fewer periods than three windows have, a response is clipped, or a stronger limit cycle lies above the band.
    """
    _refuse_clipped(raw)
    rate_hz = (len(raw.t_s) - 1) / float(raw.t_s[-1] - raw.t_s[0])
    even_s = raw.t_s[0] + np.arange(len(raw.t_s)) / rate_hz
    channels = {name: _clean(np.interp(even_s, raw.t_s, values)) for name, values in raw.responses.items()}
    lead = next(iter(channels.values()))
    centre_hz = _leading_hz(raw.name, lead, rate_hz, band_hz)
    period = max(round(rate_hz / centre_hz), 2)
    at = np.arange(2 * period, len(lead) - 2 * period, period)
    if len(at) < 3 * _WINDOW:
        raise RecordingError(f"{raw.name}: shorter than {3 * _WINDOW + 4} periods of {centre_hz:.2f} Hz")
    envelopes = {name: _envelope(values, centre_hz / rate_hz, period)[at] for name, values in channels.items()}
    z, t_s = next(iter(envelopes.values())), even_s[at] - even_s[0]
    windows = [slice(first, first + _WINDOW + 1) for first in range(0, len(at) - _WINDOW, _WINDOW)]
    middle_s, offset_hz, growth_radps, uneven = np.array([_slopes(t_s[window], z[window]) for window in windows]).T
    uneven = np.where(growth_radps * period > _RISE * rate_hz, np.inf, uneven)
    # the average over two periods takes away from what is beside its frequency
    passed = np.maximum(np.sinc(offset_hz * period / rate_hz) ** 2, _LEAST_PASSED)
    levels = {name: _levels(envelope, windows) / passed for name, envelope in envelopes.items()}
    level = next(iter(levels.values()))
    keep, cycling = _usable(level, uneven, _NOISE_FLOOR * _beside(lead, rate_hz, centre_hz))
    middles = _WINDOW * np.flatnonzero(cycling) + _WINDOW // 2

    def drives(values: Floats) -> bool:
        force = _clean(np.interp(even_s, raw.t_s, values))
        line = _envelope(force, centre_hz / rate_hz, period)[at][middles]
        return _in_step(line, z[middles], _NOISE_FLOOR * _beside(force, rate_hz, centre_hz))

    return VibrationTrack(
        raw.name,
        raw.airspeed_mps,
        middle_s[keep],
        centre_hz + offset_hz[keep],
        growth_radps[keep],
        {name: values[keep] for name, values in levels.items()},
        cycling[keep],
        tuple(raw.forces),
        tuple(name for name, values in raw.forces.items() if drives(values)),
    )


def _refuse_clipped(raw: RawVibration) -> None:
    for name, values in raw.responses.items():
        if is_clipped(values):
            raise RecordingError(f"{raw.name}: {name} {CLIPPED}, its amplitude unknown")


def _leading_hz(name: str, lead: Floats, rate_hz: float, band_hz: tuple[float, float]) -> float:
    """Strongest frequency of a band in the leading response of a recording."""
    centre_hz, peak, _ = _strongest(lead, rate_hz, band_hz)
    above_hz, other, usual = _strongest(lead, rate_hz, (band_hz[1], min(_ABOVE * band_hz[1], 0.5 * rate_hz)))
    if other > max(peak, _CLEAR * usual) and _cycles(lead, rate_hz, above_hz):
        raise RecordingError(
            f"{name}: its limit cycle, at {above_hz:.2f} Hz, lies above band_hz, which ends at "
            f"{band_hz[1]:g} Hz: widen the band"
        )
    if not centre_hz:
        raise RecordingError(f"{name}: too short to tell a frequency from {band_hz[0]:g} to {band_hz[1]:g} Hz")
    return centre_hz


def _slopes(t_s: Floats, z: Complexes) -> tuple[float, float, float, float]:
    """Middle of a window in s, its phase's slope in Hz, its growth in rad/s, and the rms of ln z about both lines."""
    since_s = t_s - t_s.mean()
    log_a, phase = np.log(np.maximum(np.abs(z), 1e-300)), np.unwrap(np.angle(z))
    growth, level = np.polyfit(since_s, log_a, 1)
    slope_radps, middle_rad = np.polyfit(since_s, phase, 1)
    residual = log_a - level + 1j * (phase - middle_rad) - (growth + 1j * slope_radps) * since_s
    return float(t_s.mean()), float(slope_radps / (2.0 * np.pi)), float(growth), float(np.std(residual))


def _levels(envelope: Complexes, windows: list[slice]) -> Floats:
    """Geometric mean of an envelope's amplitude in each window, (w,)."""
    return np.array([np.exp(np.mean(np.log(np.abs(envelope[window]) + 1e-300))) for window in windows])


def _usable(level: Floats, uneven: Floats, floor: float) -> tuple[Bools, Bools]:
    """Windows (w,) of a limit cycle or without a blow, above the noise, and those of a limit cycle."""
    steady, loud = _steady(level, _LEAST_CYCLES // _WINDOW), level > floor
    near = np.convolve(uneven > _UNEVEN, np.ones(3))[1:-1] > 0.5  # averages reach one window further
    return steady | (~near & loud), steady & loud


def _in_step(line: Complexes, vibration: Complexes, floor: float) -> bool:
    """Whether the envelope of a force (w,) stands above its noise, at a constant phase to that of a vibration (w,)."""
    if not len(line) or float(np.median(np.abs(line))) < max(floor, 1e-300):
        return False
    turn = line * np.conj(vibration)
    return bool(np.abs(np.sum(turn)) > _COHERENT * np.sum(np.abs(turn)))


def _clean(values: Floats) -> Floats:
    """The channel about its median, wild single samples replaced by their neighbours' median."""
    return np.asarray(np.where(wild_samples(values), medfilt(values, SPIKE), values) - np.median(values))


def _cycles(values: Floats, rate_hz: float, centre_hz: float) -> bool:
    """Whether a channel (n,) keeps its amplitude at a frequency."""
    period = max(round(rate_hz / centre_hz), 2)
    at = np.arange(2 * period, len(values) - 2 * period, _WINDOW * period)
    amplitude = np.abs(_envelope(values, centre_hz / rate_hz, period))[at]
    return bool(_steady(amplitude, _LEAST_CYCLES // _WINDOW).any())


def _strongest(values: Floats, rate_hz: float, band_hz: tuple[float, float]) -> tuple[float, float, float]:
    """Frequency in Hz of the largest peak in a band, its height, and the median; zeros where the band is empty."""
    count = _FINER * len(values)
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)), count))
    f_hz = np.fft.rfftfreq(count, 1.0 / rate_hz)
    inside = (f_hz > band_hz[0]) & (f_hz < band_hz[1])
    if not inside.any():
        return 0.0, 0.0, 0.0
    k = int(np.argmax(power[inside]))
    return float(f_hz[inside][k]), float(power[inside][k]), float(np.median(power[inside]))


def _envelope(values: Floats, frequency: float, period: int) -> Complexes:
    box = np.ones(period) / period
    demodulated = values * np.exp(-2j * np.pi * frequency * np.arange(len(values)))
    return np.asarray(2.0 * np.convolve(demodulated, np.convolve(box, box), "same"))


def _steady(amplitude: Floats, least: int) -> Bools:
    """Windows within a run of at least ``least`` whose amplitude stays within a few per cent."""
    steady = np.zeros(len(amplitude), dtype=np.bool_)
    for first in range(len(amplitude) - least + 1):
        run = amplitude[first : first + least]
        if float(np.ptp(run)) < STEADY * float(run.mean()):
            steady[first : first + least] = True
    return steady


def _beside(values: Floats, rate_hz: float, centre_hz: float) -> float:
    """Rms of the noise in an envelope: the least of three bands, each as wide as f, from 3.3 to 8.3 f."""
    count = len(values)
    f_hz = np.fft.rfftfreq(count, 1.0 / rate_hz)
    power = 2.0 * np.abs(np.fft.rfft(values)) ** 2 / count**2
    bands = [float(power[(f_hz > k * centre_hz) & (f_hz < (k + 1.0) * centre_hz)].sum()) for k in (3.3, 5.3, 7.3)]
    return float(np.sqrt(min((band for band in bands if band > 0.0), default=0.0)))
