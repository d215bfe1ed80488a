"""A camera mount that rings."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import MOUNT_DAMPING, CameraView, Effect, Group, parameter
from companion.records import Side

_LOWEST_HZ, _HIGHEST_HZ = 8.0, 80.0  # chosen: from above a slow wing's first mode to what a sampled wing still shakes
_APART = 0.01  # of a frequency: a quarter of the width of a peak with 2 % damping (choice)
_LOSSLESS = 1.5  # of the damping ratio that is assumed: three quarters of the loss, at most, may not be there (choice)
_ABOVE = 1.5  # times the first mode: below, it would ring with the wing (choice)


@dataclass(frozen=True, slots=True)
class MountResonance(Effect):
    """The camera follows its station as an oscillator: gain 1 + omega^2/omega_m^2 + ... below its resonance."""

    name: ClassVar[str] = "mount-resonance"
    group: ClassVar[Group] = Group.CAMERA
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "tap the camera and film; excite the wing at two frequencies: only a mount's gain grows"

    softness_s2: float = parameter("s^2", 2e-5, "one over omega_m squared (2e-5: 36 Hz)")
    damper_s: float = parameter("s", 1e-3, "2 zeta / omega_m of its damper, beside a loss of 4 %")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Follow as an oscillator."""
        del side, t_s
        softness_s2 = view.softness_s2 + self.softness_s2
        # a mount that shook its camera by itself would turn phases the other way: some loss is left to it
        least_s = -_LOSSLESS * MOUNT_DAMPING * math.sqrt(max(self.softness_s2, 0.0))
        damper_s = view.damper_s + max(self.damper_s, least_s)
        return dataclasses.replace(view, softness_s2=softness_s2, damper_s=damper_s)

    @classmethod
    def trial_values(cls, first_hz: float) -> tuple[dict[str, float], ...]:
        """Resonances above the first mode; a little softness is a gain that grows, and leads to none of them."""
        places_hz = np.exp(np.arange(math.log(_LOWEST_HZ), math.log(_HIGHEST_HZ), _APART)).tolist()
        return tuple({"softness_s2": (2.0 * math.pi * hz) ** -2} for hz in places_hz if hz > _ABOVE * first_hz)
