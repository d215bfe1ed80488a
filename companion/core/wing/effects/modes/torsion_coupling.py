"""Torsion that the bending drags along because sensor and centre of mass do not lie on the elastic axis."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure, with_symmetric_mode


@dataclass(frozen=True, slots=True)
class TorsionCoupling(Effect):
    """A torsion mode coupled to the first symmetric one by the stiffness sqrt(coupling) omega_1 omega_t.

    The accelerometer feels it through its offset from the elastic axis, as strongly as it is coupled; it turns the
    cameras about their baseline, which moves no range. What tells it from a second mode: it swings with the first.
    """

    name: ClassVar[str] = "torsion-coupling"
    group: ClassVar[Group] = Group.STRUCTURE
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "put a second accelerometer on the other edge of the tip: torsion moves the edges apart"
    scan: ClassVar = MappingProxyType({"frequency_hz": tuple(8.0 * 1.05**k for k in range(28))})

    coupling: float = parameter("", 0.05, "square of the relative coupling stiffness, and of the offset")
    frequency_hz: float = parameter("Hz", 10.0, "natural frequency of the torsion", default=20.0)
    damping: float = parameter("", 0.01, "damping ratio", default=0.02)

    def structure(self, structure: Structure) -> Structure:
        """Append the mode and couple it."""
        if self.coupling <= 0.0:
            return structure
        grown = with_symmetric_mode(structure, self.frequency_hz, self.damping, self.coupling, 0.0)
        stiffness = grown.stiffness_radps2.copy()
        shared = np.sqrt(self.coupling * stiffness[0, 0] * stiffness[-1, -1])
        stiffness[0, -1] += shared
        stiffness[-1, 0] += shared
        return dataclasses.replace(grown, stiffness_radps2=stiffness)
