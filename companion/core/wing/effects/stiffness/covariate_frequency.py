"""A frequency that follows a recorded channel (roller position, temperature, rpm)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, ModalMotion, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class CovariateFrequency(Effect):
    """omega(t) = omega (1 + ratio c(t)), c the channel about its mean in units of its rms."""

    name: ClassVar[str] = "covariate-frequency"
    group: ClassVar[Group] = Group.STRUCTURE
    follows_channel: ClassVar[bool] = True
    advice: ClassVar[str] = "vary the channel independently of time and of the other channels"

    ratio_per_rms: float = parameter("", 0.05, "relative change of every natural frequency per rms of the channel")

    @classmethod
    def may_follow(cls, channel: str) -> bool:
        """Any channel but airspeed, which has an effect of its own, and measured inputs."""
        return not channel.startswith(("airspeed", "input_"))

    def force(self, motion: ModalMotion) -> Floats:
        """The part of the spring force that the channel adds."""
        factor = (1.0 + self.ratio_per_rms * motion.covariate) ** 2 - 1.0
        return -factor * motion.spring_mps2
