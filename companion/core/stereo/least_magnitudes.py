"""Linear fits by least sum of magnitudes, which wrong matches do not pull."""

from __future__ import annotations

import numpy as np

from companion.records import Floats


def least_magnitudes(design: Floats, observed: Floats, least: float, steps: int) -> Floats:
    """Coefficients (k, d) whose residuals have the least sum of magnitudes, by reweighted least squares.

    Parameters
    ----------
    design : (n, k) float64
        Contribution of each coefficient to each row.
    observed : (n, d) float64
        Vectors to fit; the magnitude of a residual is its length.
    least : float
        Residual below which all rows have equal weight, in the unit of ``observed``.
    steps : int
        Number of reweightings.
    """
    weight: Floats = np.ones(len(observed))
    fitted: Floats = np.zeros((design.shape[1], observed.shape[1]))
    for _ in range(steps):
        weighted = design * weight[:, np.newaxis]
        fitted = np.asarray(np.linalg.lstsq(weighted.T @ design, weighted.T @ observed, rcond=None)[0], np.float64)
        residual = np.linalg.norm(observed - design @ fitted, axis=1)
        weight = np.asarray(1.0 / np.maximum(residual, least), dtype=np.float64)
    return fitted
