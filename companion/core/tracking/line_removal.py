"""Lines of motors and propellers, taken out of a station's samples before they are averaged over epochs.

An average over an epoch lets a line pass (84 % of one at 80 Hz in 4 ms) or folds it onto the wing's band. So each line
that :mod:`companion.core.tracking.line_search` has found is followed in the samples themselves, as ``Re(a exp(i phi))``
in every channel, and subtracted. The amplitude is fitted to the samples' second differences ``y``, in which the wing's
slow and large motion is small, by a loop of second order (Widrow and Glover, Proc. IEEE 63, 1975, with a rate):

    g = second difference of exp(i phi),   e = y - sum Re(a g)
    a' = r + 2 k1 e conj(g) / |g|^2,   r' = 2 k2 e conj(g) / |g|^2,   phi' = omega

Its gain on the wing's motion at f differs from one by about ``k1 / (2 pi f0) (f/f0)^2``: 1e-4 at 5 Hz, 2e-3 at 27 Hz
for a line at 80 Hz. A common rotation of the amplitudes of all channels is moved into ``omega``, which so follows rpm.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from companion.core.kernels.compiled import compiled
from companion.records import Floats, Ints

Complexes = npt.NDArray[np.complex128]

_LOOP_RADPS = 2.0 * np.pi * 2.0  # chosen: settles in 0.25 s, follows rpm that wanders within seconds
_LOOP_DAMPING = 0.8  # chosen: hardly overshoots
_K1, _K2 = 2.0 * _LOOP_DAMPING * _LOOP_RADPS, _LOOP_RADPS**2
_FREQUENCY_RADPS = 2.0 * np.pi * 0.6  # chosen: rate at which a common rotation is moved into the frequency
_MAX_PERIODS = 2.5  # chosen: no difference is taken across a longer gap
_MIN_GAIN = 0.02  # chosen, |g|^2: samples that hardly differ along the line say nothing of it
_MAX_OFFSET_RADPS = 2.0 * np.pi * 3.0  # chosen: a line this far from where the spectrum shows it is lost

_MAX_ERRORS, _ERROR_MEMORY_S = 6.0, 0.5  # chosen: times the mean magnitude, over a few periods of the wing


class LineStates(NamedTuple):
    """Lines of one station: what the loop carries from sample to sample.

    Attributes
    ----------
    anchor_radps, omega_radps, phase_rad : (l,) float64
        Frequency as found in the spectrum, as followed, and phase at the newest sample.
    amplitude, rate : (l, 6) complex128
        ``a`` and ``r`` of every channel, in its unit and per second.
    error : (6,) float64
        Mean magnitude of ``e`` over the last half second; 0 at the start.
    weight : (6,) float64
        Of the channels in the common rotation: the inverse of the sensor's noise, squared.
    """

    anchor_radps: Floats
    omega_radps: Floats
    phase_rad: Floats
    amplitude: Complexes
    rate: Complexes
    error: Floats
    weight: Floats


def line_states(frequency_hz: Floats, weight: Floats) -> LineStates:
    """States of lines that are yet to be followed from these frequencies on, (l,)."""
    omega_radps, shape = 2.0 * np.pi * frequency_hz, (len(frequency_hz), len(weight))
    still: Complexes = np.zeros(shape, np.complex128)
    return LineStates(
        omega_radps, omega_radps.copy(), np.zeros(shape[0]), still, still.copy(), np.zeros(shape[1]), weight
    )


def copied(states: LineStates) -> LineStates:
    """Copy whose changes leave the original alone."""
    columns: Any = (array.copy() for array in states)
    return LineStates(*columns)


@compiled
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
    g = np.zeros(lines, np.complex128)
    for k in range(first, len(t_ns)):
        dt = (t_ns[k] - t_ns[k - 1]) * 1e-9 if k > 0 else period_s
        before = (t_ns[k - 1] - t_ns[k - 2]) * 1e-9 if k > 1 else np.inf
        ratio = dt / before
        even = dt < _MAX_PERIODS * period_s and before < _MAX_PERIODS * period_s
        for j in range(lines):
            states.phase_rad[j] = (states.phase_rad[j] + states.omega_radps[j] * dt) % (2.0 * np.pi)
            here = np.exp(1j * states.phase_rad[j])
            back, twice = np.exp(-1j * states.omega_radps[j] * dt), np.exp(-1j * states.omega_radps[j] * (dt + before))
            g[j] = here * (1.0 - back - ratio * (back - twice)) if even else 0.0
            for c in range(channels):
                states.amplitude[j, c] += states.rate[j, c] * dt if dt < 0.1 else 0.0
        for c in range(channels if even else 0):
            error = values[k, c] - values[k - 1, c] - ratio * (values[k - 1, c] - values[k - 2, c])
            for j in range(lines):
                error -= (states.amplitude[j, c] * g[j]).real
            error = _limited(states.error, c, error, dt)
            for j in range(lines):
                gain = g[j].real ** 2 + g[j].imag ** 2
                if gain > _MIN_GAIN:
                    step = 2.0 * dt * error * np.conj(g[j]) / gain
                    states.amplitude[j, c] += _K1 * step
                    states.rate[j, c] += _K2 * step
        for j in range(lines):
            _follow_rotation(states, j, dt)
            here = np.exp(1j * states.phase_rad[j])
            for c in range(channels):
                out[k - first, c] -= (states.amplitude[j, c] * here).real
    return out


@compiled
def _limited(usual: Floats, c: int, error: float, dt: float) -> float:
    """Error within some times its usual magnitude, which follows: a blow or a lie is no line."""
    size = np.abs(error)
    if usual[c] > 0.0:
        size = min(size, _MAX_ERRORS * usual[c])
    usual[c] += (size - usual[c]) * (min(dt / _ERROR_MEMORY_S, 1.0) if usual[c] > 0.0 else 1.0)
    return float(np.sign(error) * size)


@compiled
def _follow_rotation(states: LineStates, j: int, dt: float) -> None:
    """Move the rotation that the amplitudes of a line have in common into its frequency."""
    turning, power = 0.0, 1e-30
    for c in range(states.amplitude.shape[1]):
        a, r = states.amplitude[j, c], states.rate[j, c]
        turning += states.weight[c] * (a.real * r.imag - a.imag * r.real)
        power += states.weight[c] * (a.real * a.real + a.imag * a.imag)
    shift = min(_FREQUENCY_RADPS * dt, 0.1) * turning / power
    if np.abs(states.omega_radps[j] + shift - states.anchor_radps[j]) > _MAX_OFFSET_RADPS:
        shift = states.anchor_radps[j] - states.omega_radps[j]
    states.omega_radps[j] += shift
    for c in range(states.amplitude.shape[1]):
        states.rate[j, c] -= 1j * shift * states.amplitude[j, c]
