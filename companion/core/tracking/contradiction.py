"""Contradiction between the sensors and the wing's model: when it begins and ends, and when the filter starts again."""

from __future__ import annotations

import math

from companion.core.tracking.filter import SeparatedBiasFilter

NIS_LIMIT = 3.0  # chosen, per row: with the right model it stays below 2
_NIS_AGAIN = 2.0  # chosen: a contradiction that has begun lasts until the NIS is what the right model has
# chosen, of the slow deflection by gusts as fitted: a state that a lost line drove to ten stays there, for vertical
# axes contradict no slow load that holds it
_MOST_SIGMAS = 6.0
_SETTLE_S = 2.0  # chosen: the filter's transient, ten periods at 5 Hz
_BRIEF_S = 1.0  # chosen: a blow of 40 m/s2 contradicts for 0.6 s, and the state follows it
_APART_S = 10.0  # chosen: what comes again sooner is no single blow
_LIMIT_S = 5.0  # chosen: a filter that contradicts its sensors for longer starts again


class Contradiction:
    """Watch on the filter's NIS and on the slow deflection.

    A single brief one is a blow's: trust returns with the NIS. Any other lasts until the NIS is what the right model
    has, and the filter's transient longer.

    Attributes
    ----------
    holds : bool
        The sensors contradict the model now.
    """

    def __init__(self) -> None:
        self.holds = False
        self._consistent_s = math.inf  # since the last one
        self._lasted_s = 0.0  # of this one, or of the last
        self._grave = False  # this one, or the last, is no single blow's
        self._above_s = 0.0  # the limit without a break

    def update(self, kalman: SeparatedBiasFilter, deflection_sigmas: float, passed_s: float) -> None:
        """Look at the filter after a run; ``deflection_sigmas`` as :class:`.validity.ModalActivity` has it."""
        nis, before = kalman.nis, self.holds
        limit = _NIS_AGAIN if before and self._grave else NIS_LIMIT
        self.holds = nis > limit or deflection_sigmas > _MOST_SIGMAS
        if self.holds:
            self._lasted_s = passed_s + (self._lasted_s if before else 0.0)
            self._grave = self._lasted_s > _BRIEF_S or (self._grave if before else self._consistent_s < _APART_S)
        self._consistent_s = 0.0 if self.holds else self._consistent_s + passed_s
        self._above_s = self._above_s + passed_s if nis > NIS_LIMIT else 0.0

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
