"""Relative noise of the rows of the equation of motion, by the noise of the response and of the force together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.diagnosis.forced.equation_rows import EquationRows, TaperedSegment
from companion.records import Floats

_PASSES = 4  # of least squares: the weight depends on the coefficients (choice)
_QUIETEST = 0.01  # of the noisiest recording's noise, that of any at least (choice)
_FORCE_NOISES = (0.0, *np.logspace(-2.0, 2.0, 41).tolist())  # rho tried: over the response's mean, by 1.26 (choice)


def row_noise(rows: EquationRows, force: Floats, columns: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Relative standard deviation of each row, (r,), and its variance over that of the response's bin.

    ``force`` (r,) and ``columns`` (s, r) are real rows, ``scale`` (s,) what the columns were divided by.
    An error of the response counts as one of the deflection. Recordings may be noisy to different degrees.
    """
    slopes, numbers = rows.slopes_by_recording, np.tile(rows.recording, 2)
    weight = variance = degree = np.ones(len(force))
    for _ in range(_PASSES):
        values = np.linalg.lstsq((columns / weight).T, force / weight, rcond=None)[0]
        dynamic = np.tile(dynamic_stiffness(rows, values / scale, slopes), 2)
        level, residual = float(dynamic.mean()), force - values @ columns
        together, _ = beside_noise_of_force(dynamic / level, residual / degree)
        power = np.bincount(numbers, (residual / together) ** 2) / np.maximum(np.bincount(numbers), 1)
        degree = np.sqrt(np.maximum(power / (power.max() or 1.0), _QUIETEST**2))[numbers]
        weight = degree * together
        weight, variance = weight / weight.mean(), (level * together) ** 2
    return weight, variance


def dynamic_stiffness(rows: EquationRows, values: Floats, slopes: Sequence[Floats]) -> Floats:
    """Error of each row over that of the response's bin, rms, (n,).

    ``values`` (3 + laws,) are mass, damping, stiffness and the laws' coefficients, ``slopes`` the laws' of each
    recording over deflection and speed, (2, laws, samples): those of a sweep are large in one segment alone.
    """
    each = zip(rows.segments, rows.by_segment(rows.omega), rows.by_segment(rows.kind), strict=True)
    return np.concatenate(
        [_of_segment(segment, omega, kind, values, slopes[segment.recording]) for segment, omega, kind in each]
    )


def _of_segment(segment: TaperedSegment, omega: Floats, kind: Floats, values: Floats, slopes: Floats) -> Floats:
    """Error of a segment's rows at ``omega`` (n,) over that of the response's bin, rms, (n,)."""
    m, c, k, *laws = values.tolist()
    both = np.tensordot(laws, slopes[..., segment.first : segment.stop], (0, 1))
    weight = np.hanning(segment.stop - segment.first) ** 2
    stiff, damp = np.average(both, axis=1, weights=weight)
    stiff_var, damp_var = np.average((both - [[stiff], [damp]]) ** 2, axis=1, weights=weight)
    mean = k + stiff - omega**2 * m + 1j * omega * (c + damp)
    return np.asarray(np.sqrt(np.abs(mean) ** 2 + stiff_var + omega**2 * damp_var) / omega**kind)


def beside_noise_of_force(weight: Floats, residual: Floats) -> tuple[Floats, float]:
    """The response's weight (n,) and the force's together, in the ratio that makes the residual (n,) likeliest."""
    together = [(weight**2 + ratio**2, ratio) for ratio in _FORCE_NOISES]
    squares = residual**2
    variance, ratio = max(together, key=lambda each: profile_log_likelihood(squares, each[0]))
    return np.sqrt(variance), ratio


def profile_log_likelihood(squares: Floats, variance: Floats) -> float:
    """Log likelihood of normal residuals' squares (n,) with relative variances (n,), at its best common factor."""
    return float(-0.5 * (len(squares) * np.log(np.mean(squares / variance)) + np.log(variance).sum()))
