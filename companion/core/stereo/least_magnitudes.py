"""Straight-line fits that wrong matches do not pull: least sum of magnitudes."""

from __future__ import annotations

import numpy as np

from companion.records import Floats


def least_magnitudes(design: Floats, observed: Floats, least: float, steps: int) -> Floats:
    """Coefficients (k, d) whose residuals have the least sum of magnitudes, by reweighted least squares.

    Parameters
    ----------
    design : (n, k) float64
        What each coefficient contributes to each row.
    observed : (n, d) float64
        Vectors to be explained; a residual's magnitude is its length.
    least : float
        Residual below which all rows weigh alike, in the unit of ``observed``.
    steps : int
        Reweightings.
    """
    weight: Floats = np.ones(len(observed))
    fitted: Floats = np.zeros((design.shape[1], observed.shape[1]))
    for _ in range(steps):
        weighted = design * weight[:, np.newaxis]
        fitted = np.asarray(np.linalg.lstsq(weighted.T @ design, weighted.T @ observed, rcond=None)[0], np.float64)
        residual = np.linalg.norm(observed - design @ fitted, axis=1)
        weight = np.asarray(1.0 / np.maximum(residual, least), dtype=np.float64)
    return fitted
