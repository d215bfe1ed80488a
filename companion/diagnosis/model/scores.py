"""Scores and Fisher information of one recording: a complex Gaussian whose mean and covariance both depend on the
parameters (accelerations), and a real one (toe, rest).

Everything is whitened once: with S^-1 = L L^H a change dS of the covariance becomes L^H dS L, a change of the mean
L^H dr, both written as real vectors whose dot products are the traces that are wanted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import cho_solve

from companion.diagnosis.model.expectation import Expectation
from companion.diagnosis.spectral_matrices import adjoint, product
from companion.records import Complexes, Floats

_ROOT2 = float(np.sqrt(2.0))


class ScoredRecording(Protocol):
    """A recording in its band: ``weight`` is the share of bins that are independent, ``band_hz`` (b,)."""

    weight: float
    band_hz: Floats

    def certain_shifted(self, expectation: Expectation, shift_s: Floats) -> Complexes | None:
        """Change of the channels' deterministic part by shifts in time (c, m), in the band, (c, b)."""


@dataclass(frozen=True, slots=True)
class Column:
    """Derivative of an expectation with respect to one parameter; None where it is nothing."""

    power: Floats | None = None
    """Derivative of the accelerations' covariance, whitened and packed."""
    mean: Floats | None = None
    """Derivative of their residual, whitened and packed."""
    toe: Floats | None = None
    toe_variance: Floats | None = None
    rest: Floats | None = None
    shift_s: Floats | None = None
    """Shift in time of the channels by a unit of the parameter, (c, m), s."""
    warps: bool = False
    """Whether the shift is undone in the samples, and does not change their spectrum."""


def column(
    expectation: Expectation,
    perturbed: Expectation,
    step: float,
    noisy: bool,
    shift_s: Floats | None,
    warps: bool,
    judged: bool = True,
) -> Column:
    """Difference of two expectations ``step`` apart; ``shift_s`` (c, m) is what moves the channels' time.

    ``noisy`` is for what changes the toe's noise; accelerations that are not ``judged`` have none.
    """
    power = mean = toe = noise = rest = None
    if judged and perturbed.motion is not expectation.motion:
        white = expectation.motion.whitener
        if perturbed.spectrum is not expectation.spectrum:
            change = perturbed.spectrum - expectation.spectrum
            power = packed(product(product(adjoint(white), change), white)) / step
        if perturbed.residual is not expectation.residual:
            mean = _whitened(expectation, (perturbed.residual - expectation.residual) / step)
    if len(expectation.toe_residual_rad):
        toe = (perturbed.toe_residual_rad - expectation.toe_residual_rad) / step
        noise = (perturbed.toe_errors.variance - expectation.toe_errors.variance) / step if noisy else None
    rest = (perturbed.rest_residual - expectation.rest_residual) / step
    return Column(power, mean, toe, noise, rest, shift_s, warps)


def scores(model: ScoredRecording, expectation: Expectation, columns: Sequence[Column]) -> tuple[Floats, Floats]:
    """Gradient of the log likelihood and its Fisher information, (p,) and (p, p)."""
    p, weight = len(columns), model.weight
    gradient, information = np.zeros(p), np.zeros((p, p))
    white = expectation.white_residual
    outer = packed(white[:, None] * white.conj()[None])
    chance = packed(np.broadcast_to(np.eye(len(white))[..., None], (*[len(white)] * 2, white.shape[1])))
    _add(columns, lambda entry: entry.power, weight * (outer - chance), weight, gradient, information)
    straight = np.concatenate([white.real.ravel(), white.imag.ravel()])
    _add(columns, lambda entry: entry.mean, -2.0 * weight * straight, 2.0 * weight, gradient, information)
    _add_warps(model, expectation, columns, information)
    _add_toe(expectation, columns, gradient, information)
    rest = 1.0 / np.sqrt(expectation.rest_variance)
    _add(
        columns,
        lambda entry: None if entry.rest is None else entry.rest * rest,
        -expectation.rest_residual * rest,
        1.0,
        gradient,
        information,
    )
    return gradient, information


