"""Drift of the tips' gyros beyond what their bias states allow: the slope follows it, and no innovation shows it."""

from __future__ import annotations

from collections import deque

import numpy as np

from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.states import P_LEFT, StateLayout
from companion.records import Floats

_PERIOD_S = 1.0  # chosen: between looks
_LOOKS = 10  # chosen: ten seconds, in which a drift that is slower moves the slope by less than its sigma
_MOST_SIGMAS = 8.0  # chosen, of the change by random walk and uncertainty: manoeuvres and vibration reach 3


class BiasDrift:
    """Largest change of the tips' roll rate biases within ten seconds, in its own sigmas."""

    def __init__(self, layout: StateLayout) -> None:
        at = [(bias, state) for bias, (row, state) in enumerate(layout.row_bias_states) if row >= P_LEFT]
        self._biases = np.array([bias for bias, _ in at], np.int64)
        self._states = np.array([state for _, state in at], np.int64)
        self._looks: deque[tuple[float, Floats, Floats]] = deque(maxlen=_LOOKS)  # time, biases, their variances
        self._steps = 0
        self._sigmas = 0.0

    @property
    def too_fast(self) -> bool:
        """Whether a bias drifts as none with its sensor's sigma does."""
        return self._sigmas > _MOST_SIGMAS

    def update(self, kalman: SeparatedBiasFilter) -> None:
        """Look at the biases once a second; a filter that has begun anew has none of those before."""
        steps, step_s = kalman.steps, kalman.model.step_s
        if steps < self._steps:
            self._looks.clear()
        elif (steps - self._steps) * step_s < _PERIOD_S or not len(self._states):
            return
        self._steps, now_s, biases = steps, steps * step_s, kalman.state[self._states]
        variance = np.diag(kalman.total_covariance)[self._states]
        prior = np.diag(kalman.noise.bias_prior_covariance)[self._biases]
        self._sigmas = 0.0
        for then_s, before, variance_before in self._looks:
            walk = 2.0 * (now_s - then_s) / kalman.noise.bias_time_s * prior
            change = np.abs(biases - before) / np.sqrt(walk + variance + variance_before)
            self._sigmas = max(self._sigmas, float(change.max()))
        self._looks.append((now_s, biases, variance))
