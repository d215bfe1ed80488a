"""A wing whose frequency wanders steadily (heat, fuel burn)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, ModalMotion, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class FrequencyDrift(Effect):
    """omega(t) = omega (1 + ratio t / 60 s), t from the start of the recording."""

    name: ClassVar[str] = "frequency-drift"
    group: ClassVar[Group] = Group.STRUCTURE
    advice: ClassVar[str] = "record temperature, fuel and airspeed: a drift in time has a cause that can be measured"

    ratio_per_min: float = parameter("1/min", 0.05, "relative change of every natural frequency per minute")

    def force(self, motion: ModalMotion) -> Floats:
        """The part of the spring force that time adds."""
        factor = (1.0 + self.ratio_per_min * motion.t_s / 60.0) ** 2 - 1.0
        return -factor * motion.spring_mps2