def _add(
    columns: Sequence[Column],
    of: Callable[[Column], Floats | None],
    against: Floats,
    weight: float,
    gradient: Floats,
    information: Floats,
) -> None:
    """Add the share of one kind of derivative: its product with the data, and with itself."""
    vectors = [(i, vector) for i, entry in enumerate(columns) if (vector := of(entry)) is not None]
    if not vectors:
        return
    index = np.array([i for i, _ in vectors])
    table = np.stack([vector for _, vector in vectors])
    gradient[index] += table @ against
    information[np.ix_(index, index)] += weight * (table @ table.T)


def _add_warps(
    model: ScoredRecording, expectation: Expectation, columns: Sequence[Column], information: Floats
) -> None:
    """Replace the information of shifts in time, where products of their columns are wrong, by its expected value.

    With S the spectral matrix, shifts of channels c and d by a and b are worth
    2 weight omega^2 (S^-1_cd S_dc - [c = d]) times the mean of a b: only motion that both sides share shows a shift. A
    warp of the samples changes the mean, a constant delay the spectrum; their columns have no product, though a warp's
    constant part is a delay. Products of the deterministic motion (the rigid aircraft, forced motion) stay: three
    impulses inform about a clock more than a minute of gust.
    """
    shifts = [(i, entry.shift_s, entry.warps) for i, entry in enumerate(columns) if entry.shift_s is not None]
    if not any(warps for _, _, warps in shifts):
        return
    agreed = 2.0 * model.weight * np.sum((2.0 * np.pi * model.band_hz) ** 2 * _agreement(expectation), axis=2)
    certain = {i: _whitened(expectation, model.certain_shifted(expectation, shift)) for i, shift, _ in shifts}
    for i, first, warps_i in shifts:
        for j, second, warps_j in shifts:
            if warps_i or warps_j:
                expected = float(np.sum(agreed * (first @ second.T))) / first.shape[1]
                by_chance = _product(columns[i].mean, columns[j].mean) - _product(certain[i], certain[j])
                information[i, j] += expected - 2.0 * model.weight * by_chance


def _agreement(expectation: Expectation) -> Floats:
    agreement = (expectation.inverse * expectation.spectrum.swapaxes(0, 1)).real
    diagonal = np.arange(len(agreement))
    agreement[diagonal, diagonal] -= 1.0
    return agreement


def _whitened(expectation: Expectation, values: Complexes | None) -> Floats | None:
    if values is None:
        return None
    white = expectation.whitened(values)
    return np.concatenate([white.real.ravel(), white.imag.ravel()])


def _product(first: Floats | None, second: Floats | None) -> float:
    return 0.0 if first is None or second is None else float(first @ second)


def _add_toe(expectation: Expectation, columns: Sequence[Column], gradient: Floats, information: Floats) -> None:
    index = np.array([i for i, entry in enumerate(columns) if entry.toe is not None], dtype=np.int64)
    if not len(expectation.toe_residual_rad) or not len(index):
        return
    factor = expectation.toe_errors.factor, True
    toe = np.stack([entry.toe for entry in columns if entry.toe is not None], 1)
    weighed = cho_solve(factor, toe, check_finite=False)
    gradient[index] -= weighed.T @ expectation.toe_residual_rad
    information[np.ix_(index, index)] += toe.T @ weighed
    random = [(i, entry.toe_variance) for i, entry in enumerate(columns) if entry.toe_variance is not None]
    if not random:
        return
    white = cho_solve(factor, expectation.toe_residual_rad, check_finite=False)
    precision = expectation.toe_errors.precision
    places, changed = [i for i, _ in random], np.stack([variance for _, variance in random])
    gradient[places] += 0.5 * changed @ (white**2 - np.diag(precision))
    information[np.ix_(places, places)] += 0.5 * changed @ precision**2 @ changed.T


def packed(hermitian: Complexes) -> Floats:
    """Hermitian matrices (c, c, b) as one real vector (c^2 b,); dot products are traces of products."""
    n = len(hermitian)
    entries = [hermitian[i, i].real for i in range(n)]
    for i in range(n):
        for j in range(i):
            entries += [_ROOT2 * hermitian[i, j].real, _ROOT2 * hermitian[i, j].imag]
    return np.concatenate(entries)
