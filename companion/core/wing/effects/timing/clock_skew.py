"""Wing nodes whose clocks run fast or slow."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class ClockSkew(Effect):
    """A node's stamp t shows t - rate (t - set_at)/60 s: the left one's rate is ``both``, the right one's skew more.

    Against each other the accelerations tell the skew; that both run away the ranges tell. The clocks were right
    ``set_at_s`` after the recording's start.
    """

    name: ClassVar[str] = "clock-skew"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "synchronise the nodes (TIMESYNC); record longer"
    scan: ClassVar = MappingProxyType({"set_at_s": (0.0, 30.0, 60.0)})

    skew_s_per_min: float = parameter("s/min", 0.005, "what the right stream falls behind the left one per minute")
    both_s_per_min: float = parameter("s/min", 0.005, "what both streams fall behind the exposures per minute")
    set_at_s: float = parameter("s", 30.0, "when the clocks were right, from the recording's start")

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """The instant that the stamp shows."""
        rates = {Station.LEFT: self.both_s_per_min, Station.RIGHT: self.both_s_per_min + self.skew_s_per_min}
        rate = rates.get(station, 0.0)
        return t_s - (rate / 60.0) * (t_s - self.set_at_s) if rate else t_s
