"""Lines taken out of samples in plain Python: ``native/lines.c``."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.line_removal import PARTS, LineStates
from companion.records import Floats, Ints

_AMPLITUDE_RADPS = 2.0 * np.pi * 2.0  # chosen: settles in 0.25 s
_SLOWER_BELOW_RADPS = 2.0 * np.pi * 45.0  # chosen: below, amplitudes follow slower, for the wing's sake
_PHASE_RADPS = 2.0 * np.pi * 4.0  # chosen: rpm that jumps by a tenth within half a second stays in lock
_K1, _K2, _K3 = 2.0 * _PHASE_RADPS, 2.0 * _PHASE_RADPS**2, _PHASE_RADPS**3  # derived: Butterworth's polynomial
_CALM_RADPS = 2.0 * np.pi * 8.0  # chosen: twice the loop's, and below the beats of the wing with a line
_FLOOR = 0.05  # chosen, of the usual error squared: a line that is not yet seen turns nothing
_MAX_TURN_RAD = 0.5  # chosen: of psi; a larger one is no small angle
_MIN_PERIODS, _MAX_PERIODS = 0.1, 2.5  # chosen, of the lag: no difference is taken across a shorter or longer gap
_MIN_GAIN = 0.02  # chosen, |g|^2: samples that hardly differ along the line say nothing of it
_OMEGA_RATIO = 0.55  # chosen: a line this far from where the last search left it is lost
_MAX_ALPHA_RADPS2 = 2.0 * np.pi * 100.0  # chosen: of a harmonic; a shaft's inertia allows less
_MAX_ERRORS, _ERROR_MEMORY_S = 6.0, 0.5  # chosen: times the mean magnitude, over a few periods of the wing


def squared_envelope(samples: Floats, t_s: Floats, frequency_hz: float, length: int) -> tuple[float, float]:
    """Mean and variance of the squared envelope of a line: ``line_peaks.squared_envelope``."""
    turned = samples * np.exp(-2j * np.pi * frequency_hz * t_s)
    short = np.lib.stride_tricks.sliding_window_view(turned, length)[:: length // 2]
    square = np.abs(short @ np.hanning(length)) ** 2
    return float(square.mean()), float(square.var())


def remove_lines(t_ns: Ints, values: Floats, first: int, period_s: float, states: LineStates) -> Floats:
    """Samples without their lines; the states follow, in place.

    Parameters
    ----------
    t_ns : (s,) int64
        Stamps in order.
    values : (s, 6) float64
        Samples.
    first : int
        First sample to clean; the states belong to the one before it.
    period_s : float
        Usual time between samples.
    states : LineStates
        Of this station.

    Returns
    -------
    (s - first, 6) float64
    """
    (shafts,), (lines, channels) = states.omega_radps.shape, states.amplitude.shape
    out = values[first:].copy()
    g, turning, power = np.zeros(lines, np.complex128), np.zeros(shafts), np.zeros(shafts)
    shaft = states.shaft
    lag = states.lag
    usual = period_s * lag
    for k in range(first, len(t_ns)):
        dt = (t_ns[k] - t_ns[k - 1]) * 1e-9 if k > 0 else period_s
        after = (t_ns[k] - t_ns[k - lag]) * 1e-9 if k >= lag else np.inf
        before = (t_ns[k - lag] - t_ns[k - 2 * lag]) * 1e-9 if k >= 2 * lag else np.inf
        shorter, longer = min(after, before), max(after, before)
        even = shorter > _MIN_PERIODS * usual and longer < _MAX_PERIODS * usual and dt < _MAX_PERIODS * period_s
        ratio = after / before if even else 0.0
        states.omega_radps[:] += states.alpha_radps2 * dt if even else 0.0
        states.phase_rad[:] = (states.phase_rad + states.omega_radps * dt) % (2.0 * np.pi)
        turning[:], power[:] = 0.0, 1e-30
        for j in range(lines):
            omega_radps = states.multiple[j] * states.omega_radps[shaft[j]]
            here = np.exp(1j * states.multiple[j] * states.phase_rad[shaft[j]])
            back, twice = np.exp(-1j * omega_radps * after), np.exp(-1j * omega_radps * (after + before))
            g[j] = here * (1.0 - back - ratio * (back - twice)) if even else 0.0
        for c in range(channels if even else 0):
            last = values[k - lag, c]
            error = values[k, c] - last - ratio * (last - values[k - 2 * lag, c])
            for j in range(lines):
                error -= (states.amplitude[j, c] * g[j]).real
            error = _limited(states.error, c, error, dt)
            for j in range(lines):
                gain = g[j].real ** 2 + g[j].imag ** 2
                if gain > _MIN_GAIN:
                    a, step = states.amplitude[j, c], 2.0 * error * np.conj(g[j]) / gain
                    weight = 1.0 / max(states.error[c] ** 2, 1.0 / states.weight[c])
                    turns = states.multiple[j] / PARTS
                    squared, besides = a.real * a.real + a.imag * a.imag, states.error[c] ** 2 / gain
                    weight *= gain * squared / (squared + besides + 1e-30)
                    turning[shaft[j]] += weight * turns * (a.real * step.imag - a.imag * step.real)
                    power[shaft[j]] += weight * turns**2 * (squared + _FLOOR * besides)
                    slower = min(states.multiple[j] * states.anchor_radps[shaft[j]] / _SLOWER_BELOW_RADPS, 1.0)
                    states.amplitude[j, c] += slower * _AMPLITUDE_RADPS * dt * step
        for i in range(shafts if even else 0):
            psi = min(max(turning[i] / power[i], -_MAX_TURN_RAD), _MAX_TURN_RAD)
            _turn(states, i, 0.0 if states.led[i] else psi, dt)
        calm_rad = states.phase_rad - states.ahead_rad
        for j in range(lines):
            here = np.exp(1j * states.multiple[j] * calm_rad[shaft[j]])
            for c in range(channels):
                out[k - first, c] -= (states.amplitude[j, c] * here).real
    return out


def _limited(usual: Floats, c: int, error: float, dt: float) -> float:
    """Error within some times its usual magnitude, which follows: a blow or a lie is no line."""
    size = np.abs(error)
    if usual[c] > 0.0:
        size = min(size, _MAX_ERRORS * usual[c])
    usual[c] += (size - usual[c]) * (min(dt / _ERROR_MEMORY_S, 1.0) if usual[c] > 0.0 else 1.0)
    return float(np.sign(error) * size)


def _turn(states: LineStates, i: int, psi: float, dt: float) -> None:
    """Move phase, frequency and its rate of a shaft by a phase error of its leader."""
    unit_psi, limit = psi / PARTS, _MAX_ALPHA_RADPS2 / PARTS
    states.phase_rad[i] += _K1 * unit_psi * dt
    states.ahead_rad[i] = (states.ahead_rad[i] + _K1 * unit_psi * dt) / (1.0 + _CALM_RADPS * dt)
    states.omega_radps[i] += _K2 * unit_psi * dt
    states.alpha_radps2[i] = min(max(states.alpha_radps2[i] + _K3 * unit_psi * dt, -limit), limit)
    if np.abs(states.omega_radps[i] / states.anchor_radps[i] - 1.0) > _OMEGA_RATIO:
        states.omega_radps[i], states.alpha_radps2[i] = states.anchor_radps[i], 0.0
