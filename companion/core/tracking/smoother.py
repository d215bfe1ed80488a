"""Fixed-lag smoothing from the filter's history: the modified Bryson-Frazier recursion.

With ``F = A - K H``: ``l_k = H^T S^-1 e_k + F^T l_{k+1}`` and ``W_k = H^T S^-1 H + F^T W_{k+1} F`` run backwards from
the newest step, where both are zero; then ``x_k + P_k l_k`` has covariance ``P_k - P_k W_k P_k`` (Bierman, Automatica
9, 1973). The history holds ``H``, ``e`` and ``C^T`` whitened by ``S``. All sensitivity columns are smoothed alike, so
that bias parameters estimated after step k correct step k too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.kernels.arrays import History
from companion.core.kernels.filter_loops import pack_history
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.native.library import ARRAY, INTEGER, RECORD, kernel
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class SmoothedState:
    """State at an instant of the past.

    Attributes
    ----------
    state : (n,) float64
    covariance : (n, n) float64
        Given the bias parameters.
    bias_sensitivity : (n, c) float64
        Derivative of ``state`` by the bias parameters.
    """

    state: Floats
    covariance: Floats
    bias_sensitivity: Floats


def smooth_between(kalman: SeparatedBiasFilter, step: int, fraction: float) -> SmoothedState:
    """Smooth at a fraction of the way through a step, with everything up to the newest step.

    Between two instants the mean path of a mode under white load, both ends known, is the cubic through both
    deflections and rates; the variance of the load's path in between is added to the covariance.

    Parameters
    ----------
    kalman : SeparatedBiasFilter
        Filter with its history.
    step : int
        In ``[kalman.steps - history, kalman.steps - 1]``.
    fraction : float
        0 to 1.

    Returns
    -------
    SmoothedState
    """
    n, h = kalman.layout.size, kalman.history
    count = kalman.steps - step
    adjoint, next_adjoint, adjoint_information = backward_pass(h, step, count)
    slot = step % kalman.history_length
    covariance = h.covariance[slot]
    at_start = h.state[slot] + covariance @ adjoint
    if count > 1:
        after = (step + 1) % kalman.history_length
        at_end = h.state[after] + h.covariance[after] @ next_adjoint
    else:
        at_end = kalman.state_and_sensitivity[:n]
    smoothed_covariance = covariance - covariance @ adjoint_information @ covariance
    return _between(kalman, slot, fraction, at_start, at_end, smoothed_covariance)


def _between(
    kalman: SeparatedBiasFilter, slot: int, s: float, at_start: Floats, at_end: Floats, smoothed_covariance: Floats
) -> SmoothedState:
    """State between two smoothed instants."""
    n, h = len(at_start), kalman.model.step_s
    first, second = (1.0 - s) * np.eye(n), s * np.eye(n)
    path_covariance = np.zeros((n, n))
    bridge = s * (1.0 - s)
    for q, v in kalman.layout.pairs:
        first[q, [q, v]] = 1.0 - s * s * (3.0 - 2.0 * s), h * bridge * (1.0 - s)
        second[q, [q, v]] = s * s * (3.0 - 2.0 * s), -h * bridge * s
        first[v, [q, v]] = -6.0 * bridge / h, (1.0 - s) * (1.0 - 3.0 * s)
        second[v, [q, v]] = 6.0 * bridge / h, s * (3.0 * s - 2.0)
        load = kalman.model.noise[v, v]
        path_covariance[q, q] = load * h * h * bridge**3 / 3.0
        path_covariance[v, v] = load * bridge * (1.0 - 3.0 * bridge)
    state_and_sensitivity = first @ at_start + second @ at_end
    end_map = first + second @ kalman.history.transition[kalman.history.transition_index[slot]]
    state = state_and_sensitivity[:, 0] + state_and_sensitivity[:, 1:] @ kalman.bias_parameters
    return SmoothedState(
        state, end_map @ smoothed_covariance @ end_map.T + path_covariance, state_and_sensitivity[:, 1:]
    )


_backward = kernel("smoother_backward", RECORD, INTEGER, INTEGER, ARRAY, ARRAY, ARRAY)


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
    _, n, width = history.state.shape
    adjoint, next_adjoint, information = np.empty((n, width)), np.empty((n, width)), np.empty((n, n))
    _backward(pack_history(history), first, count, adjoint, next_adjoint, information)
    return adjoint, next_adjoint, information


def error_after(history: History, first: int, count: int, error: Floats) -> Floats:
    """Carry an error of the filter (n,) at step ``first`` over ``count`` steps, by ``F = A - K H``; (n,)."""
    for step in range(first, first + count):
        slot = step % len(history.state)
        used = history.row_count[slot]
        innovation = history.whitened_H[slot, :used] @ error
        error = history.transition[history.transition_index[slot]] @ error
        error = error - innovation @ history.whitened_cross_cov[slot, :used]
    return error
