"""Lines taken out of samples in plain Python: ``native/lines.c``."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.line_removal import LineStates
from companion.records import Floats, Ints

_AMPLITUDE_RADPS = 2.0 * np.pi * 2.0  # chosen: settles in 0.25 s
_PHASE_RADPS = 2.0 * np.pi * 4.0  # chosen: rpm that jumps by a tenth within half a second stays in lock
_K1, _K2, _K3 = 2.0 * _PHASE_RADPS, 2.0 * _PHASE_RADPS**2, _PHASE_RADPS**3  # derived: Butterworth's polynomial
_FLOOR = 0.05  # chosen, of the usual error squared: a line that is not yet seen turns nothing
_MAX_TURN_RAD = 0.5  # chosen: of psi; a larger one is no small angle
_MIN_PERIODS, _MAX_PERIODS = 0.1, 2.5  # chosen: no difference is taken across a shorter or longer gap
_MIN_GAIN = 0.002  # chosen, |g|^2: samples that hardly differ along the line say nothing of it (34 Hz at 1 kHz)
_OMEGA_RATIO = 0.3  # chosen: a line this far from where the spectrum showed it is lost
_MAX_ALPHA_RADPS2 = 2.0 * np.pi * 100.0  # chosen: of a harmonic; a shaft's inertia allows less
_MAX_ERRORS, _ERROR_MEMORY_S = 6.0, 0.5  # chosen: times the mean magnitude, over a few periods of the wing


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
    lines, channels = states.amplitude.shape
    out = values[first:].copy()
    g, turning, power = np.zeros(lines, np.complex128), np.zeros(lines), np.zeros(lines)
    for k in range(first, len(t_ns)):
        dt = (t_ns[k] - t_ns[k - 1]) * 1e-9 if k > 0 else period_s
        before = (t_ns[k - 1] - t_ns[k - 2]) * 1e-9 if k > 1 else np.inf
        shorter, longer = min(dt, before), max(dt, before)
        even = shorter > _MIN_PERIODS * period_s and longer < _MAX_PERIODS * period_s
        ratio = dt / before if even else 0.0
        for j in range(lines):
            states.omega_radps[j] += states.alpha_radps2[j] * dt if even else 0.0
            states.phase_rad[j] = (states.phase_rad[j] + states.omega_radps[j] * dt) % (2.0 * np.pi)
            here = np.exp(1j * states.phase_rad[j])
            back, twice = np.exp(-1j * states.omega_radps[j] * dt), np.exp(-1j * states.omega_radps[j] * (dt + before))
            g[j] = here * (1.0 - back - ratio * (back - twice)) if even else 0.0
            turning[j], power[j] = 0.0, 1e-30
        for c in range(channels if even else 0):
            error = values[k, c] - values[k - 1, c] - ratio * (values[k - 1, c] - values[k - 2, c])
            for j in range(lines):
                error -= (states.amplitude[j, c] * g[j]).real
            error = _limited(states.error, c, error, dt)
            for j in range(lines):
                gain = g[j].real ** 2 + g[j].imag ** 2
                if gain > _MIN_GAIN:
                    a, step = states.amplitude[j, c], 2.0 * error * np.conj(g[j]) / gain
                    turning[j] += states.weight[c] * (a.real * step.imag - a.imag * step.real)
                    power[j] += states.weight[c] * (
                        a.real * a.real + a.imag * a.imag + _FLOOR * states.error[c] ** 2 / gain
                    )
                    states.amplitude[j, c] += _AMPLITUDE_RADPS * dt * step
        for j in range(lines):
            if even:
                _turn(states, j, min(max(turning[j] / power[j], -_MAX_TURN_RAD), _MAX_TURN_RAD), dt)
            here = np.exp(1j * states.phase_rad[j])
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


def _turn(states: LineStates, j: int, psi: float, dt: float) -> None:
    """Move phase, frequency and its rate of a line towards a phase error."""
    states.phase_rad[j] += _K1 * psi * dt
    states.omega_radps[j] += _K2 * psi * dt
    states.alpha_radps2[j] += _K3 * psi * dt
    alpha = states.alpha_radps2[j]
    states.alpha_radps2[j] = min(max(alpha, -_MAX_ALPHA_RADPS2), _MAX_ALPHA_RADPS2)
    if np.abs(states.omega_radps[j] / states.anchor_radps[j] - 1.0) > _OMEGA_RATIO:
        states.omega_radps[j], states.alpha_radps2[j] = states.anchor_radps[j], 0.0
