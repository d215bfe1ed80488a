"""Samples that a range has cut, restored as what the recording's own spectra make likely beyond it.

Of a cut sample only its side of the limit is known. A spline through its neighbours, which noise has pushed to just
below the limit, is too low: it looks like a nonlinear sensor. Cut samples are therefore drawn from their posterior
(Gibbs): they lie beyond the limit, and are Gaussian like the rest, with the spectral matrix of all channels. They are
drawn because an expectation has less power than the process. The spectra are learnt in the same sweeps (stochastic
approximation of EM: Delyon, Lavielle and Moulines, Ann. Statist. 27 (1999) 94).
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from companion.diagnosis.spectral_matrices import above_floor, adjoint, apply, cholesky, inverse
from companion.records import Complexes, Floats

_SEED = 20250103  # convention: any fixed number
_SWEEPS = 160  # of the Gibbs sampler, a bound on its cost
_RELEARNT, _LEARNT = 4, 0.3  # chosen: sweeps between updates of the spectra, and share of the new estimate in each
_SETTLED = 60  # sweeps; from then on the spectra are averaged (choice)
_WHITE_RATIO, _MOST = 0.8, 0.95  # of the lowest band: white part, which is drawn sample by sample (choice)
_BAND = 40  # chosen: bins that share one bound on the white part
_WIDTH = 0.02  # of a frequency: half-width of the smoothing of spectra (choice)
_FEWEST = 12  # chosen: bins to either side at least: a spectrum is then known to a fifth


def impute_clipped(values: Floats, beyond: Floats, interpolated: Floats) -> Floats:
    """Draw what has been cut.

    Parameters
    ----------
    values : (c, m)
        All channels on an even grid, the cut samples at their limits.
    beyond : (c, m)
        1 where the truth is at least what was recorded, -1 where it is at most that, 0 where it is recorded.
    interpolated : (c, m)
        The same channels with the cut samples guessed: there the sweeps begin.

    Returns
    -------
    (c, m)
        The same with the cut samples beyond their limits.
    """
    rng = np.random.default_rng(_SEED)
    drawn = interpolated.copy()
    count, affected = values.shape[1], np.flatnonzero(np.any(beyond != 0.0, axis=1)).tolist()
    smooth, model = Smoother(count), None
    for sweep in range(_SWEEPS):
        mean = drawn.mean(1, keepdims=True)
        spectrum = np.fft.rfft(drawn - mean, norm="ortho")
        if sweep % _RELEARNT == 0:
            new = smooth(spectrum[:, None] * spectrum.conj()[None])
            step = min(_LEARNT, _RELEARNT / max(sweep - _SETTLED, _RELEARNT))
            model = _Split(new if model is None else model.spectra + step * (new - model.spectra), affected)
        assert model is not None
        for i, wave in zip(affected, model.draw(spectrum, rng), strict=True):
            cut = beyond[i] != 0.0
            middle = np.fft.irfft(wave, count, norm="ortho")[cut] + mean[i]
            drawn[i, cut] = _beyond(values[i, cut], beyond[i, cut], middle, np.sqrt(model.white), rng)
    return drawn


class _Split:
    """Conditional spectrum of the clipped channels given the others, as a white part and the rest.

    A larger white part needs fewer sweeps, but it may not exceed the spectrum anywhere. The bound is taken by bands. A
    spectrum that chance makes lower than the white part is raised.
    """

    def __init__(self, spectra: Complexes, affected: list[int]) -> None:
        self.spectra = spectra
        precision = inverse(above_floor(spectra))[affected]
        largest = np.linalg.eigvalsh(np.moveaxis(precision[:, affected], -1, 0))[:, -1]
        bands = np.array_split(largest, max(len(largest) // _BAND, 1))
        self.white = _WHITE_RATIO / max(float(np.mean(band)) for band in bands)
        precision = precision * np.minimum(1.0, _MOST / (self.white * largest))
        self._affected, self._gain = affected, self.white * precision
        remaining = np.eye(len(affected))[..., None] - self._gain[:, affected]
        self._spread = cholesky(self.white * 0.5 * (remaining + adjoint(remaining)))

    def draw(self, spectrum: Complexes, rng: np.random.Generator) -> Complexes:
        """The rest from its posterior, given the spectrum of all channels, (a, f)."""
        noise = rng.standard_normal((2, len(self._affected), spectrum.shape[1]))
        white = np.sqrt(0.5) * (noise[0] + 1j * noise[1])
        return np.asarray(spectrum[self._affected] - apply(self._gain, spectrum) + apply(self._spread, white))


def _beyond(limit: Floats, side: Floats, middle: Floats, spread: float, rng: np.random.Generator) -> Floats:
    """Normal samples about ``middle`` beyond ``limit``, by the inverse of their distribution's tail."""
    nearest = side * (limit - middle) / spread
    tail = log_ndtr(-nearest) + np.log(rng.uniform(size=len(nearest)))
    return np.asarray(middle - side * spread * ndtri_exp(tail))


class Smoother:
    """Means over neighbouring frequencies, more of them the higher they are."""

    def __init__(self, count: int) -> None:
        index = np.arange(count // 2 + 1)
        width = np.maximum((_WIDTH * index).astype(np.int64), _FEWEST)
        self._low = np.maximum(index - width, 1)
        self._high = np.minimum(np.maximum(index + width, 2 * _FEWEST), len(index) - 1)

    def __call__(self, products: Complexes) -> Complexes:
        """Mean of each entry along the last axis; frequency 0 has been taken out, and is left out."""
        total = np.cumsum(products, axis=-1)
        return np.asarray((total[..., self._high] - total[..., self._low - 1]) / (self._high - self._low + 1))
