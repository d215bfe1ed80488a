"""All modes die out faster or slower than believed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.airframe_changes import scale_modes
from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure
from companion.params.airframe import Airframe


@dataclass(frozen=True, slots=True)
class DampingShift(Effect):
    """zeta -> zeta (1 + ratio)."""

    name: ClassVar[str] = "damping-shift"
    group: ClassVar[Group] = Group.STRUCTURE

    ratio: float = parameter("", 0.5, "relative change of every damping ratio", above=-1.0)

    def structure(self, structure: Structure) -> Structure:
        """Scale the damping matrix."""
        return dataclasses.replace(structure, damping_radps=structure.damping_radps * (1.0 + self.ratio))

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Scale every damping ratio."""
        return scale_modes(airframe, "damping", 1.0 + self.ratio)
