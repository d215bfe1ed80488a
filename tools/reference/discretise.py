"""Exact discretisation of a linear system whose outputs are averages over the step, with white noise in both.

``x' = A x + B w``, ``y = C x + D w``, ``E[w w'] = W delta``: the state at the end of a step and the average of ``y``
over it have jointly Gaussian noise, found in one matrix exponential (Van Loan, IEEE TAC 23(3), 1978) of the system
augmented with the integral of ``y``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Discrete:
    """``x+ = F x + n_x``, ``y = H x + n_y`` with covariances ``Q``, ``R`` and cross covariance ``S = E[n_x n_y']``."""

    F: Floats
    H: Floats
    Q: Floats
    R: Floats
    S: Floats

    def project(self, rows: Floats) -> Discrete:
        """Keep the combinations ``rows`` of the outputs."""
        return Discrete(self.F, rows @ self.H, self.Q, rows @ self.R @ rows.T, self.S @ rows.T)


def averages(A: Floats, B: Floats, C: Floats, D: Floats, W: Floats, step_s: float) -> Discrete:
    """Discretise over ``step_s``."""
    n, m = len(A), len(C)
    size = n + m
    drift = np.zeros((size, size))
    drift[:n, :n], drift[n:, :n] = A, C
    diffusion = np.vstack([B, D])
    block = np.zeros((2 * size, 2 * size))
    block[:size, :size] = -drift * step_s
    block[:size, size:] = diffusion @ W @ diffusion.T * step_s
    block[size:, size:] = drift.T * step_s
    exponential = scipy.linalg.expm(block)
    F = exponential[size:, size:].T
    Q = F @ exponential[:size, size:]
    Q = (Q + Q.T) / 2
    return Discrete(F[:n, :n], F[n:, :n] / step_s, Q[:n, :n], Q[n:, n:] / step_s**2, Q[:n, n:] / step_s)


def stacked(step: Discrete, count: int) -> Discrete:
    """Join ``count`` equal steps into one; the outputs of the steps follow each other."""
    n, m = len(step.F), len(step.H)
    noise = np.block([[step.Q, step.S], [step.S.T, step.R]])
    powers = [np.linalg.matrix_power(step.F, i) for i in range(count + 1)]
    total = np.zeros((n + count * m, n + count * m))
    for at in range(count):
        effect = np.zeros((n + count * m, n + m))
        effect[:n, :n] = powers[count - 1 - at]
        effect[n + at * m : n + (at + 1) * m, n:] = np.eye(m)
        for later in range(at + 1, count):
            effect[n + later * m : n + (later + 1) * m, :n] = step.H @ powers[later - 1 - at]
        total += effect @ noise @ effect.T
    H = np.vstack([step.H @ powers[i] for i in range(count)])
    return Discrete(powers[count], H, total[:n, :n], total[n:, n:], total[:n, n:])


def riccati(step: Discrete) -> Floats:
    """Steady covariance of the one-step prediction, by structure-preserving doubling (Chu, Fan, Lin, Wang 2004)."""
    inverse = np.linalg.inv(step.R)
    A = (step.F - step.S @ inverse @ step.H).T
    G = step.H.T @ inverse @ step.H
    X = step.Q - step.S @ inverse @ step.S.T
    unit = np.eye(len(A))
    for _ in range(60):
        left = np.linalg.solve(unit + G @ X, A)
        right = np.linalg.solve(unit + G @ X, G)
        X_next, G, A = X + A.T @ X @ left, G + A @ right @ A.T, A @ left
        done = np.abs(X_next - X).max() <= 1e-14 * np.abs(X_next).max()
        X, G = (X_next + X_next.T) / 2, (G + G.T) / 2
        if done:
            break
    return X
