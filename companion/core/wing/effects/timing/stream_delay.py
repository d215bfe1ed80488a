"""One wing node whose samples are late."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.params.airframe import Airframe, Sensor
from companion.records import Complexes, Floats, Station


@dataclass(frozen=True, slots=True)
class StreamDelay(Effect):
    """Positive: the right stream is late by ``delay_s``; negative: the left one by ``-delay_s``."""

    name: ClassVar[str] = "stream-delay"
    group: ClassVar[Group] = Group.SENSING
    hinged: ClassVar[bool] = True
    advice: ClassVar[str] = "strike the fuselage once: both streams must show it in the same sample"

    delay_s: float = parameter("s", 0.005, "how much later the right stream is than the left")

    def response(self, station: Station, f_hz: Floats) -> Complexes:
        """A pure delay."""
        return np.asarray(np.exp(-2j * np.pi * f_hz * self._late_s(station)), dtype=np.complex128)

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """A late stamp shows an earlier instant."""
        return t_s - self._late_s(station)

    def _late_s(self, station: Station) -> float:
        late = {Station.LEFT: -self.delay_s, Station.RIGHT: self.delay_s}
        return max(late.get(station, 0.0), 0.0)

    def apply_to_airframe(self, airframe: Airframe) -> Airframe:
        """Stamp the late stream earlier."""
        if self.delay_s >= 0.0:
            return dataclasses.replace(airframe, right=_earlier(airframe.right, self.delay_s))
        return dataclasses.replace(airframe, left=_earlier(airframe.left, -self.delay_s))


def _earlier(sensor: Sensor, late_s: float) -> Sensor:
    source = dataclasses.replace(sensor.source, stamp_offset_s=sensor.source.stamp_offset_s - late_s)
    return dataclasses.replace(sensor, source=source)
