"""Both cameras expose later than their stamps say."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.records import Side


@dataclass(frozen=True, slots=True)
class ExposureDelay(Effect):
    """Mid-exposure is ``delay_s`` after the stamp."""

    name: ClassVar[str] = "exposure-delay"
    group: ClassVar[Group] = Group.CAMERA
    advice: ClassVar[str] = "film a running clock or a blinking light"

    delay_s: float = parameter("s", 0.005, "true minus stamped mid-exposure")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Look later."""
        del side, t_s
        return dataclasses.replace(view, exposure_delay_s=view.exposure_delay_s + self.delay_s)
