"""Lines of motors and propellers, taken out of a station's samples before they are averaged over epochs.

An average over an epoch lets a line pass (84 % of one at 80 Hz in 4 ms) or folds it onto the wing's band. So the lines
of each shaft that :mod:`companion.core.tracking.line_search` has found are followed in the samples themselves, as
``Re(a_j exp(i m_j phi))`` in every channel, and subtracted. All of them turn with the phase ``12 phi`` of the shaft's
leader, the line that the search shows best: so a weak line is where the strong ones say. They are fitted to the
samples' second differences ``y``, in which the wing's slow and large motion is small, over a lag of a few samples, in
which the lines are large beside broadband noise (Widrow and Glover, Proc. IEEE 63, 1975, for ``a``; a phase-locked loop
of third order for rpm):

    g_j = second difference of exp(i m_j phi),   e = y - sum Re(a_j g_j),   d_j = 2 e conj(g_j) / |g_j|^2
    a_j' = k d_j,   psi = sum w n_j Im(conj(a) d) / sum w n_j^2 |a|^2   over all lines and channels, n_j = m_j / 12
    12 phi' = omega + k1 psi,   omega' = alpha + k2 psi,   alpha' = k3 psi

What is subtracted turns with a calmer phase, ``phi`` less the turns ``k1 psi`` of the last 20 ms: the wing's motion in
one channel moves psi at its beats with the line, and came out in all channels that have the line. Two steady lines of
3 and 1 m/s^2 so moved the slope by 0.6 to 1.7 mrad rms, in step with the vertical force, and the toe by up to 8 sigma.

w is ``|g|^2`` over the square of a channel's noise, or of its usual error e where gusts make that larger, times the
line's share of the channel, ``|a|^2 / (|a|^2 + e^2 / |g|^2)``: where the wing moves far more than the line, its second
mode would draw the phase to itself. By its leader alone, a tip that feels the blade pass more than the shaft lost
lock: what the turning phase left of that line turned it further. The phase may be
followed fast (4 Hz: a ramp of rpm leaves no error) and each amplitude slowly (2 Hz; below 45 Hz in proportion slower).
The gain on the wing's motion at f differs from one by about ``k / (2 pi f0) (f/f0)^2``: 1e-4 at 5 Hz, 3e-3 at 27 Hz for
a line at 80 Hz.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from companion.native.library import ARRAY, INTEGER, REAL, RECORD, kernel, packed
from companion.records import Complexes, Floats, Ints

_GOOD_GAIN = 0.4  # chosen, |g|: of 4 at most, with which noise far above the line enters
_MAX_LAG = 10  # chosen, samples: at 1 kHz five times as many are at hand

_RMS_OVER_MEAN = 1.2533  # derived, of a Gaussian's magnitude

LOCKED_RATIO = 1.0
"""Power of a followed leader over what its stream has besides, above which the loop is in lock. Chosen: 0.1 or 10."""


PARTS = 12
"""Parts of the leader's turn that other lines' orders are counted in: 6 is half the leader's order. Convention."""


class LineStates(NamedTuple):
    """Lines of one station: what the loop carries from sample to sample.

    Attributes
    ----------
    anchor_radps, omega_radps, alpha_radps2, phase_rad, ahead_rad : (s,) float64
        Each shaft's: a twelfth of its leader's frequency as found in the spectrum and as followed, its rate, the
        phase at the newest sample, and how far this is ahead of the calmer one that lines are subtracted with.
    led : (s,) int64
        Whether each shaft turns as another station's loop does (1), and is not turned by this one's samples.
    shaft, multiple : (l,) int64
        Each line's: index of its shaft, and its frequency in twelfths of the leader's.
    amplitude : (l, 6) complex128
        ``a`` of every channel, in its unit.
    error : (6,) float64
        Mean magnitude of ``e`` over the last half second; 0 at the start.
    weight : (6,) float64
        ``w``.
    lag : int
        Samples over which differences are taken.
    """

    anchor_radps: Floats
    omega_radps: Floats
    alpha_radps2: Floats
    phase_rad: Floats
    ahead_rad: Floats
    led: Ints
    shaft: Ints
    multiple: Ints
    amplitude: Complexes
    error: Floats
    weight: Floats
    lag: int


