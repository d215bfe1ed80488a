"""Samples in gaps, drawn as what the recording's own spectra make likely given all that was recorded.

A Gaussian stationary process of spectral matrix S has the precision P = S^-1 at every frequency. Missing samples m
given the others o are N(-P_mm^-1 P_mo x_o, P_mm^-1); with noise w of covariance P the solution of

    P_mm x_m = -P_mo x_o + w_m

is one draw of them, by conjugate gradients with S_mm as the preconditioner (every product is a transform). They are
drawn because an expectation has less power than the process. S is learnt from the filled recording and the gaps are
drawn again, a few times.
"""

from __future__ import annotations

import numpy as np

from companion.diagnosis.data.declipping import Smoother
from companion.diagnosis.spectral_matrices import above_floor, apply, cholesky, inverse
from companion.records import Bools, Complexes, Floats

_SEED = 20261123  # convention: any fixed number
_ITERATIONS = 80  # of conjugate gradients, a bound on their cost
_CLOSE = 1e-3  # residual over right-hand side, in the norm of the preconditioner, that ends it (numerical)
_FEWEST, _MOST = 3, 10  # chosen: least and most times that S is learnt; the share of missing samples decides
_LEFT = 0.01  # of the power missing at first that may be missing at last (choice)


def impute_missing(values: Floats, missing: Bools) -> Floats:
    """Draw what is missing.

    Parameters
    ----------
    values : (c, m)
        All channels on an even grid, the missing samples guessed.
    missing : (c, m)
        Which samples these are.

    Returns
    -------
    (c, m)
    """
    missing_ratio = float(np.max(np.mean(missing, axis=1)))
    if missing_ratio == 0.0:
        return values
    rng, smooth = np.random.default_rng(_SEED), Smoother(values.shape[1])
    mean = np.array([[float(row[~gone].mean())] for row, gone in zip(values, missing, strict=True)])
    drawn = values - mean
    rounds = (
        int(np.clip(np.ceil(np.log(_LEFT) / np.log(missing_ratio)), _FEWEST, _MOST)) if missing_ratio < 1.0 else _FEWEST
    )
    for _ in range(rounds):
        spectrum = np.fft.rfft(drawn, norm="ortho")
        model = smooth(spectrum[:, None] * spectrum.conj()[None])
        drawn = _draw(drawn, missing, above_floor(model), rng)
    return np.where(missing, drawn + mean, values)


def _draw(values: Floats, missing: Bools, spectra: Complexes, rng: np.random.Generator) -> Floats:
    precision = inverse(spectra)
    root = cholesky(precision)
    shape = (2, len(values), values.shape[1] // 2 + 1)
    white = np.array([1.0, 1j]) @ rng.standard_normal(shape).transpose(1, 0, 2) * np.sqrt(0.5)
    recorded = np.where(missing, 0.0, values)
    wanted = np.where(missing, _filtered(root, white, values.shape[1]) - _convolved(precision, recorded), 0.0)
    return recorded + _solved(precision, spectra, missing, wanted)


def _solved(precision: Complexes, spectra: Complexes, missing: Bools, wanted: Floats) -> Floats:
    """``P_mm^-1 wanted`` by preconditioned conjugate gradients; 0 where nothing is missing."""
    solution, left = np.zeros(wanted.shape), wanted
    ahead = np.where(missing, _convolved(spectra, left), 0.0)
    along, size = ahead, float(np.sum(left * ahead))
    first = size
    for _ in range(_ITERATIONS):
        if size <= _CLOSE**2 * first:
            break
        moved = np.where(missing, _convolved(precision, along), 0.0)
        step = size / float(np.sum(along * moved))
        solution, left = solution + step * along, left - step * moved
        ahead = np.where(missing, _convolved(spectra, left), 0.0)
        size, before = float(np.sum(left * ahead)), size
        along = ahead + (size / before) * along
    return solution


def _convolved(gain: Complexes, values: Floats) -> Floats:
    return _filtered(gain, np.asarray(np.fft.rfft(values, norm="ortho")), values.shape[1])


def _filtered(gain: Complexes, spectrum: Complexes, count: int) -> Floats:
    return np.asarray(np.fft.irfft(apply(gain, spectrum), count, norm="ortho"))
