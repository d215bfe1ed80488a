"""A wing accelerometer with coarse steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class Quantisation(Effect):
    """Readings are whole multiples of a step, which adds noise of step^2/12. Seen in the samples themselves."""

    name: ClassVar[str] = "quantisation"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "choose a smaller range or a message with finer steps (HIGHRES_IMU instead of RAW_IMU)"

    step_mps2: float = parameter("m/s^2", 0.1, "one step")

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Round."""
        del t_s
        if station is Station.ROOT or self.step_mps2 <= 0.0:
            return values
        stepped = values.copy()
        stepped[:, 2] = np.round(values[:, 2] / self.step_mps2) * self.step_mps2
        return stepped
