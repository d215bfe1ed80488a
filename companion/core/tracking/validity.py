"""What the estimate may be used for, and how strong the motion is."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.filter import Kalman
from companion.core.tracking.model import StepModel
from companion.core.tracking.parameters import FREQUENCY, ModeParameters
from companion.core.tracking.states import Layout
from companion.records import Floats, Ints, Validity

_BLOCK_S = 1.0
_BLOCKS = 5
_SETTLE_S = 2.0
_LEARN_S = 10.0  # until then the parameters move by much, and the history is run again with them
_VAGUE = 0.2  # relative sigma of the frequency beyond which it is not known which mode is followed
SURPRISED = 3.0  # mean square of normalised innovations; with the right model it stays below 2


class Level:
    """Mean square of both modes' swing: the median of the last seconds' blocks.

    The swing is told by the rate of the deflection over the mode's circular frequency, which is the deflection itself
    where a mode swings. A jump of the static bend, as at take-off, moves the deflection far, but slowly: no swing.

    Attributes
    ----------
    settled_s : float
        Time since the tracker began, or since it was last without sensors.
    learned : bool
        The parameters have been learned, once.
    """

    def __init__(self, layout: Layout) -> None:
        self._rates = np.array([family.v for family in layout.families])
        self._model: StepModel | None = None
        self._stiffness: Floats = np.ones(2)  # of its modes: circular frequencies squared
        self._blocks: deque[Floats] = deque(maxlen=_BLOCKS)
        self._sum, self._count = np.zeros(2), 0
        self._rms: Floats = np.zeros(2)
        self.settled_s = 0.0
        self.learned = False

    def update(self, kalman: Kalman, count: int, step_s: float) -> None:
        """Take the newest ``count`` steps."""
        taken = min(count, kalman.kept)
        if kalman.model is not self._model:
            omega = 2.0 * np.pi * np.array([mode.frequency_hz for mode in kalman.model.parameters])
            self._model, self._stiffness = kalman.model, omega**2
        squares = _rate_squares(kalman.history.state, kalman.steps - taken, taken, self._rates, kalman.weights)
        self._sum = self._sum + squares / self._stiffness
        self._count += taken
        self.settled_s += count * step_s
        self.learned |= self.settled_s >= _LEARN_S
        if not self._blocks:
            self._rms = np.sqrt(self._sum / self._count)
        if self._count * step_s >= _BLOCK_S:
            self._blocks.append(self._sum / self._count)
            self._sum, self._count = np.zeros(2), 0
            self._rms = np.sqrt(np.median(self._blocks, axis=0))

    @property
    def settled(self) -> bool:
        """Whether it has followed the wing for long enough to be believed."""
        return self.settled_s >= _SETTLE_S

    def rms_m(self) -> Floats:
        """Root mean square, symmetric and antisymmetric."""
        return self._rms


@compiled
def _rate_squares(states: Floats, first: int, count: int, rates: Ints, weights: Floats) -> Floats:
    """Sum of the squares of both modes' rates over ``count`` steps of the history from ``first`` on, (2,)."""
    total = np.zeros(len(rates))
    for k in range(first, first + count):
        for family in range(len(rates)):
            total[family] += np.dot(states[k % len(states), rates[family]], weights) ** 2
    return total


def judge(
    *,
    stale: bool,
    saturated: bool,
    settled: bool,
    surprise: float,
    rms_m: Floats,
    calm_rms_m: float,
    parameters: tuple[ModeParameters, ModeParameters],
    ambiguous: bool,
) -> Validity:
    """Say what the estimate may be used for; the gravest reason wins."""
    if stale:
        return Validity.STALE
    if saturated:
        return Validity.SATURATED
    if surprise > SURPRISED:
        return Validity.INCONSISTENT
    if not settled:
        return Validity.SETTLING
    symmetric_m, antisymmetric_m = rms_m.tolist()
    if math.sqrt(symmetric_m * symmetric_m + antisymmetric_m * antisymmetric_m) < calm_rms_m:
        return Validity.CALM
    strongest = parameters[int(antisymmetric_m > symmetric_m)]
    if ambiguous or strongest.log_sigma[FREQUENCY] > _VAGUE:
        return Validity.AMBIGUOUS
    return Validity.TRACKING
