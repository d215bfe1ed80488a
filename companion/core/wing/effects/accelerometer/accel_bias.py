"""A wing accelerometer with an offset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter, with_vertical
from companion.records import Complexes, Floats, Station


@dataclass(frozen=True, slots=True)
class AccelBias(Effect):
    """A station adds a constant to the vertical specific force."""

    name: ClassVar[str] = "accel-bias"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "turn each sensor over in the workshop: half the sum of the two readings is the offset"

    left_mps2: float = parameter("m/s^2", 0.3, "offset of the left accelerometer")
    right_mps2: float = parameter("m/s^2", 0.3, "offset of the right accelerometer")

    def response(self, station: Station, f_hz: Floats) -> Complexes:
        """No gain: an offset is not in the band."""
        del station
        return np.ones(len(f_hz), dtype=np.complex128)

    def bias(self, station: Station) -> float:
        """The offset."""
        return {Station.LEFT: self.left_mps2, Station.RIGHT: self.right_mps2}.get(station, 0.0)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Add the offset."""
        del t_s
        return with_vertical(values, values[:, 2] + self.bias(station))

    def undone(self, station: Station, values: Floats) -> Floats:
        """Take the offset off."""
        bias = self.bias(station)
        return with_vertical(values, values[:, 2] - bias) if bias else values
