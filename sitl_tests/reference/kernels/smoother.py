"""The smoother in plain numpy: ``native/filter.c``."""

from __future__ import annotations

import numpy as np

from companion.core.kernels.arrays import History
from companion.records import Floats


def backward_pass(history: History, first: int, count: int) -> tuple[Floats, Floats, Floats]:
    """Run the adjoint recursion back over ``count`` steps to ``first``.

    Parameters
    ----------
    history : History
        Of the filter.
    first : int
        Step.
    count : int
        How many.

    Returns
    -------
    adjoint, next_adjoint : (n, 1 + c) float64
        ``l`` at ``first`` and at the step after it.
    adjoint_information : (n, n) float64
        ``W`` at ``first``.
    """
    size, n, state_and_sensitivity = history.state.shape
    adjoint, adjoint_information = np.zeros((n, state_and_sensitivity)), np.zeros((n, n))
    next_adjoint = adjoint
    for back in range(1, count + 1):
        slot = (first + count - back) % size
        used = history.row_count[slot]
        H = history.whitened_H[slot, :used]
        H_t = np.ascontiguousarray(H.T)
        cross_cov_t = np.ascontiguousarray(history.whitened_cross_cov[slot, :used].T)
        closed_loop = history.transition[history.transition_index[slot]] - cross_cov_t @ H
        closed_loop_t = np.ascontiguousarray(closed_loop.T)
        next_adjoint = adjoint
        adjoint = closed_loop_t @ adjoint + H_t @ history.whitened_innovation[slot, :used]
        adjoint_information = closed_loop_t @ (adjoint_information @ closed_loop) + H_t @ H
    return adjoint, next_adjoint, adjoint_information
