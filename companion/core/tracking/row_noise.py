"""Noise of the slope and rate rows as it is in this flight, learned from the filter's innovations.

With the right R the innovations ``e`` are white and ``C_0 - C_1 = S``, ``C_k`` their autocovariance at k epochs. Noise
beyond the belief raises ``C_0`` and makes ``C_1`` negative: R grows by the excess of ``C_0 - C_1`` over S. What
contradicts the model slowly (a drifting bias, a wrong scale, a load larger than believed) makes ``C_1`` as large as
``C_0``: it is not learned as noise and stays a contradiction. The vertical rows are not learned: what they feel is the
gust's, and its spectrum is fitted; nor is a row whose S is the load's by far (Mehra, IEEE TAC 15, 1970, for the idea;
medians for blows and lies).
"""

from __future__ import annotations

import numpy as np

from companion.core.tracking.states import P_LEFT, ROWS, Y_LEFT
from companion.records import Bools, Floats
from companion.units import GRAVITY_MPS2

_MIN_STEPS = 60  # chosen: their median square is right to a quarter
_MEDIAN_OF_SQUARE = 0.4549  # derived: of a unit Gaussian's square, the median of chi-square with one degree
_MIN_BEYOND = 0.3  # chosen, of S: a load's fit is as wrong; where S is the load's, that is many times the noise
_CLEARLY_BEYOND = 1.0  # chosen, of S: six sigmas of one look
_MAX_OTHERS = 50.0  # chosen: believed variances; where the load is more of S, a row's noise neither shows nor matters
_MEMORY = 0.6  # chosen: per second, a time constant of 2 s
_MAX_RATIO = 1e4  # chosen: noise up to a hundred times the belief; beyond, the sensor is broken
_LEARNED = slice(Y_LEFT, ROWS)  # rows


class RowNoise:
    """Variance of each row, the believed one and what was learned beyond it.

    Attributes
    ----------
    variance : (9,) float64
        As ``SensorNoise.sensor_variance``: of the lateral rows in (m/s^2)^2.
    """

    def __init__(self, believed: Floats) -> None:
        self._believed = believed
        self.variance: Floats = believed.copy()
        self._beyond = np.zeros(ROWS)  # C_0 - C_1 over S, less one, of the last look

    @property
    def ratio(self) -> Floats:
        """Standard deviation of each row over the believed one, (9,)."""
        return np.asarray(np.sqrt(self.variance / self._believed))

    def learn(self, innovation: Floats, predicted: Floats, gated: Bools) -> None:
        """Take the innovations of the last second.

        Parameters
        ----------
        innovation, predicted : (n, 9) float64
            Innovations and their variances; 0 where a row was absent.
        gated : (n, 9) bool
            Rows that lay beyond the gate.
        """
        used = (predicted > 0.0) & ~gated
        pair = used[1:] & used[:-1]
        usual = 0.5 * (predicted[1:] + predicted[:-1])
        ratio = 0.5 * np.diff(innovation, axis=0) ** 2 / np.where(pair, usual, 1.0)
        for row in range(ROWS)[_LEARNED]:
            at = pair[:, row]
            if at.sum() < _MIN_STEPS:
                continue
            # a slope is a lateral force over the vertical one
            predicted_mean = np.median(usual[at, row]) * (GRAVITY_MPS2**2 if row < P_LEFT else 1.0)
            beyond = np.median(ratio[at, row]) / _MEDIAN_OF_SQUARE - 1.0
            before, self._beyond[row] = self._beyond[row], beyond
            if 0.0 < beyond < _CLEARLY_BEYOND:
                beyond = min(beyond, before) if before > _MIN_BEYOND < beyond else 0.0
            if predicted_mean - self.variance[row] > _MAX_OTHERS * self._believed[row]:
                beyond = min(beyond, 0.0)
            learned = self.variance[row] + _MEMORY * beyond * predicted_mean
            self.variance[row] = np.clip(learned, self._believed[row], _MAX_RATIO * self._believed[row])
