"""The truth of a flight that is looked at while it is flown: knots are added at its end."""

from __future__ import annotations

import numpy as np

from companion.records import Floats
from companion.sim.flight.truth import MODAL, FlightTruth, TipShape


class GrowingTruth(FlightTruth):
    """A :class:`companion.sim.flight.truth.FlightTruth` whose end moves on; what lies beyond it raises ValueError.

    Knots are ``step_ns`` apart and at most ``most``.
    """

    def __init__(self, shape: TipShape, step_ns: int, most: int) -> None:
        columns = MODAL.start + shape.lift.shape[1]
        self._knots, self._derivatives = np.zeros((most, columns)), np.zeros((most, columns))
        super().__init__(self._knots[:0], self._derivatives[:0], shape, step_ns)

    def add(self, knot: Floats, derivative: Floats) -> None:
        """Add the next knot and its derivative, (12 + s,) each; raise IndexError where there is no room."""
        count = len(self.knots)
        self._knots[count], self._derivatives[count] = knot, derivative
        self.knots, self.derivatives = self._knots[: count + 1], self._derivatives[: count + 1]
