"""A wing whose frequency and damping follow the airspeed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class AirspeedDependence(Effect):
    """omega (1 + frequency c) and zeta (1 + damping c), c the airspeed about its mean in units of its rms.

    Air adds damping in proportion to speed and stiffness with its square, so a real wing shows both.
    """

    name: ClassVar[str] = "airspeed-dependence"
    group: ClassVar[Group] = Group.STRUCTURE
    follows_channel: ClassVar[bool] = True
    advice: ClassVar[str] = "fly at two airspeeds, up and down again, so that speed and time are not confounded"

    frequency_per_rms: float = parameter("", 0.03, "relative change of every natural frequency per rms of airspeed")
    damping_per_rms: float = parameter("", 0.3, "relative change of every damping ratio per rms of airspeed")

    @classmethod
    def may_follow(cls, channel: str) -> bool:
        """Airspeed alone."""
        return channel.startswith("airspeed")

    def force(self, motion: ModalMotion) -> Floats:
        """The parts of spring and damper that airspeed adds."""
        stiffer = (1.0 + self.frequency_per_rms * motion.covariate) ** 2 - 1.0
        damped = self.damping_per_rms * motion.covariate
        damper: Floats = motion.structure.damping_radps @ motion.qdot_mps
        return np.asarray(-stiffer * motion.spring_mps2 - damped * damper)
