"""The true range with one false reading among its own: what a range finder does at a bird or a puddle."""

from __future__ import annotations

import numpy as np

from companion.sim.landing.landing_flight import LandingFlight, TrueRange

LONG_M, SHORT_M = (80.0, 190.0), (5.0, 10.0)
"""Of what a false reading is drawn, m: beyond every height of the approach, and about that of a flare (choice)."""

_HEIGHT_M = (25.0, 45.0)  # at which it comes: ranges are in use, and the flare is still far (choice)
_LASTS_NS = 100_000_000  # two messages of a 20 Hz sensor (choice)


class OneFalseReading(TrueRange):
    """A :class:`companion.sim.landing.landing_flight.RangeSource`: the truth, but for 0.1 s of the descent.

    The landing's seed draws the height at which the reading is false, and what is read, evenly from ``between_m``.
    """

    def __init__(self, landing: LandingFlight, between_m: tuple[float, float]) -> None:
        super().__init__(landing)
        rng = np.random.default_rng([landing.seed, *b"false reading"])
        self._height_m, self._false_m = float(rng.uniform(*_HEIGHT_M)), float(rng.uniform(*between_m))
        self._flight = landing
        self._until_ns: int | None = None

    def reading_m(self, now_ns: int) -> float | None:
        """The true range, or the false one."""
        true_m = super().reading_m(now_ns)
        if self._until_ns is None and -self._flight.present.position_ned_m[2] < self._height_m:
            self._until_ns = now_ns + _LASTS_NS
        if self._until_ns is not None and now_ns < self._until_ns:
            return self._false_m
        return true_m
