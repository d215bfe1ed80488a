"""The cameras are toed in or out beyond the calibration."""

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
class ConvergenceOffset(Effect):
    """A constant relative toe, diverging positive."""

    name: ClassVar[str] = "convergence-offset"
    group: ClassVar[Group] = Group.CAMERA
    advice: ClassVar[str] = "fly at two distances, level, against a known range"

    toe_rad: float = parameter("rad", 0.003, "relative toe beyond the calibration")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Turn each camera outwards by half."""
        del t_s
        half = 0.5 * self.toe_rad * (1.0 if side is Side.RIGHT else -1.0)
        return dataclasses.replace(view, rotation_rad=view.rotation_rad + np.array([0.0, half, 0.0]))

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Turn each camera outwards by half."""

        def turned(camera: Camera, sign: float) -> Camera:
            x, y, z = camera.rotation_rad
            return dataclasses.replace(camera, rotation_rad=(x, y + 0.5 * sign * self.toe_rad, z))

        return change_cameras(airframe, turned)
