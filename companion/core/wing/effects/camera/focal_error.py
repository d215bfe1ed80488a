"""Both focal lengths differ from the calibration."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.airframe_changes import change_cameras, scaled
from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.params.airframe import Airframe
from companion.records import Side


@dataclass(frozen=True, slots=True)
class FocalError(Effect):
    """f -> f (1 + ratio)."""

    name: ClassVar[str] = "focal-error"
    group: ClassVar[Group] = Group.CAMERA
    advice: ClassVar[str] = "calibrate the focal length (a chart at a known distance)"

    ratio: float = parameter("", 0.01, "relative error of both focal lengths", above=-1.0)

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Scale the image."""
        del side, t_s
        return dataclasses.replace(view, focal_ratio=view.focal_ratio * (1.0 + self.ratio))

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Scale both focal lengths."""
        factor = 1.0 + self.ratio
        return change_cameras(
            airframe, lambda camera, _sign: dataclasses.replace(camera, focal_px=scaled(camera.focal_px, factor))
        )
