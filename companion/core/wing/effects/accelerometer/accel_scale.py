"""A wing accelerometer that reads too much or too little."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Complexes, Floats, Station
from companion.units import GRAVITY_MPS2


@dataclass(frozen=True, slots=True)
class AccelScale(Effect):
    """A station reads (1 + ratio) times the specific force."""

    name: ClassVar[str] = "accel-scale"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "turn each sensor over in the workshop: the two readings differ by 2 g (1 + error)"

    left: float = parameter("", 0.05, "relative error of the left accelerometer")
    right: float = parameter("", 0.05, "relative error of the right accelerometer")

    def response(self, station: Station, f_hz: Floats) -> Complexes:
        """A constant gain."""
        return np.full(len(f_hz), 1.0 + self._ratio(station), dtype=np.complex128)

    def bias(self, station: Station) -> float:
        """Gravity is scaled like the rest."""
        return -GRAVITY_MPS2 * self._ratio(station)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Scale the specific force."""
        del t_s
        scaled = values.copy()
        scaled[:, :3] *= 1.0 + self._ratio(station)
        return scaled

    def undone(self, station: Station, values: Floats) -> Floats:
        """Divide by the scale."""
        ratio = self._ratio(station)
        if not ratio:
            return values
        true = values.copy()
        true[:, :3] /= 1.0 + ratio
        return true

    def _ratio(self, station: Station) -> float:
        return {Station.LEFT: self.left, Station.RIGHT: self.right}.get(station, 0.0)
