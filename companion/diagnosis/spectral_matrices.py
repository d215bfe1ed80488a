"""Small matrices, one for every frequency, as arrays (rows, columns, f): frequency last, so that numpy runs along it.

A diagonal matrix may be given as (n, f).
"""

from __future__ import annotations

import numpy as np

from companion.records import Complexes, Floats

_FAINTEST = 1e-9  # of the mean power: floor of a spectrum, where channels without noise are equal (numerical)


def product(a: Complexes, b: Complexes) -> Complexes:
    """Matrix product (i, k, f) of (i, j, f) and (j, k, f) at every frequency."""
    if a.ndim == 2 and b.ndim == 2:
        return np.asarray(a * b)
    if a.ndim == 2:
        return np.asarray(a[:, None] * b)
    if b.ndim == 2:
        return np.asarray(a * b[None])
    result = np.empty((a.shape[0], b.shape[1], max(a.shape[2], b.shape[2])), dtype=np.complex128)
    for i, k in np.ndindex(a.shape[0], b.shape[1]):
        total = a[i, 0] * b[0, k]
        for j in range(1, a.shape[1]):
            total += a[i, j] * b[j, k]
        result[i, k] = total
    return result


def apply(a: Complexes, vector: Complexes) -> Complexes:
    """Matrix times vector (n, f) at every frequency."""
    if a.ndim == 2:
        return np.asarray(a * vector)
    return np.asarray(np.sum(a * vector[None], axis=1))


def above_floor(spectra: Complexes) -> Complexes:
    """Spectral matrices (c, c, f) with so much white noise that each has an inverse."""
    floor = _FAINTEST * float(np.mean(np.einsum("iif->if", spectra).real))
    return np.asarray(spectra + floor * np.eye(len(spectra))[..., None])


def adjoint(a: Complexes) -> Complexes:
    """Conjugate transpose (j, i, f) of (i, j, f)."""
    return np.asarray(a.conj() if a.ndim == 2 else a.conj().swapaxes(0, 1))


def full(a: Complexes) -> Complexes:
    """A diagonal matrix (n, f) written out, (n, n, f)."""
    if a.ndim == 3:
        return a
    result = np.zeros((len(a), *a.shape), dtype=np.complex128)
    result[np.diag_indices(len(a))] = a
    return result


def inverse(a: Complexes) -> Complexes:
    """Inverses (n, n, f), by elimination without pivots: stable for damped oscillators and covariances."""
    if a.ndim == 2:
        return np.asarray(1.0 / a)
    n = len(a)
    if n == 1:
        return np.asarray(1.0 / a)
    if n == 2:
        reciprocal = 1.0 / (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
        return np.stack([[a[1, 1] * reciprocal, -a[0, 1] * reciprocal], [-a[1, 0] * reciprocal, a[0, 0] * reciprocal]])
    work, result = a.copy(), full(np.ones(a.shape[1:], dtype=np.complex128))
    for k in range(n):
        reciprocal = 1.0 / work[k, k]
        work[k], result[k] = work[k] * reciprocal, result[k] * reciprocal
        for i in range(n):
            if i != k:
                times = work[i, k].copy()
                work[i] -= times * work[k]
                result[i] -= times * result[k]
    return result


def cholesky(a: Complexes) -> Complexes:
    """Lower triangular L with L L^H = a, for Hermitian positive ``a`` (n, n, f)."""
    factor = np.zeros_like(a)
    for j in range(len(a)):
        pivot = a[j, j].real - np.sum(np.abs(factor[j, :j]) ** 2, axis=0)
        factor[j, j] = np.sqrt(pivot)
        for i in range(j + 1, len(a)):
            shared = np.sum(factor[i, :j] * factor[j, :j].conj(), axis=0)
            factor[i, j] = (a[i, j] - shared) / factor[j, j]
    return factor


def log_determinant(a: Complexes) -> Floats:
    """Logarithm of the determinant of Hermitian positive matrices, (f,)."""
    if a.ndim == 2:
        return np.asarray(np.sum(np.log(a.real), axis=0))
    if len(a) == 1:
        return np.asarray(np.log(a[0, 0].real))
    if len(a) == 2:
        return np.asarray(np.log(a[0, 0].real * a[1, 1].real - np.abs(a[0, 1]) ** 2))
    return np.asarray(np.linalg.slogdet(np.moveaxis(a, -1, 0))[1])


def quadratic_form(a: Complexes, vector: Complexes) -> float:
    """Sum over frequencies of vector^H a vector, for Hermitian ``a`` (n, n, f) and ``vector`` (n, f)."""
    return float(np.sum((vector.conj() * apply(a, vector)).real))
