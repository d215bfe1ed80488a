"""The cameras are further apart than measured."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.airframe_changes import change_cameras
from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.params.airframe import Airframe, Camera
from companion.records import Side


@dataclass(frozen=True, slots=True)
class BaselineError(Effect):
    """B -> B + error: ranges are wrong by a constant share at every distance."""

    name: ClassVar[str] = "baseline-error"
    group: ClassVar[Group] = Group.CAMERA
    advice: ClassVar[str] = "calibrate the focal length alone (a chart at a known distance); fly at two distances"

    error_m: float = parameter("m", 0.02, "true minus believed baseline")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Move each camera outwards by half."""
        del t_s
        half = 0.5 * self.error_m * (1.0 if side is Side.RIGHT else -1.0)
        return dataclasses.replace(view, shift_m=view.shift_m + np.array([0.0, half, 0.0]))

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Move each camera outwards by half."""

        def moved(camera: Camera, sign: float) -> Camera:
            x, y, z = camera.position_m
            return dataclasses.replace(camera, position_m=(x, y + 0.5 * sign * self.error_m, z))

        return change_cameras(airframe, moved)
