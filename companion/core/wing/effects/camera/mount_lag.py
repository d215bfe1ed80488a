"""A soft mount: the cameras follow the wing late."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.records import Side


@dataclass(frozen=True, slots=True)
class MountLag(Effect):
    """The camera follows its station as a first-order lag of ``lag_s``."""

    name: ClassVar[str] = "mount-lag"
    group: ClassVar[Group] = Group.CAMERA
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = (
        "record with two wing frequencies: a delay turns the phase in proportion, a lag less and less"
    )

    lag_s: float = parameter("s", 0.005, "time constant")

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Follow late."""
        del side, t_s
        return dataclasses.replace(view, lag_s=view.lag_s + self.lag_s)
