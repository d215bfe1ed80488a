"""Springs that slip, without a name: a law of force with memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, from_halves, halves, parameter
from companion.core.wing.effects.damping.hysteresis import stretch_along
from companion.records import Floats

_YIELDS = (0.25, 0.5, 1.0, 2.0)  # of the deflection's rms: from what slips all the time to what hardly does (choice)


@dataclass(frozen=True, slots=True)
class GenericSlip(Effect):
    """A share of the spring yields bit by bit: the further a half swings, the softer it is and the more is lost.

    Iwan's element: alike springs in parallel that slip at different deflections. No law of an instant has it, for
    stiffness and damping change together.
    """

    group: ClassVar[Group] = Group.STRUCTURE

    strength: float = parameter("", 0.1, "share of the stiffness that slips")

    def force(self, motion: ModalMotion) -> Floats:
        """Spring force that slipping takes away, half by half."""
        stiffness = float(motion.structure.stiffness_radps2[0, 0])
        return from_halves(motion, self.strength * stiffness * (halves(motion.offset_m) - self.remember(motion)))

    def remember(self, motion: ModalMotion) -> Floats:
        """Mean stretch of the springs along a whole motion, half by half, (2, m) m."""
        deflection_m = np.ascontiguousarray(halves(motion.offset_m))
        unit_m = float(np.std(deflection_m[0]))
        return np.asarray(np.mean([stretch_along(deflection_m, ratio * unit_m) for ratio in _YIELDS], axis=0))
