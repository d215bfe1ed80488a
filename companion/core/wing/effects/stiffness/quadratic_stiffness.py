"""A wing that is stiffer one way than the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class QuadraticStiffness(Effect):
    """Each wing half has an extra spring force -omega^2 kappa w^2, w its deflection from equilibrium."""

    name: ClassVar[str] = "quadratic-stiffness"
    group: ClassVar[Group] = Group.STRUCTURE
    own_law: ClassVar[str] = "force with deflection squared"
    advice: ClassVar[str] = "load the wing statically both ways"

    kappa_per_m: float = parameter("1/m", 5.0, "relative stiffening per deflection")

    def force(self, motion: ModalMotion) -> Floats:
        """The added force, half by half."""
        return on_halves(motion, lambda w, _v: -self.kappa_per_m * motion.half_stiffness_radps2 * np.square(w))
