"""A wing accelerometer whose range is too small."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class Saturation(Effect):
    """Specific force is cut at +-1/inverse; 0 is an endless range. Seen in the samples: they pile up there."""

    name: ClassVar[str] = "saturation"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = (
        "choose a larger range of the accelerometer; cut samples were drawn anew as the others make them likely"
    )

    inverse_s2pm: float = parameter("s^2/m", 0.02, "one over the range")

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Cut."""
        del t_s
        if station is Station.ROOT or self.inverse_s2pm <= 0.0:
            return values
        cut = values.copy()
        cut[:, 2] = np.clip(values[:, 2], -1.0 / self.inverse_s2pm, 1.0 / self.inverse_s2pm)
        return cut
