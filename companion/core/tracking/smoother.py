"""Fixed-lag smoothing from the filter's history: the modified Bryson-Frazier recursion.

With ``L = A - K G``: ``l_k = G^T S^-1 e_k + L^T l_{k+1}`` and ``W_k = G^T S^-1 G + L^T W_{k+1} L`` run backwards from
the newest step (where both are zero); then ``x_k + P_k l_k`` has covariance ``P_k - P_k W_k P_k`` (Bierman,
Automatica 9, 1973). The history holds ``G``, ``e`` and ``C^T`` whitened by ``S``. All sensitivity columns go along, so
the constants found later than ``k`` correct ``k`` too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.kernels.arrays import History
from companion.core.kernels.compiled import compiled
from companion.core.tracking.filter import Kalman
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class Smoothed:
    """The state at the start of one step.

    Attributes
    ----------
    state : (n,) float64
    covariance : (n, n) float64
        Given the constants.
    by_constants : (n, c) float64
        Sensitivity of ``state`` to the constants.
    """

    state: Floats
    covariance: Floats
    by_constants: Floats


def smooth_between(kalman: Kalman, step: int, share: float) -> Smoothed:
    """Smooth at ``share`` (0 to 1) of the way through ``step``, with everything up to the newest step.

    Between two instants the mean path of a mode under white load, both ends known, is the cubic through both
    deflections and rates; what the load may do in between is added to the covariance.

    ``step`` lies in ``[kalman.steps - history, kalman.steps - 1]``.
    """
    n, h = kalman.layout.size, kalman.history
    count = kalman.steps - step
    push, later, weight = adjoint(h, step, count)
    at = step % kalman.kept
    covariance = h.covariance[at]
    here = h.state[at] + covariance @ push
    if count > 1:
        after = (step + 1) % kalman.kept
        there = h.state[after] + h.covariance[after] @ later
    else:
        there = kalman.columns[:n]
    spread = covariance - covariance @ weight @ covariance
    return _between(kalman, at, share, here, there, spread)


def _between(kalman: Kalman, at: int, s: float, here: Floats, there: Floats, spread: Floats) -> Smoothed:
    n, h = len(here), kalman.model.step_s
    first, second = (1.0 - s) * np.eye(n), s * np.eye(n)
    added = np.zeros((n, n))
    bump = s * (1.0 - s)
    for q, v in kalman.layout.pairs:
        first[q, [q, v]] = 1.0 - s * s * (3.0 - 2.0 * s), h * bump * (1.0 - s)
        second[q, [q, v]] = s * s * (3.0 - 2.0 * s), -h * bump * s
        first[v, [q, v]] = -6.0 * bump / h, (1.0 - s) * (1.0 - 3.0 * s)
        second[v, [q, v]] = 6.0 * bump / h, s * (3.0 * s - 2.0)
        load = kalman.model.noise[v, v]
        added[q, q] = load * h * h * bump**3 / 3.0
        added[v, v] = load * bump * (1.0 - 3.0 * bump)
    columns = first @ here + second @ there
    whole = first + second @ kalman.history.transition[kalman.history.by[at]]
    state = columns[:, 0] + columns[:, 1:] @ kalman.constants
    return Smoothed(state, whole @ spread @ whole.T + added, columns[:, 1:])


@compiled
def adjoint(history: History, first: int, count: int) -> tuple[Floats, Floats, Floats]:
    """Run the recursion back over ``count`` steps to ``first``.

    Returns
    -------
    push, later : (n, 1 + c) float64
        ``l`` at ``first`` and at the step after it.
    weight : (n, n) float64
        ``W`` at ``first``.
    """
    size, n, columns = history.state.shape
    push, weight = np.zeros((n, columns)), np.zeros((n, n))
    later = push
    for back in range(1, count + 1):
        at = (first + count - back) % size
        used = history.used[at]
        g = history.seen[at, :used]
        g_t = np.ascontiguousarray(g.T)
        drawn_t = np.ascontiguousarray(history.drawn[at, :used].T)
        closed = history.transition[history.by[at]] - drawn_t @ g
        closed_t = np.ascontiguousarray(closed.T)
        later = push
        push = closed_t @ push + g_t @ history.innovation[at, :used]
        weight = closed_t @ (weight @ closed) + g_t @ g
    return push, later, weight
