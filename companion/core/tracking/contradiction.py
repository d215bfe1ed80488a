"""Contradiction between the sensors and the wing's model: when it begins and ends, and when the filter starts again."""

from __future__ import annotations

import math

import numpy as np

from companion.core.tracking.filter import SeparatedBiasFilter
from companion.records import Reject

NIS_LIMIT = 3.0  # chosen, per row: with the right model it stays below 2
_NIS_AGAIN = 2.0  # chosen: a contradiction that has begun lasts until the NIS is what the right model has
# chosen, of the slow deflection by gusts as fitted: a state that a lost line drove to ten stays there, for vertical
# axes contradict no slow load that holds it
_MOST_SIGMAS = 6.0
_SETTLE_S = 2.0  # chosen: the filter's transient, ten periods at 5 Hz
_BRIEF_S = 1.0  # chosen: a blow of 40 m/s2 contradicts for 0.6 s, and the state follows it
_APART_S = 3.0  # chosen: what comes again sooner is no single blow; a gusty flight has one each 4 s
_NAMED_S = 0.5  # chosen: half of what the NIS remembers, whose rows tell the worst
_AGAIN_AND_AGAIN = 2  # chosen, of starts: a third has no other sensors
_OVER_S = 10.0  # chosen: without one, as long as the tracker needs to be trusted
_ROWS = (
    *("left vertical axis", "right vertical axis", "left vertical axis", "right vertical axis"),
    *("left lateral axis", "right lateral axis", "left roll rate", "right roll rate", "root roll rate"),
)  # of the measurement, in its order (by definition)
_LIMIT_S = 5.0  # chosen: a filter that contradicts its sensors for longer starts again


class Contradiction:
    """Watch on the filter's NIS and on the slow deflection.

    A single brief one is a blow's: trust returns with the NIS. Any other lasts until the NIS is what the right model
    has, and the filter's transient longer.
    """

    def __init__(self) -> None:
        self._starts = 0  # in a row
        self._worst = ""
        self.begin_anew()

    def begin_anew(self) -> None:
        """Look at a filter that starts again."""
        self._now = False
        self._clear_s = 0.0  # since the last one, or since the start
        self._consistent_s = math.inf  # since the last one
        self._lasted_s = 0.0  # of this one, or of the last
        self._grave = False  # this one, or the last, is no single blow's
        self._above_s = 0.0  # the limit without a break

    def update(self, kalman: SeparatedBiasFilter, deflection_sigmas: float, passed_s: float) -> None:
        """Look at the filter after a run; ``deflection_sigmas`` as :class:`.validity.ModalActivity` has it."""
        nis, before = kalman.nis, self._now
        limit = _NIS_AGAIN if before and self._grave else NIS_LIMIT
        self._now = nis > limit or deflection_sigmas > _MOST_SIGMAS
        if self._now:
            self._lasted_s = passed_s + (self._lasted_s if before else 0.0)
            self._grave = self._lasted_s > _BRIEF_S or (self._grave if before else self._consistent_s < _APART_S)
        self._consistent_s = 0.0 if self._now else self._consistent_s + passed_s
        self._clear_s = 0.0 if self._now else self._clear_s + passed_s
        self._above_s = self._above_s + passed_s if nis > NIS_LIMIT else 0.0
        if self._clear_s >= _OVER_S:
            self._starts, self._worst = 0, ""
        if self._above_s > _NAMED_S and not self._worst:
            self._worst = worst_row(kalman)
        if self.too_long:
            self._starts += 1

    @property
    def holds(self) -> bool:
        """Whether the sensors contradict the model."""
        return self._now or self.lasting

    @property
    def lasting(self) -> bool:
        """Whether it held before and after a start of the filter, and ten seconds without have not passed."""
        return self._starts >= _AGAIN_AND_AGAIN

    @property
    def sentence(self) -> str:
        """Sentence for the operator, with the measurement that contradicts most."""
        return f"{Reject.CONTRADICTED}" + (f", most of all the {self._worst}" if self._worst else "")

    @property
    def too_long(self) -> bool:
        """Whether the filter has contradicted its sensors for too long to recover."""
        return self._above_s > _LIMIT_S

    @property
    def settled(self) -> bool:
        """Whether the transient behind the last one is over."""
        return not self._grave or self._consistent_s >= _SETTLE_S

    def mend(self) -> None:
        """Wait anew before the filter starts again: what was wrong has been found, and the state follows."""
        self._above_s = 0.0


def worst_row(kalman: SeparatedBiasFilter) -> str:
    """Name of the measurement whose innovations of the last quarter of a second are largest against their sigma."""
    count = min(kalman.steps, kalman.history_length, round(0.25 / kalman.model.step_s))
    innovation, covariance = kalman.innovations(count)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    squares = np.divide(innovation**2, variance, out=np.zeros_like(innovation), where=variance > 0.0)
    return _ROWS[int((squares.sum(axis=0) / np.maximum((variance > 0.0).sum(axis=0), 1)).argmax())]
