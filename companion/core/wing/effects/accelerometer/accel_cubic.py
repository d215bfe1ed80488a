"""An accelerometer that is not straight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, parameter, with_vertical
from companion.records import Floats, Station
from companion.units import GRAVITY_MPS2


@dataclass(frozen=True, slots=True)
class AccelCubic(Effect):
    """A station reads a + kappa a^3, a the vertical specific force without gravity."""

    name: ClassVar[str] = "accel-cubic"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "calibrate on a shaker at two levels"

    kappa_s4pm2: float = parameter("s^4/m^2", 2e-4, "cubic term of both accelerometers")

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Bend the characteristic about 1 g."""
        del t_s
        if station is Station.ROOT:
            return values
        force = values[:, 2] + GRAVITY_MPS2
        cubic = self.kappa_s4pm2 * force * force * force  # a power would take ten times as long
        return with_vertical(values, values[:, 2] + cubic)
