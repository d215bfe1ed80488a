"""Foreshortening: a bent wing keeps its length, so its tip moves inboard.

The station at distance y moves by ``e = int (w')^2 / 2 dy``, for mode shapes phi_i of unit deflection there by
``sum_ij kappa_ij q_i q_j / 2`` with ``kappa_ij = int phi_i' phi_j' dy``. The shapes taken are those of a uniform
cantilever of length y: kappa_11 is 1.162 / y, where a straight line has 1 / y and any bend has more. A hinged rigid
wing shows what e is for: its sensor feels no tangential acceleration along the span, which tilt alone would give it.

A tip that carries mass moves less in the further modes, so that for the same lift these bend the more: with a tenth of
the wing's mass kappa_12 is 16 % larger. Their slope factors s tell: a further shape is taken as ``a phi_k + (1 - a)
phi_1`` of the uniform cantilever, which has the slope s at the tip. kappa_12 is then right to 2 % up to a fifth of the
wing's mass.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from companion.core.wing.beam import BeamMode, characteristic_roots
from companion.records import Floats

_NODES = 96  # of Gauss and Legendre: exact to ten digits for the first six shapes (numerical)


def foreshortening_pm(
    ranks: tuple[int, ...], lever_m: float, slope_factors_radpm: Sequence[float] | Floats = ()
) -> Floats:
    """Foreshortening of a bent wing at its tip.

    Parameters
    ----------
    ranks : tuple of int
        Of the n modes, 0 for the lowest.
    lever_m : float
        Place of the tip from the root.
    slope_factors_radpm : n floats, optional
        Of the modes; a uniform cantilever's where they are left out. Those of the lowest modes do not count.

    Returns
    -------
    (n, n) float64
        kappa in 1/m; zeros at the root itself.
    """
    if not lever_m or not ranks:
        return np.zeros((len(ranks), len(ranks)))
    foreshortening, slopes = _unit_cantilever(max(ranks) + 1)
    shapes = np.eye(len(slopes))[list(ranks)]
    for shape, rank, slope_factor in zip(shapes, ranks, slope_factors_radpm, strict=False):
        if rank:
            of_itself = (abs(lever_m) * slope_factor - slopes[0]) / (slopes[rank] - slopes[0])
            shape[0], shape[rank] = 1.0 - of_itself, of_itself
    return np.asarray(shapes @ foreshortening @ shapes.T / abs(lever_m))


@functools.lru_cache(maxsize=4)
def _unit_cantilever(count: int) -> tuple[Floats, Floats]:
    """Matrix K (count, count) of a uniform cantilever of unit length, and its slopes at the tip (count,)."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    modes = [BeamMode(root, 0.0, 1.0, 0.0, 0.0) for root in characteristic_roots(count, 0.0).tolist()]
    slopes = np.stack([mode.slope(0.5 * (node + 1.0)) for mode in modes])
    at_tip = np.array([float(mode.slope(np.array([1.0]))[0]) for mode in modes])
    return np.asarray((0.5 * slopes * weight) @ slopes.T), at_tip
