"""Watch on the first moments of the tips' vertical forces: left out where a load's path in an epoch is not the gust's.

The model of a gust says how its load changes inside an epoch. The lift of an aircraft in turbulence changes there too,
and the root's low-passed samples show its mean alone: the load that bends the wing then moves inside the epoch by what
nobody measures.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.states import M_LEFT, Y_LEFT
from companion.records import Floats

_MOST_SQUARE = 4.0  # chosen, per row: with the right model it stays below 2
_OTHERS_SQUARE = 2.0  # chosen, per row: above, more than the first moments is wrong
_REMEMBERED_S = 1.0  # chosen: as the filter's NIS
_TEACHES_NOTHING_S = 1.0  # chosen: in which an error of the motion of further modes teaches no constant much
_MOST_OF_ONE = 100.0  # chosen: ten sigmas, so that a blow of some epochs is no wrong model
_LEAST_ROWS = 250  # chosen: half a second of both tips, of which chance makes no mean square of 4


class FirstMoments:
    """Whether the first moments are rows of the measurement; once left out they stay so until lift-off, or for good.

    They are judged from the second fit on: a gust that is only believed, or fitted to one second, may change otherwise
    inside an epoch.
    """

    def __init__(self) -> None:
        self.left_out = False
        self._sums: Floats = np.zeros(4)
        self._taught_s = 0.0  # since constants of further modes began anew

    def contradict(self, kalman: SeparatedBiasFilter, count: int, passed_s: float) -> bool:
        """Look at the newest ``count`` steps of the filter; whether first moments are left out from now on.

        Where they are, constants that the motion of further modes teaches begin anew each second: a load that moves
        inside the epoch passes for that motion.
        """
        self._taught_s += passed_s
        begins = not self.left_out
        if begins:  # else there are none to look at
            self._sums = math.exp(-passed_s / _REMEMBERED_S) * self._sums + _sums(kalman, count)
            self.left_out = begins = _contradict(self._sums)
        if self.left_out and self._taught_s > _TEACHES_NOTHING_S:
            kalman.reset_bias_parameters(_by_further_modes(kalman.layout.bias_parameters))
            self._taught_s = 0.0
        return begins

    def contradict_trial(self, tried: SeparatedBiasFilter, segments: Iterable[Epochs], step_s: float) -> bool:
        """Whether they contradict the model on which new parameters are tried; then they are left out, there too."""
        contradicted = _contradict(_sums(tried, round(_REMEMBERED_S / step_s)))
        self.left_out |= contradicted
        for epochs in segments if contradicted else ():
            self.leave_out(epochs)
        return contradicted

    def leave_out(self, epochs: Epochs) -> None:
        """Take them from epochs, in place, if they are left out."""
        if self.left_out:
            epochs.present[:, M_LEFT:Y_LEFT] = False


def _by_further_modes(names: Sequence[str]) -> list[str]:
    """Bias parameters that only the motion of modes beyond the first of each family teaches."""
    first = {"slope.symmetric", "slope.antisymmetric"}
    return [name for name in names if name.startswith(("slope.", "further_shortening")) and name not in first]


def _contradict(sums: Floats) -> bool:
    square, count, others_square, others = sums.tolist()
    return bool(count > _LEAST_ROWS and square > _MOST_SQUARE * count and others_square < _OTHERS_SQUARE * others)


def _sums(kalman: SeparatedBiasFilter, count: int) -> Floats:
    """Sums over the newest steps: squares of the whitened first moments, each bounded, their number; of all others."""
    count, history = min(count, kalman.steps, kalman.history_length), kalman.history
    slots = np.arange(kalman.steps - count, kalman.steps) % kalman.history_length
    squares = np.minimum(history.whitened_innovation[slots, :, 0] ** 2, _MOST_OF_ONE)
    used = np.arange(squares.shape[1]) < history.row_count[slots, np.newaxis]
    present = np.diagonal(history.innovation_covariance, axis1=1, axis2=2)[slots, :Y_LEFT] > 0.0
    steps, sides = np.nonzero(present[:, M_LEFT:])
    moments = np.zeros(squares.shape, dtype=np.bool_)
    moments[steps, np.cumsum(present, axis=1)[steps, M_LEFT + sides] - 1] = True
    others = used & ~moments
    return np.array([squares[moments].sum(), moments.sum(), squares[others].sum(), others.sum()], dtype=np.float64)
