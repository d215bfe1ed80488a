"""Springs that slip, without a name: a law of force with memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, from_halves, halves, parameter
from companion.core.wing.effects.damping.hysteresis import derivatives_along, softened, stretches_along
from companion.records import Floats

_YIELDS = np.array([0.25, 0.5, 1.0, 2.0])  # of the deflection's rms: the first slips always, the last hardly (choice)


@dataclass(frozen=True, slots=True)
class GenericSlip(Effect):
    """Part of the spring yields gradually: with amplitude a half becomes softer and loses more energy.

    Iwan's element: equal springs in parallel that slip at different deflections. Stiffness and damping change together,
    so that no law without memory has it.
    """

    group: ClassVar[Group] = Group.STRUCTURE

    strength: float = parameter("", 0.1, "share of the stiffness that slips")

    def force(self, motion: ModalMotion) -> Floats:
        """Spring force that slipping takes away, half by half."""
        stiffness = motion.half_stiffness_radps2
        return from_halves(motion, self.strength * stiffness * (halves(motion.offset_m) - self.remember(motion)))

    def mean_derivative(self, motion: ModalMotion, weight: Floats) -> Floats:
        """Share of the stiffness less what the springs follow at each lag before, half by half, (h, m)."""
        deflection_m = halves(motion.offset_m)
        followed = derivatives_along(deflection_m, self._reaches_m(deflection_m), weight)
        return softened(self.strength * motion.half_stiffness_radps2, followed)

    def remember(self, motion: ModalMotion) -> Floats:
        """Mean stretch of the springs along a whole motion, half by half, (2, m) m."""
        deflection_m = halves(motion.offset_m)
        return np.asarray(stretches_along(deflection_m, self._reaches_m(deflection_m)).mean(0))

    def _reaches_m(self, deflection_m: Floats) -> Floats:
        return np.asarray(np.std(deflection_m[0]) * _YIELDS)
