"""Optimal filter and fixed-lag smoother with correlated noise, for many seeds at once.

Prediction form: ``K = (F P H' + S) (H P H' + R)^-1``, ``x+ = F x + K e``, ``P+ = F P F' + Q - K (H P H' + R) K'``.
The estimate a lag later is ``x + P lambda`` with ``lambda = H' E^-1 e + (F - K H)' lambda+`` (Bryson and Frazier 1963).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sitl_tests.reference.observer import Dynamics
from sitl_tests.reference.views import Views

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Filtered:
    """States and covariances before each step (from all earlier data), and what the smoother needs.

    ``states`` (K + 1, S, n, c), ``covariances`` (K + 1, S, n, n), ``closed`` (K, S, n, n), ``pull`` (K, S, n, c),
    ``gain`` (K, S, n, n). The columns c beyond the first are sensitivities, where there are any.
    """

    states: Floats
    covariances: Floats
    closed: Floats
    pull: Floats
    gain: Floats


def filtered(segments: list[Dynamics], segment_of: npt.NDArray[np.int64], data: Views, P: Floats) -> Filtered:
    """Run the filter from a zero state with covariance ``P``; ``segment_of`` (K,) tells the dynamics of each step."""
    steps, seeds, _ = data.values.shape
    n = len(P)
    x, P = np.zeros((seeds, n, 1)), np.broadcast_to(P, (seeds, n, n)).copy()
    states, covariances = np.empty((steps + 1, seeds, n, 1)), np.empty((steps + 1, seeds, n, n))
    closed, gain = np.empty((steps, seeds, n, n)), np.empty((steps, seeds, n, n))
    pull = np.empty((steps, seeds, n, 1))
    states[0], covariances[0] = x, P
    for k in range(steps):
        system = segments[segment_of[k]]
        step, M = system.step, data.gains[k]
        H = M @ step.H + data.bias_gains[k]
        R = M @ step.R @ M.swapaxes(1, 2) + data.noise
        S = step.S @ M.swapaxes(1, 2)
        u = data.excess[k][:, None]
        e = data.values[k] - (H @ x)[..., 0] - u * (M @ system.push_view)
        FP, HP = step.F @ P, H @ P
        E = HP @ H.swapaxes(1, 2) + R
        cross = FP @ H.swapaxes(1, 2) + S
        inverse = np.linalg.inv(E)
        K = cross @ inverse
        HE = H.swapaxes(1, 2) @ inverse
        closed[k], gain[k], pull[k] = step.F - K @ H, HE @ H, HE @ e[..., None]
        x = step.F @ x + K @ e[..., None]
        x[..., 0] += u * system.push
        P = FP @ step.F.T + step.Q - K @ cross.swapaxes(1, 2)
        P = (P + P.swapaxes(1, 2)) / 2
        states[k + 1], covariances[k + 1] = x, P
    return Filtered(states, covariances, closed, pull, gain)


def smoothed(run: Filtered, at: npt.NDArray[np.int64], lag_steps: int) -> tuple[Floats, Floats]:
    """States (len(at), S, n, c) and covariances at steps ``at`` from data up to ``lag_steps`` later."""
    adjoint = np.zeros_like(run.states[at])
    information = np.zeros_like(run.covariances[at])
    for offset in range(lag_steps - 1, -1, -1):
        closed = run.closed[at + offset]
        transposed = closed.swapaxes(2, 3)
        adjoint = run.pull[at + offset] + transposed @ adjoint
        information = run.gain[at + offset] + transposed @ information @ closed
    P = run.covariances[at]
    return run.states[at] + P @ adjoint, P - P @ information @ P
