"""Play in a joint: no spring force within a gap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class Freeplay(Effect):
    """Within +-gap of equilibrium each wing half has no spring: + omega^2 clip(w, -gap, gap)."""

    name: ClassVar[str] = "freeplay"
    group: ClassVar[Group] = Group.STRUCTURE
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "push the tip by hand through zero load and feel for play"

    gap_m: float = parameter("m", 0.0005, "half-width of the gap")

    def force(self, motion: ModalMotion) -> Floats:
        """The added force, half by half."""
        stiffness = motion.half_stiffness_radps2
        gap = abs(self.gap_m)
        return on_halves(motion, lambda w, _v: np.sign(self.gap_m) * stiffness * np.clip(w, -gap, gap))
