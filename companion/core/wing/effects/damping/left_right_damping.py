"""One wing half dies out faster than the other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure


@dataclass(frozen=True, slots=True)
class LeftRightDamping(Effect):
    """Left half zeta (1 - ratio), right half zeta (1 + ratio): each pair is coupled by ratio sqrt(c_s c_a)."""

    name: ClassVar[str] = "left-right-damping"
    group: ClassVar[Group] = Group.STRUCTURE

    ratio: float = parameter("", 0.3, "half of the relative difference, right minus left", above=-1.0)

    def structure(self, structure: Structure) -> Structure:
        """Couple each symmetric mode with its partner."""
        damping = structure.damping_radps.copy()
        for s, a in structure.pairs():
            coupling = self.ratio * np.sqrt(damping[s, s] * damping[a, a])
            damping[s, a] += coupling
            damping[a, s] += coupling
        return dataclasses.replace(structure, damping_radps=damping)
