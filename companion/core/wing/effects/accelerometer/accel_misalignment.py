"""A wing accelerometer that is not mounted level: sideways acceleration leaks into the vertical axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, parameter, with_vertical
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class AccelMisalignment(Effect):
    """A station turned by epsilon about the body's x axis shows f_z + epsilon f_y."""

    name: ClassVar[str] = "accel-misalignment"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "record the lateral axis too, and sideslip; or level each sensor in the workshop"

    left_rad: float = parameter("rad", 0.03, "roll misalignment of the left accelerometer")
    right_rad: float = parameter("rad", 0.03, "roll misalignment of the right accelerometer")

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Mix in the lateral axis."""
        del t_s
        angle = {Station.LEFT: self.left_rad, Station.RIGHT: self.right_rad}.get(station, 0.0)
        return with_vertical(values, values[:, 2] + angle * values[:, 1])
