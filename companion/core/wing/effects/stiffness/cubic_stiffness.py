"""A wing that stiffens (or softens) with deflection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class CubicStiffness(Effect):
    """Each wing half's spring gets -omega^2 kappa w^3, w its first-mode deflection from equilibrium.

    omega is the first symmetric mode's, as for every law of the halves' springs. A free symmetric swing of amplitude A
    rings at omega (1 + 3/8 kappa A^2).
    """

    name: ClassVar[str] = "cubic-stiffness"
    group: ClassVar[Group] = Group.STRUCTURE
    own_law: ClassVar[str] = "force with deflection cubed"

    kappa_per_m2: float = parameter("1/m^2", 1500.0, "relative stiffening per squared deflection")

    def force(self, motion: ModalMotion) -> Floats:
        """The added force, half by half."""
        return on_halves(motion, lambda w, _v: -self.kappa_per_m2 * motion.half_stiffness_radps2 * w * w * w)
