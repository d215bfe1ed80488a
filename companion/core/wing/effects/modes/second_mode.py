"""A further mode, well apart from the believed ones."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from companion.core.wing.airframe_changes import scaled, with_wing
from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.structure import Structure, with_symmetric_mode
from companion.params.airframe import Airframe, Mode, Uncertain

_SLOPE_RATIO = 3.4  # tip slope per tip deflection, a uniform cantilever's second mode against its first (derived)


@dataclass(frozen=True, slots=True)
class SecondMode(Effect):
    """A symmetric mode of its own frequency, driven by a load as dense as the first mode's, seen at the tips.

    ``participation`` is the power of its acceleration at the tip relative to a mode with participation 1.
    """

    name: ClassVar[str] = "second-mode"
    group: ClassVar[Group] = Group.STRUCTURE
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "add it to the airframe as wing.second_symmetric; a ground vibration test gives its slope"
    scan: ClassVar = MappingProxyType({"frequency_hz": tuple(7.5 * 1.045**k for k in range(40))})

    participation: float = parameter("", 0.3, "power of its acceleration at the tip")
    frequency_hz: float = parameter("Hz", 10.0, "natural frequency", default=20.0)
    damping: float = parameter("", 0.01, "damping ratio", default=0.02)

    def structure(self, structure: Structure) -> Structure:
        """Append the mode."""
        slope_radpm = _SLOPE_RATIO * float(structure.slope_radpm[1, 0])
        return with_symmetric_mode(structure, self.frequency_hz, self.damping, self.participation, slope_radpm)

    def is_distinct(self, structure: Structure) -> bool:
        """Whether its half-power band is clear of those of the symmetric modes: two in one place are one mode."""
        symmetric = [place for place, slot in enumerate(structure.slots) if slot % 2 == 0]
        own_hz = np.sqrt(np.diag(structure.stiffness_radps2)[symmetric]) / (2.0 * np.pi)
        half_width_hz = np.diag(structure.damping_radps)[symmetric] / (4.0 * np.pi)  # zeta f
        apart_hz = np.abs(self.frequency_hz - own_hz)
        return bool(np.all(apart_hz > half_width_hz + self.damping * self.frequency_hz))

    def apply_to_airframe(self, airframe: Airframe) -> Airframe | None:
        """Add it as the second symmetric mode, where there is none."""
        if airframe.wing.second_symmetric is not None:
            return None
        slope = scaled(airframe.wing.symmetric.slope_factor_radpm, _SLOPE_RATIO)
        mode = Mode(Uncertain(self.frequency_hz), Uncertain(self.damping), slope)
        return with_wing(airframe, second_symmetric=mode)
