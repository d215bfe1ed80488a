"""Coefficients without the bias by the response's noise, with sigmas that know where in time the noise acts.

Least squares draw coefficients to 0, because their columns hold the noise. With the likeliest deflection p of
:mod:`.smoothed_motion` as instrument, the equations

    sum over rows of Re(Z_j^* (u - sum_k X_k theta_k)) / var row = 0

hold in the mean: Z_j is the column of p, X_k that of the response y, of a law f_k(p) + f_k'(p) (y - p). Derivatives
are those of the frequency domain: differences would bias X. With var e and var n in their true ratio p is not
correlated with the rows' errors. Coefficients, ratio and p are computed in turns. The error of a row is
(D + s(t) + z(t) d/dt) e + n in time. Turned back into time, the equations have the weights a_j(t), and the covariance
is that of sum over t of a_j (D + s + z d/dt) e + a_j n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.forced.equation_rows import FINER, LAWS, EquationRows, integration, law_slopes
from companion.diagnosis.forced.force_delay import real_rows
from companion.diagnosis.forced.row_noise import beside_noise_of_force, dynamic_stiffness
from companion.diagnosis.forced.smoothed_motion import Observed, Smoothed, smoothed
from companion.records import Complexes, Floats

LINEAR = ("mass", "damping", "stiffness")
DELAY = "delay of the force"
_TURNS = 30  # chosen, at most: from a bias of three times ten turns settle
_FREE = 10  # chosen: turns after which the noise stays: two ratios, 0.6 sigma apart, took turns without end
_SETTLED = 0.02  # chosen: last change of every coefficient, sigmas
_LEAST_FORCE_NOISE = 1e-3  # chosen: rho of a force without noise, which keeps the normal matrix regular
_MOST_FORCE_NOISE = 0.5  # chosen, of the force: a false delay of 1.7 rows settled at 0.89 with a cubic 68 % too small
# chosen: samples of the smoothed motion a wave at the top of the band, where differences are 0.3 % off
_PER_WAVE = 12.0
_LITTLE = 0.05  # chosen: of a row's least variance, that a force without noise may add to the smoothed motion
_WARMER = 100.0  # chosen: variance of the force at which a turn begins, over that where the last one settled
_COMPLETE = 1.01 * FINER  # derived: the smoothed force has up to four times the samples; 1.01 for rounding
_TAPERED = 3.0 / 16.0  # derived: variance of a real part by that of a sample: half the mean square of a Hann taper


@dataclass(frozen=True, slots=True)
class ConsistentFit:
    """``values`` (p,) of mass, damping, stiffness, accepted laws and the delay, with their ``covariance`` (p, p)."""

    names: tuple[str, ...]
    values: Floats
    covariance: Floats

    def value(self, name: str) -> tuple[float, float]:
        """Value and sigma of one parameter."""
        place = self.names.index(name)
        return float(self.values[place]), float(np.sqrt(self.covariance[place, place]))


@dataclass(frozen=True, slots=True)
class _Noise:
    """Variance of a sample of response and force, and of each row, (2 n,)."""

    response: float
    force: float
    rows: Floats


@dataclass(frozen=True, slots=True)
class _Columns:
    """Columns (s, 2 n) of mass, damping, stiffness and laws: of the response, and of the likeliest motion.

    ``slopes`` are the laws' of each recording over deflection and speed of that motion, (2, laws, samples).
    """

    measured: Floats
    instrument: Floats
    slopes: tuple[Floats, ...]
    reached: Sequence[Smoothed] | None
    complete: bool


def consistent_fit(
    rows: EquationRows, delay_s: float | None, laws: Sequence[str], start: Floats
) -> ConsistentFit | None:
    """Coefficients of mass, damping, stiffness and ``laws``, begun at ``start`` (c,), None: they diverge.

    The force is advanced by ``delay_s``, of which the rest is a further parameter; None: it has no delay.
    """
    force = rows.force(delay_s or 0.0)
    late = np.zeros((0, len(force))) if delay_s is None else rows.force_per_delay(delay_s)[None]
    used = [*range(3), *(3 + i for i, name in enumerate(LAWS) if name in laws)]
    names = (*LINEAR, *(name for name in LAWS if name in laws), *([DELAY] if len(late) else []))
    theta, rest = start, np.zeros(len(late))
    columns = _Columns(real_rows(rows.table[1:]), np.zeros((0, 0)), rows.slopes_by_recording, None, False)
    try:
        for turn in range(_TURNS):
            if turn < _FREE:
                fitted = np.concatenate([theta, rest]) @ np.concatenate([columns.measured, late])
                noise = _noise(rows, force - fitted, theta, columns)
            columns = _columns(rows, delay_s or 0.0, theta, noise, columns.reached)
            x, z = (np.concatenate([each[used], late]) for each in (columns.measured, columns.instrument))
            inverse = np.linalg.inv((z / noise.rows) @ x.T)
            before, values = np.concatenate([theta[used], rest]), inverse @ ((z / noise.rows) @ force)
            covariance = inverse @ _score_covariance(rows, theta, noise, columns, z) @ inverse.T
            theta = np.zeros(len(start))
            theta[used], rest = values[: len(used)], values[len(used) :]
            if np.all(np.abs(values - before) < _SETTLED * np.sqrt(np.diag(covariance))):
                loud = noise.force > _MOST_FORCE_NOISE**2 * max(float(np.var(even.force)) for even in rows.grids)
                return ConsistentFit(names, values, covariance) if columns.complete and not loud else None
    except (np.linalg.LinAlgError, FloatingPointError, ValueError):
        return None
    return None


def _noise(rows: EquationRows, residual: Floats, theta: Floats, columns: _Columns) -> _Noise:
    """Likeliest noise by what the rows leave."""
    dynamic = np.tile(dynamic_stiffness(rows, theta, columns.slopes), 2)
    level = float(dynamic.mean())
    together, rho = beside_noise_of_force(dynamic / level, residual)
    row = float(np.mean((residual / together) ** 2))
    response = row / (level**2 * _TAPERED)
    return _Noise(response, max(rho, _LEAST_FORCE_NOISE) ** 2 * row / _TAPERED, row * together**2)


def _columns(
    rows: EquationRows, delay_s: float, theta: Floats, noise: _Noise, last: Sequence[Smoothed] | None
) -> _Columns:
    """Columns with the likeliest motion of every recording."""
    measured: list[Complexes] = []
    instrument: list[Complexes] = []
    slopes = []
    reached: list[Smoothed] = []
    for number in range(len(rows.recordings)):
        reached.append(_likeliest_motion(rows, number, delay_s, theta, noise, None if last is None else last[number]))
        of_motion, of_rest, law_slope = _series(rows, number, reached[-1].deflection)
        for segment in (each for each in rows.segments if each.recording == number):
            instrument.append(segment.rows(of_motion))
            measured.append(instrument[-1] + segment.rows(of_rest))
        slopes.append(law_slope)
    x, z = (real_rows(np.concatenate(each, axis=1)) for each in (measured, instrument))
    least = max(noise.force, _LITTLE * float(noise.rows.min()) / _TAPERED)
    complete = all(each.var_n <= _COMPLETE * least for each in reached)
    return _Columns(x, z, tuple(slopes), reached, complete)


def _likeliest_motion(
    rows: EquationRows, number: int, delay_s: float, theta: Floats, noise: _Noise, last: Smoothed | None
) -> Smoothed:
    """Likeliest motion of a recording at some times its rate, begun at that of the last turn."""
    entry, even = rows.recordings[number], rows.grids[number]
    integral, jw = integration(even, rows.band_hz, entry.kind)
    count, finer = len(even.force), int(np.clip(np.ceil(_PER_WAVE * rows.band_hz[1] / even.rate_hz), 1, FINER))
    force = _finer(np.fft.rfft(even.force) * np.exp(jw * delay_s), count, finer)
    at = np.flatnonzero(~even.lost)
    observed = Observed(force, 1.0 / (finer * even.rate_hz), even.response[at], finer * at, entry.kind)
    if last is None:
        start = Smoothed(_finer(integral * np.fft.rfft(even.response), count, finer), float(np.var(even.force)))
    else:
        start = Smoothed(last.deflection, _WARMER * last.var_n)
    return smoothed(observed, start, theta[:3], theta[3:], noise.response, finer * noise.force)


def _series(rows: EquationRows, number: int, p: Floats) -> tuple[list[Floats], list[Floats], Floats]:
    """Columns over time by a motion (finer n,) of a recording, and by what the response has beside it, (n,) each.

    Also the slopes of the laws over deflection and speed, (2, laws, n).
    """
    entry, even = rows.recordings[number], rows.grids[number]
    integral, jw = integration(even, rows.band_hz, entry.kind)
    count, finer = len(even.force), len(p) // len(even.force)
    fine, fine_jw = np.fft.rfft(p), 2j * np.pi * np.fft.rfftfreq(len(p), 1.0 / (finer * even.rate_hz))
    motion = [np.fft.irfft(fine * fine_jw**power, len(p)) for power in (0, 1, 2)]  # differences would bias X
    rest = integral * np.fft.rfft(np.where(even.lost, 0.0, even.response - motion[entry.kind][::finer]))
    by_q, by_v = law_slopes(p, motion[1])
    bends = np.stack([law(p, motion[1]) for _, law in LAWS.values()])
    straight = by_q * _finer(rest, count, finer) + by_v * _finer(jw * rest, count, finer)
    of_motion = [*_coarser(np.stack(motion[::-1]), count), *_coarser(bends, count)]
    of_rest = [*(np.fft.irfft(rest * jw**power, count) for power in (2, 1, 0)), *_coarser(straight, count)]
    return of_motion, of_rest, np.stack([by_q[:, ::finer], by_v[:, ::finer]])


def _finer(spectrum: Complexes, count: int, finer: int) -> Floats:
    return np.asarray(np.fft.irfft(spectrum, finer * count) * finer)


def _coarser(series: Floats, count: int) -> Floats:
    """Series (s, finer n) at the usual rate without what lies above half of it, (s, n)."""
    finer = series.shape[1] // count
    return np.asarray(np.fft.irfft(np.fft.rfft(series)[:, : count // 2 + 1], count) / finer)


def _score_covariance(
    rows: EquationRows, theta: Floats, noise: _Noise, columns: _Columns, instrument: Floats
) -> Floats:
    """Covariance (p, p) of the equations' left sides by the noise of response and force."""
    half = len(rows.omega)
    weights = (instrument[:, :half] + 1j * instrument[:, half:]) / noise.rows[:half]
    by_segment = list(zip(rows.segments, rows.by_segment(weights), strict=True))
    total = np.zeros((len(instrument), len(instrument)))
    m, c, k = theta[:3].tolist()
    for number, (entry, even) in enumerate(zip(rows.recordings, rows.grids, strict=True)):
        a = np.zeros((len(instrument), len(even.force)))
        for segment, in_bins in by_segment:
            if segment.recording == number:
                a[:, segment.first : segment.stop] += [segment.turned_back(each) for each in in_bins]
        stiff, damp = np.tensordot(theta[3:], columns.slopes[number], (0, 1))
        integral, jw = integration(even, rows.band_hz, entry.kind)
        straight = np.conj(m * jw**2 + c * jw + k) * np.fft.rfft(a)
        bent = np.fft.rfft(stiff * a) + np.conj(jw) * np.fft.rfft(damp * a)
        g = np.fft.irfft(np.conj(integral) * (straight + bent), len(even.force))
        total += noise.response * (g @ g.T) + noise.force * (a @ a.T)
    return total
