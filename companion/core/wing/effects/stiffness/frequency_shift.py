"""All modes ring higher or lower than believed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.airframe_changes import scale_modes
from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure
from companion.params.airframe import Airframe


@dataclass(frozen=True, slots=True)
class FrequencyShift(Effect):
    """omega -> omega (1 + ratio), damping ratios unchanged; the static bend is a measured parameter and stays."""

    name: ClassVar[str] = "frequency-shift"
    group: ClassVar[Group] = Group.STRUCTURE

    ratio: float = parameter("", 0.1, "relative change of every natural frequency", above=-1.0)

    def structure(self, structure: Structure) -> Structure:
        """Scale the stiffness with the square."""
        factor = 1.0 + self.ratio
        return dataclasses.replace(
            structure,
            stiffness_radps2=structure.stiffness_radps2 * factor**2,
            damping_radps=structure.damping_radps * factor,
        )

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Scale every frequency."""
        return scale_modes(airframe, "frequency_hz", 1.0 + self.ratio)
