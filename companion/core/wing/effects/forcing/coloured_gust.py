"""A gust whose spectrum falls off where the believed one does not."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.airframe_changes import with_wing
from companion.core.wing.effect import Effect, Group, parameter
from companion.params.airframe import Airframe
from companion.records import Complexes, Floats


@dataclass(frozen=True, slots=True)
class ColouredGust(Effect):
    """The load passes a further real pole: power 1 / (1 + lag2 omega^2), lag2 the square of its time constant."""

    name: ClassVar[str] = "coloured-gust"
    group: ClassVar[Group] = Group.FORCING
    advice: ClassVar[str] = "set wing.gust.corners_hz to the fitted corner"

    lag2_s2: float = parameter("s^2", 2e-3, "squared time constant of the pole; its corner is 1/(2 pi sqrt(lag2)) Hz")

    def load_gain(self, f_hz: Floats, count: int) -> Complexes:
        """The pole's magnitude, the same for every mode; phase does not matter to a random load."""
        power = 1.0 / np.maximum(1.0 + self.lag2_s2 * (2.0 * np.pi * f_hz) ** 2, 1e-3)
        return np.asarray(np.sqrt(power)[:, None, None] * np.eye(count), dtype=np.complex128)

    def forcing(self, t_s: Floats, load_mps2: Floats, generator: np.random.Generator) -> Floats:
        """Pass the load through the pole."""
        del generator
        f_hz: Floats = np.asarray(np.fft.rfftfreq(len(t_s), float(t_s[1] - t_s[0])), dtype=np.float64)
        gain = self.load_gain(f_hz, 1)[:, 0]
        return np.asarray(np.fft.irfft(np.fft.rfft(load_mps2, axis=0) * gain, len(t_s), axis=0))

    def apply_to_airframe(self, airframe: Airframe) -> Airframe | None:
        """Set a free corner of the gust, where there is one."""
        first, second = airframe.wing.gust.corners_hz
        if self.lag2_s2 <= 0.0 or (first and second):
            return None
        corner = 1.0 / (2.0 * math.pi * math.sqrt(self.lag2_s2))
        corners = (first, corner) if first else (corner, second)
        return with_wing(airframe, gust=dataclasses.replace(airframe.wing.gust, corners_hz=corners))
