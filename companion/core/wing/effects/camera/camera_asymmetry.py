"""One camera turns more with the wing than the other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.airframe_changes import change_cameras
from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.params.airframe import Airframe
from companion.records import Side


@dataclass(frozen=True, slots=True)
class CameraAsymmetry(Effect):
    """Slope gain (1 + both - ratio) on the left and (1 + both + ratio) on the right.

    Where one camera alone is off, ``both`` is as large as ``ratio``.
    """

    name: ClassVar[str] = "camera-asymmetry"
    group: ClassVar[Group] = Group.CAMERA
    advice: ClassVar[str] = "excite the antisymmetric mode with ranges to a known target"

    ratio: float = parameter("", 0.1, "half of the relative difference, right minus left", above=-1.0)
    both: float = parameter("", 0.1, "what the gains of both cameras have in common")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Scale the slope that the mount follows."""
        del t_s
        factor = self._gain(1.0 if side is Side.RIGHT else -1.0)
        return dataclasses.replace(view, slope_gain=view.slope_gain * factor)

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Scale the slope gain of each camera."""
        return change_cameras(
            airframe, lambda camera, sign: dataclasses.replace(camera, slope_gain=camera.slope_gain * self._gain(sign))
        )

    def _gain(self, sign: float) -> float:
        return 1.0 + self.both + sign * self.ratio
