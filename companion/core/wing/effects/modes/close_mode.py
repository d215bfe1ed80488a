"""A second mode within a few percent of the first."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure, with_symmetric_mode


@dataclass(frozen=True, slots=True)
class CloseMode(Effect):
    """A symmetric mode at (1 + ratio) times the first one's frequency, with its slope and damping."""

    name: ClassVar[str] = "close-mode"
    group: ClassVar[Group] = Group.STRUCTURE
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "excite each alone, or record a free decay: two close modes beat"
    scan: ClassVar = MappingProxyType({"ratio": (-0.1, -0.075, -0.05, 0.05, 0.075, 0.1)})

    participation: float = parameter("", 0.5, "power of its acceleration at the tip")
    ratio: float = parameter("", 0.1, "relative distance of its frequency from the first mode's", default=0.07)

    def structure(self, structure: Structure) -> Structure:
        """Append the mode."""
        omega = float(np.sqrt(structure.stiffness_radps2[0, 0]))
        zeta = float(structure.damping_radps[0, 0]) / (2.0 * omega)
        frequency_hz = omega * (1.0 + self.ratio) / (2.0 * np.pi)
        return with_symmetric_mode(
            structure, frequency_hz, zeta, self.participation, float(structure.slope_radpm[1, 0])
        )
