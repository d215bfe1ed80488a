"""Lines of motors and propellers, taken out of a station's samples before they are averaged over epochs.

An average over an epoch lets a line pass (84 % of one at 80 Hz in 4 ms) or folds it onto the wing's band. So each line
that :mod:`companion.core.tracking.line_search` has found is followed in the samples themselves, as ``Re(a exp(i phi))``
in every channel, and subtracted. Both are fitted to the samples' second differences ``y``, in which the wing's slow and
large motion is small (Widrow and Glover, Proc. IEEE 63, 1975, for ``a``; a phase-locked loop of third order for rpm):

    g = second difference of exp(i phi),   e = y - sum Re(a g),   d = 2 e conj(g) / |g|^2
    a' = k d,   psi = sum w Im(conj(a) d) / sum w |a|^2   over the channels, w the inverse square of their noise
    phi' = omega + k1 psi,   omega' = alpha + k2 psi,   alpha' = k3 psi

All channels turn with one shaft, so the phase may be followed fast (4 Hz: a ramp of rpm leaves no error) and each
amplitude slowly (2 Hz). The gain on the wing's motion at f differs from one by about ``k / (2 pi f0) (f/f0)^2``: 1e-4
at 5 Hz, 3e-3 at 27 Hz for a line at 80 Hz.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from companion.native.library import ARRAY, INTEGER, REAL, RECORD, kernel, packed
from companion.records import Floats, Ints

Complexes = npt.NDArray[np.complex128]


class LineStates(NamedTuple):
    """Lines of one station: what the loop carries from sample to sample.

    Attributes
    ----------
    anchor_radps, omega_radps, alpha_radps2, phase_rad : (l,) float64
        Frequency as found in the spectrum and as followed, its rate, and phase at the newest sample.
    amplitude : (l, 6) complex128
        ``a`` of every channel, in its unit.
    error : (6,) float64
        Mean magnitude of ``e`` over the last half second; 0 at the start.
    weight : (6,) float64
        ``w``.
    """

    anchor_radps: Floats
    omega_radps: Floats
    alpha_radps2: Floats
    phase_rad: Floats
    amplitude: Complexes
    error: Floats
    weight: Floats


def line_states(frequency_hz: Floats, weight: Floats) -> LineStates:
    """States of lines that are yet to be followed from these frequencies on, (l,)."""
    omega_radps, count = 2.0 * np.pi * frequency_hz, len(frequency_hz)
    amplitude: Complexes = np.zeros((count, len(weight)), np.complex128)
    return LineStates(
        omega_radps, omega_radps.copy(), np.zeros(count), np.zeros(count), amplitude, np.zeros(len(weight)), weight
    )


def copied(states: LineStates) -> LineStates:
    """Copy whose changes leave the original alone."""
    columns: Any = (array.copy() for array in states)
    return LineStates(*columns)


def take_over(to: LineStates, at: list[int], before: LineStates, of: list[int]) -> None:
    """Copy the states of some lines into those of others, in place."""
    for new, old in zip(to[1:5], before[1:5], strict=True):  # frequency, its rate, phase and amplitude
        new[at] = old[of]
    to.error[:] = before.error


_pack_lines, _remove = packed(LineStates), kernel("lines_remove", ARRAY, ARRAY, INTEGER, REAL, RECORD, ARRAY)


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
    out = np.empty((len(t_ns) - first, values.shape[1]))
    _remove(t_ns, values, first, period_s, _pack_lines(states), out)
    return out
