"""Both focal lengths differ from the calibration."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.records import Side


@dataclass(frozen=True, slots=True)
class FocalError(Effect):
    """f -> f (1 + ratio)."""

    name: ClassVar[str] = "focal-error"
    group: ClassVar[Group] = Group.CAMERA
    advice: ClassVar[str] = "calibrate the focal length (a chart at a known distance)"

    ratio: float = parameter("", 0.01, "relative error of both focal lengths")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Scale the image."""
        del side, t_s
        return dataclasses.replace(view, focal_ratio=view.focal_ratio * (1.0 + self.ratio))
