"""Kalman filters of many hypotheses at once in plain numpy: ``native/decay.c``."""

from __future__ import annotations

import numpy as np

from companion.diagnosis.free_decay.kalman import Steps
from companion.records import Floats


def filter_batch(steps: Steps, y: Floats, innovation: Floats, variance: Floats, state: Floats) -> None:
    """Step by step, all hypotheses at once: numpy's way. Fills the last three, (t, b) and (t, b, n)."""
    transition, process_noise, H, cross_covariance, noise, start = steps
    count, batch, order = H.shape
    x, p = np.zeros((batch, order, 1)), np.zeros((batch, order, order))
    p[:, range(order), range(order)] = start
    h_rows, h_columns, added, transposed = (
        H[:, :, None, :],
        H[..., None],
        cross_covariance[..., None],
        transition.swapaxes(2, 3),
    )
    for t in range(count):
        ph = p @ h_columns[t]
        s = (h_rows[t] @ ph) + noise[t][:, None, None]
        e = y[t][:, None, None] - h_rows[t] @ x
        gain = (transition[t] @ ph + added[t]) / s
        x = transition[t] @ x + gain * e
        p = transition[t] @ p @ transposed[t] + process_noise[t] - (gain * s) * gain.swapaxes(1, 2)
        innovation[t], variance[t], state[t] = e[:, 0, 0], s[:, 0, 0], x[:, :, 0]
