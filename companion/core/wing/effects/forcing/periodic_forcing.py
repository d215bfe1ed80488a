"""A steady sine that shakes the whole wing (propeller, engine, flutter of something else)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, ResidualPeak, harmonic, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class PeriodicForcing(Effect):
    """Load cosine cos 2 pi f t + sine sin 2 pi f t on the first symmetric mode, t from the start."""

    name: ClassVar[str] = "periodic-forcing"
    group: ClassVar[Group] = Group.FORCING
    starts_at: ClassVar = ResidualPeak.LINE
    additive: ClassVar[bool] = True
    advice: ClassVar[str] = "record the propeller's rpm; a tone in the sensors alone moves no camera"

    cosine_mps2: float = parameter("m/s^2", 0.5, "modal load in phase with the start")
    sine_mps2: float = parameter("m/s^2", 0.5, "modal load a quarter period later")
    frequency_hz: float = parameter("Hz", 10.0, "frequency", default=12.0)

    def force(self, motion: ModalMotion) -> Floats:
        """The sine."""
        added = np.zeros_like(motion.q_m)
        added[0] = harmonic(self.cosine_mps2, self.sine_mps2, self.frequency_hz, motion.t_s)
        return added
