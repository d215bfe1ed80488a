"""Rows of an image that are exposed one after the other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.records import Side


@dataclass(frozen=True, slots=True)
class RollingShutter(Effect):
    """Matches all over the image see the mean slope over the readout T about mid-exposure: sinc(omega T/2) of it.

    Given as T squared, which may come out negative.
    """

    name: ClassVar[str] = "rolling-shutter"
    group: ClassVar[Group] = Group.CAMERA
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "use a global shutter, or calibrate row_time_s; compare matches of the top and bottom rows"

    readout2_s2: float = parameter("s^2", 4e-4, "square of the time from the first row to the last")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Look over a longer time."""
        del side, t_s
        return dataclasses.replace(view, readout2_s2=view.readout2_s2 + self.readout2_s2)
