"""A camera mount that rings."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.records import Side


@dataclass(frozen=True, slots=True)
class MountResonance(Effect):
    """The camera follows its station as an oscillator: gain 1 + omega^2/omega_m^2 + ... below its resonance."""

    name: ClassVar[str] = "mount-resonance"
    group: ClassVar[Group] = Group.CAMERA
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "tap the camera and film; excite the wing at two frequencies: only a mount's gain grows"

    softness_s2: float = parameter("s^2", 2e-5, "one over omega_m squared (2e-5: 36 Hz)")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Follow as an oscillator."""
        del side, t_s
        return dataclasses.replace(view, softness_s2=view.softness_s2 + self.softness_s2)
