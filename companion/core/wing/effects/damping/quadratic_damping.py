"""A wing whose damping grows with its speed (air drag, separated flow)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class QuadraticDamping(Effect):
    """Each wing half is slowed by -beta |v| v, v its tip speed in the first modes."""

    name: ClassVar[str] = "quadratic-damping"
    group: ClassVar[Group] = Group.STRUCTURE
    own_law: ClassVar[str] = "force with speed times its amount"
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "record free decays from a large amplitude: the envelope falls as 1/t"

    beta_per_m: float = parameter("1/m", 10.0, "damping acceleration per squared speed")

    def force(self, motion: ModalMotion) -> Floats:
        """The added force, half by half."""
        return on_halves(motion, lambda _w, v: -self.beta_per_m * np.abs(v) * v)
