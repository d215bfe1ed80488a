"""A wing that bends more per g than believed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.airframe_changes import scaled, with_wing
from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure
from companion.params.airframe import Airframe


@dataclass(frozen=True, slots=True)
class LoadDependentBend(Effect):
    """bend_per_g -> bend_per_g (1 + ratio); the trim bend at 1 g stays."""

    name: ClassVar[str] = "load-dependent-bend"
    group: ClassVar[Group] = Group.STRUCTURE
    advice: ClassVar[str] = "fly pull-ups and push-overs with ranges to a known target"

    ratio: float = parameter("", 0.3, "relative change of the bend per g")

    def structure(self, structure: Structure) -> Structure:
        """Scale the static bend per g."""
        return dataclasses.replace(structure, static_per_g_m=structure.static_per_g_m * (1.0 + self.ratio))

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Scale the bend per g."""
        return with_wing(airframe, bend_per_g_m=scaled(airframe.wing.bend_per_g_m, 1.0 + self.ratio))
