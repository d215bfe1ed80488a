"""A wing node whose clock runs fast or slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class ClockSkew(Effect):
    """The right node counts ``skew_s_per_min`` more each minute: its stamp t shows t - skew t/60 s."""

    name: ClassVar[str] = "clock-skew"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "synchronise the nodes (TIMESYNC); record longer"

    skew_s_per_min: float = parameter("s/min", 0.005, "what the right stream falls behind per minute")

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """The instant that the stamp shows."""
        return t_s - (self.skew_s_per_min / 60.0) * t_s if station is Station.RIGHT else t_s