def line_states(leader_hz: Floats, multiples: Sequence[Sequence[int]], weight: Floats, rate_hz: float) -> LineStates:
    """States of lines that are yet to be followed in a stream of samples.

    Parameters
    ----------
    leader_hz : (s,) float64
        Each shaft's strongest line.
    multiples : s sequences of int
        Each shaft's lines in twelfths of its leader's frequency.
    weight : (6,) float64
        Inverse square of each channel's noise.
    rate_hz : float
        Of the samples.

    Returns
    -------
    LineStates
    """
    shaft = np.repeat(np.arange(len(multiples)), [len(lines) for lines in multiples]).astype(np.int64)
    multiple = np.array([multiple for lines in multiples for multiple in lines], dtype=np.int64)
    omega_radps, count = 2.0 * np.pi * leader_hz / PARTS, len(leader_hz)
    amplitude: Complexes = np.zeros((len(multiple), len(weight)), np.complex128)
    lag = difference_lag(leader_hz / rate_hz)
    (alpha, phase, ahead), error = np.zeros((3, count)), np.zeros(len(weight))
    led = np.zeros(count, np.int64)
    return LineStates(
        omega_radps, omega_radps.copy(), alpha, phase, ahead, led, shaft, multiple, amplitude, error, weight, lag
    )


def difference_lag(turns: Floats) -> int:
    """Smallest lag, in samples, whose second difference passes leaders well that turn so much in a sample, (s,).

    The smaller the lag the less it passes the wing's motion; rpm may change by a tenth.
    """
    if not len(turns):
        return 1
    lags = np.arange(1, _MAX_LAG + 1)
    gains = 2.0 - 2.0 * np.cos(2.0 * np.pi * lags[:, None, None] * turns * np.array([0.9, 1.0, 1.1])[:, None])
    least = gains.min(axis=(1, 2))
    good = np.flatnonzero(least >= min(_GOOD_GAIN, 0.9 * least.max()))
    return int(lags[good[0]])


def leaders(states: LineStates, rate_hz: float) -> list[tuple[float, float]]:
    """Leader of each shaft as it is followed: frequency (Hz), and its power over the errors' in second differences."""
    hz = states.omega_radps * (PARTS / (2.0 * np.pi))
    gain = 2.0 - 2.0 * np.cos(2.0 * np.pi * states.lag / rate_hz * hz)
    first = np.flatnonzero(states.multiple == PARTS)  # one of each shaft, in their order
    error = np.maximum(_RMS_OVER_MEAN * states.error, 1.0 / np.sqrt(states.weight))
    ratio = (np.abs(states.amplitude[first]) ** 2 / error**2).sum(axis=1) * 0.5 * gain**2
    return list(zip(hz.tolist(), ratio.tolist(), strict=True))


def copied(states: LineStates) -> LineStates:
    """Copy whose changes leave the original alone."""
    columns: Any = (each.copy() if isinstance(each, np.ndarray) else each for each in states)
    return LineStates(*columns)


def take_over(to: LineStates, before: LineStates, shafts: dict[int, int]) -> None:
    """Copy the states of some shafts into those of others, in place; ``shafts`` is index by former index."""
    lines = {(shafts.get(i, -1), m): j for j, (i, m) in enumerate(_lines(before))}
    for former, now in shafts.items():
        for new, old in zip(to[1:5], before[1:5], strict=True):  # frequency, its rate and phases
            new[now] = old[former]
    for j, line in enumerate(_lines(to)):
        if line in lines:
            to.amplitude[j] = before.amplitude[lines[line]]
    to.error[:] = before.error


def _lines(states: LineStates) -> list[tuple[int, int]]:
    """Shaft and multiple of each line."""
    return list(zip(states.shaft.tolist(), states.multiple.tolist(), strict=True))


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
