"""Rigid motion that is not taken out exactly: another heave at the root, another lever arm to the tip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter, with_vertical
from companion.records import Floats, Station
from companion.units import GRAVITY_MPS2

_ROLL = 3  # column of the roll rate in ImuBatch.values (convention)


@dataclass(frozen=True, slots=True)
class RigidBodyLeak(Effect):
    """The root reads (1 + heave) of its vertical acceleration; the tips sit ``arm_m`` further out than believed.

    From omega' x r the station at y feels p' y more.
    """

    name: ClassVar[str] = "rigid-body-leak"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "measure the sensors' places; turn the root sensor over in the workshop"

    heave: float = parameter("", 0.05, "relative error of the root's vertical acceleration")
    arm_m: float = parameter("m", 0.05, "true minus believed distance of the tip sensors from the root")

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Scale the root's heave, lengthen the tips' arms."""
        if station is Station.ROOT:
            return with_vertical(values, values[:, 2] + self.heave * (values[:, 2] + GRAVITY_MPS2))
        if len(t_s) < 2:
            return values
        side = 1.0 if station is Station.RIGHT else -1.0
        return with_vertical(values, values[:, 2] + side * self.arm_m * np.gradient(values[:, _ROLL], t_s))
