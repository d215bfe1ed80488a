"""One wing half rings higher than the other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure


@dataclass(frozen=True, slots=True)
class LeftRightFrequency(Effect):
    """Left half omega (1 - ratio), right half omega (1 + ratio).

    From the energy (kL (s-a)^2 + kR (s+a)^2)/2: both diagonal stiffnesses grow by ratio^2, and symmetric and
    antisymmetric motion are coupled by 2 ratio omega_s omega_a.
    """

    name: ClassVar[str] = "left-right-frequency"
    group: ClassVar[Group] = Group.STRUCTURE

    ratio: float = parameter("", 0.03, "half of the relative difference, right minus left", above=-1.0)

    def structure(self, structure: Structure) -> Structure:
        """Couple each symmetric mode with its partner."""
        stiffness = structure.stiffness_radps2.copy()
        for s, a in structure.pairs():
            coupling = 2.0 * self.ratio * np.sqrt(stiffness[s, s] * stiffness[a, a])
            stiffness[s, s] *= 1.0 + self.ratio**2
            stiffness[a, a] *= 1.0 + self.ratio**2
            stiffness[s, a] += coupling
            stiffness[a, s] += coupling
        return dataclasses.replace(structure, stiffness_radps2=stiffness)
