"""Optimal filter and fixed-lag smoother with correlated noise, for many seeds at once.

Prediction form: ``K = (F P H' + S) (H P H' + R)^-1``, ``x+ = F x + K e``, ``P+ = F P F' + Q - K (H P H' + R) K'``.
The estimate a lag later is ``x + P lambda`` with ``lambda = H' E^-1 e + (F - K H)' lambda+`` (Bryson and Frazier 1963).
Constants with a prior are carried as columns of sensitivity beside the state, ``e(theta) = e - Psi theta``. A scale or
a shift in time acts on the whole motion of a step, and so the columns are driven; but a constant is judged only by the
part of ``Psi`` that was foreseen before the step, for the rest holds the innovation itself. ``Psi' E^-1 Psi`` and
``Psi' E^-1 e`` then add up to all that is known of ``theta``, but for what the exact strength of the gust would tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tools.reference.observer import REFERENCE_STEP_S, Dynamics
from tools.reference.priors import Sensitivity
from tools.reference.spec import GRAVITY_MPS2
from tools.reference.views import Views

Floats = npt.NDArray[np.float64]
EVERY = 25  # steps between records of what is known of the constants


@dataclass(frozen=True, slots=True)
class Filtered:
    """Estimates before each step (from all earlier data), and what the smoother needs.

    Attributes
    ----------
    states : (K + 1, S, n, 1 + c)
        The nominal estimate and its sensitivity to each constant.
    covariances : (K + 1, S, n, n)
        With the constants known.
    closed, gain : (K, S, n, n)
    pull : (K, S, n, 1 + c)
    information : (K // EVERY + 1, S, c, c), vector : (K // EVERY + 1, S, c)
        What the innovations of the first ``i EVERY`` steps say of the constants, prior included.
    """

    states: Floats
    covariances: Floats
    closed: Floats
    gain: Floats
    pull: Floats
    information: Floats
    vector: Floats

    def constants(self, step: int) -> tuple[Floats, Floats]:
        """Estimate (S, c) and covariance (S, c, c) of the constants from the data before ``step``."""
        covariance = np.linalg.inv(self.information[step // EVERY])
        return np.einsum("sab,sb->sa", covariance, self.vector[step // EVERY]), covariance


def filtered(
    segments: list[Dynamics], segment_of: npt.NDArray[np.int64], data: Views, P: Floats, errors: Sensitivity
) -> Filtered:
    """Run the filter from a zero state with covariance ``P``; ``segment_of`` (K,) tells the dynamics of each step."""
    steps, seeds, _ = data.values.shape
    n, c = len(P), len(errors.constants.names)
    x, P = np.zeros((seeds, n, 1 + c)), np.broadcast_to(P, (seeds, n, n)).copy()
    states, covariances = np.empty((steps + 1, seeds, n, 1 + c)), np.empty((steps + 1, seeds, n, n))
    closed, gain = np.empty((steps, seeds, n, n)), np.empty((steps, seeds, n, n))
    pull = np.empty((steps, seeds, n, 1 + c))
    information, vector = np.empty((steps // EVERY + 1, seeds, c, c)), np.empty((steps // EVERY + 1, seeds, c))
    accumulated = np.broadcast_to(np.diag(errors.constants.sigma**-2.0), (seeds, c, c)).copy()
    said = np.zeros((seeds, c))
    states[0], covariances[0] = x, P
    before = np.zeros((seeds, segments[0].step.H.shape[0]))
    for k in range(steps):
        if k % EVERY == 0:
            information[k // EVERY], vector[k // EVERY] = accumulated, said
            theta = np.linalg.solve(accumulated, said[..., None])[..., 0]
        system = segments[segment_of[k]]
        step = system.step
        best = x[..., 0:1] + x[..., 1:] @ theta[..., None]
        rough = (step.H @ best)[..., 0] + data.excess[k][:, None] * system.push_view
        bowed, slant = errors.bowed(k, rough, theta)
        M = data.gains[k] + slant
        H = M @ step.H + data.bias_gains[k] + errors.bias_bowed(rough, theta)
        transposed = M.swapaxes(1, 2)
        drive = np.zeros((seeds, 1 + c))  # load factor excess that each column sees
        drive[:, 0], drive[:, 1:] = data.excess[k], errors.load[k]
        view = M @ system.push_view
        e = -(H @ x) - view[:, :, None] * drive[:, None, :]
        e[..., 0] += data.values[k] - bowed + (slant @ rough[..., None])[..., 0]
        FP, HP = step.F @ P, H @ P
        # the root's noise n moves the measured load factor by -n/g beside what it does to the rows
        through, push = view / GRAVITY_MPS2, system.push / GRAVITY_MPS2
        twice = through[:, :, None] * data.root_gain
        noise = through[:, :, None] * through[:, None, :] + twice + twice.swapaxes(1, 2)
        E = HP @ H.swapaxes(1, 2) + M @ step.R @ transposed + data.noise + data.root_variance * noise
        by_root = data.root_variance * push[:, None] * (through + data.root_gain)[:, None, :]
        cross = FP @ H.swapaxes(1, 2) + step.S @ transposed + by_root
        inverse = np.linalg.inv(E)
        if c:
            foreseen = errors.direct(k, rough, (rough - before) / REFERENCE_STEP_S, theta)
            judged = (e[..., 1:] - foreseen) * errors.constants.judged
            accumulated = accumulated + judged.swapaxes(1, 2) @ inverse @ judged
            said = said - (judged.swapaxes(1, 2) @ inverse @ e[..., 0:1])[..., 0]
            surprise = e[..., 0:1] + judged @ theta[..., None]
            answer = (step.H @ P @ H.swapaxes(1, 2) + step.R @ transposed) @ inverse @ surprise
            motion = rough + answer[..., 0]
            e[..., 1:] -= errors.direct(k, motion, (motion - before) / REFERENCE_STEP_S, theta)
            before = motion
        K = cross @ inverse
        HE = H.swapaxes(1, 2) @ inverse
        closed[k], gain[k], pull[k] = step.F - K @ H, HE @ H, HE @ e
        x = step.F @ x + K @ e + system.push[:, None] * drive[:, None, :]
        P = FP @ step.F.T + step.Q + data.root_variance * np.outer(push, push) - K @ cross.swapaxes(1, 2)
        P = (P + P.swapaxes(1, 2)) / 2
        states[k + 1], covariances[k + 1] = x, P
    if steps % EVERY == 0:
        information[-1], vector[-1] = accumulated, said
    return Filtered(states, covariances, closed, gain, pull, information, vector)


def smoothed(run: Filtered, at: npt.NDArray[np.int64], lag_steps: int) -> tuple[Floats, Floats]:
    """States (len(at), S, n, 1 + c) and covariances at steps ``at`` from data up to ``lag_steps`` later."""
    adjoint = np.zeros_like(run.states[at])
    information = np.zeros_like(run.covariances[at])
    for offset in range(lag_steps - 1, -1, -1):
        closed = run.closed[at + offset]
        transposed = closed.swapaxes(2, 3)
        adjoint = run.pull[at + offset] + transposed @ adjoint
        information = run.gain[at + offset] + transposed @ information @ closed
    P = run.covariances[at]
    return run.states[at] + P @ adjoint, P - P @ information @ P
