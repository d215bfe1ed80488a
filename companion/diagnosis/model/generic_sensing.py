"""Laws of the sensors without a name: a channel that leaks into the other, readings that are late."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Complexes, Floats, Station


@dataclass(frozen=True, slots=True)
class GenericLeak(Effect):
    """One side also shows a share of what the other side does."""

    group: ClassVar[Group] = Group.SENSING
    station: ClassVar[Station]

    leaked_ratio: float = parameter("", 0.1, "of the other side's motion")


@dataclass(frozen=True, slots=True)
class GenericPhase(Effect):
    """A phase of one side, or of both, that grows with frequency."""

    group: ClassVar[Group] = Group.SENSING
    stations: ClassVar[tuple[Station, ...]]

    slope_s: float = parameter("s", 0.005, "phase per angular frequency")

    def response(self, station: Station, f_hz: Floats) -> Complexes | None:
        """Delay the stations of this law."""
        return np.asarray(np.exp(-2j * np.pi * f_hz * self.slope_s)) if station in type(self).stations else None


@dataclass(frozen=True, slots=True)
class GenericLag(Effect):
    """Both sides pass one pole: late, and with a gain that falls with frequency, as a causal filter must.

    To first order in the lag it is a delay; the two differ in second order.
    """

    group: ClassVar[Group] = Group.SENSING

    lag_s: float = parameter("s", 0.003, "time constant")

    def response(self, station: Station, f_hz: Floats) -> Complexes | None:
        """Gain of one pole."""
        return None if station is Station.ROOT else np.asarray(1.0 / (1.0 + 2j * np.pi * f_hz * self.lag_s))
