"""A wing that stiffens (or softens) with deflection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class CubicStiffness(Effect):
    """Each wing half's spring gets -omega^2 kappa w^3, w its first-mode deflection from equilibrium.

    With w = s - a on the left and s + a on the right the modal loads are the mean and the half difference:
    s^3 + 3 s a^2 and a^3 + 3 s^2 a. A free swing of amplitude A in one mode rings at omega (1 + 3/8 kappa A^2).
    """

    name: ClassVar[str] = "cubic-stiffness"
    group: ClassVar[Group] = Group.STRUCTURE

    kappa_per_m2: float = parameter("1/m^2", 1500.0, "relative stiffening per squared deflection")

    def force(self, motion: ModalMotion) -> Floats:
        """The cubic part of the spring force."""
        symmetric, antisymmetric = motion.offset_m[:2]
        stiffness = motion.structure.stiffness_radps2
        added = np.zeros_like(motion.q_m)
        added[0] = -self.kappa_per_m2 * stiffness[0, 0] * (symmetric**3 + 3.0 * symmetric * antisymmetric**2)
        added[1] = -self.kappa_per_m2 * stiffness[1, 1] * (antisymmetric**3 + 3.0 * symmetric**2 * antisymmetric)
        return added
