"""A bent wing keeps its length, so its tip moves inboard.

The station at distance y moves by ``e = int (w')^2 / 2 dy``, for mode shapes phi_i of unit deflection there by
``sum_ij K_ij q_i q_j / 2`` with ``K_ij = int phi_i' phi_j' dy``. The shapes taken are those of a uniform cantilever of
length y: K_11 is 1.162 / y, where a straight line has 1 / y and any bend has more. A hinged rigid wing shows what e is
for: its sensor feels no tangential acceleration along the span, which tilt alone would give it.
"""

from __future__ import annotations

import functools

import numpy as np

from companion.core.wing.beam import BeamMode, characteristic_roots
from companion.records import Floats

_NODES = 96  # of Gauss and Legendre: exact to ten digits for the first six shapes (numerical)


def shortening_pm(ranks: tuple[int, ...], lever_m: float) -> Floats:
    """Matrix K (n, n), 1/m, of modes by their rank, 0 for the lowest, at ``lever_m`` from the root; there itself 0."""
    if not lever_m or not ranks:
        return np.zeros((len(ranks), len(ranks)))
    return np.asarray(_unit_shortening(max(ranks) + 1)[np.ix_(ranks, ranks)] / abs(lever_m))


@functools.lru_cache(maxsize=4)
def _unit_shortening(count: int) -> Floats:
    """Matrix K (count, count) of a uniform cantilever of unit length."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    modes = [BeamMode(root, 0.0, 1.0, 0.0, 0.0) for root in characteristic_roots(count, 0.0).tolist()]
    slopes = np.stack([mode.slope(0.5 * (node + 1.0)) for mode in modes])
    return np.asarray((0.5 * slopes * weight) @ slopes.T)
